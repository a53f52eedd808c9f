//! Sides: which side of the sheet each node near it is on, so that the crossings of a stroke are always those of one sheet.
//!
//! The sheet is finer than the mesh. It may cross an edge, bend, and cross it back; then both ends are on one side, but the first crossing
//! may be released by the time the second is found. Rather than hold crossings back, the first one that tells a node's side decides it, and the
//! sheet is led past a node that turns out to lie on the other side: its edges that the sheet crosses are left whole, and those that it does not
//! cross are cut close to the node, once the blade has left it. Such a node is within the sheet's bend over one edge, so that the sheet is moved
//! by a few hundredths of an edge.
//!
//! A stroke that goes back in its own cut crosses the same edges the other way round: its sides are turned over.

use crate::cutter::Cutter;
use crate::release;
use crate::sheet::{CLEARANCE, Hit};
use crate::stroke::{Crossing, CrossingState};
use keyhole_tetmesh::{EdgeKey, NodeId, TetId, TetMesh};
use rustc_hash::FxHashMap;

/// The sheet goes through a node of an earlier cut that it passes within this part of the mesh's mean edge.
const STICK: f64 = 0.1;

/// A second crossing of an edge within this part of the edge's length is the same cut: the blade goes back and forth in it.
const SAME_CUT: f64 = 0.25;

impl Cutter {
    /// Takes what the sheet crosses in one step into the stroke. `affected` gains the base tetrahedra around new crossings.
    pub(crate) fn record_hits(&mut self, mesh: &TetMesh, hits: FxHashMap<EdgeKey, Hit>, affected: &mut Vec<TetId>) {
        let turn = if self.goes_back(&hits) { -1 } else { 1 };
        let mut ordered: Vec<(EdgeKey, Hit)> = hits.into_iter().collect();
        ordered.sort_by_cached_key(|(edge, _)| {
            let [a, b] = edge.nodes().map(|n| mesh.rest(n));
            ((a + b) / 2.0).to_array().map(ordered_bits)
        });
        for (edge, hit) in &ordered {
            self.stick(mesh, *edge, Hit { side: hit.side * turn, ..*hit }, affected);
        }
        for (edge, hit) in ordered {
            self.record_hit(mesh, edge, Hit { side: hit.side * turn, ..hit }, affected);
        }
    }

    /// Whether most of what is met are known crossings, the other way round at the same place.
    fn goes_back(&self, hits: &FxHashMap<EdgeKey, Hit>) -> bool {
        let again = hits.iter().filter_map(|(e, h)| self.stroke.crossings.get(e).map(|c| (c, h)));
        let votes: i32 = again.filter(|(c, h)| (c.exact - h.t).abs() < SAME_CUT).map(|(c, h)| i32::from(c.side * h.side)).sum();
        2 * -votes > hits.len() as i32
    }

    fn record_hit(&mut self, mesh: &TetMesh, edge: EdgeKey, hit: Hit, affected: &mut Vec<TetId>) {
        let [low, high] = edge.nodes();
        let first = self.stroke.hits.insert(edge);
        if let Some(known) = self.stroke.crossings.get(&edge) {
            if known.side == -hit.side && (known.exact - hit.t).abs() >= SAME_CUT {
                // Crossed and crossed back: the node beyond the second crossing is on the side of the one before the first.
                self.stroke.led_past.push(if hit.t > known.exact { high } else { low });
            }
            return;
        }
        let (at_low, at_high) = {
            let sides = &self.stroke.node_sides;
            (sides.get(&low).copied().unwrap_or(hit.side), sides.get(&high).copied().unwrap_or(-hit.side))
        };
        match (at_low == hit.side, at_high == -hit.side) {
            (true, true) | (false, false) => {
                self.tell_side(mesh, low, at_low);
                self.tell_side(mesh, high, at_high);
                self.add_crossing(mesh, edge, Crossing::new(hit.t, at_low, self.clearance(mesh, edge)), affected);
            }
            // One of the nodes is taken to be on the other side, and so both are on one.
            (false, true) => {
                self.tell_side(mesh, high, at_high);
                self.stroke.led_past.extend(first.then_some(low));
            }
            (true, false) => {
                self.tell_side(mesh, low, at_low);
                self.stroke.led_past.extend(first.then_some(high));
            }
        }
    }

    /// Lets the sheet go through a node of an earlier cut that it passes within [`STICK`] of, when nothing that is released stands against it. The node stays where
    /// it is, so that a blade that comes back through a cut runs along it instead of cutting ever thinner slices.
    fn stick(&mut self, mesh: &TetMesh, edge: EdgeKey, hit: Hit, affected: &mut Vec<TetId>) {
        let [low, high] = edge.nodes();
        for (node, other, side, away) in [(low, high, hit.side, hit.away[0]), (high, low, -hit.side, hit.away[1])] {
            if !self.on_wound.get(node.index()).copied().unwrap_or(false)
                || away > STICK * self.mean_edge_m()
                || self.stroke.on_sheet.contains_key(&node)
            {
                continue;
            }
            let neighbours = self.neighbours(mesh, node);
            if neighbours.iter().any(|n| self.stroke.released(EdgeKey::new(node, *n)).is_some()) {
                continue;
            }
            if !self.stroke.node_sides.contains_key(&other) {
                self.tell_side(mesh, other, -side);
            }
            let side = self.stroke.node_sides.get(&node).copied().unwrap_or(side);
            self.put_on_sheet(mesh, node, side, &neighbours, affected);
        }
    }

    /// Lets the sheet go through a node: its crossings are dropped.
    pub(crate) fn put_on_sheet(&mut self, mesh: &TetMesh, node: NodeId, side: i8, neighbours: &[NodeId], affected: &mut Vec<TetId>) {
        self.stroke.on_sheet.insert(node, side);
        for other in neighbours {
            if let Some(c) = self.stroke.crossings.get_mut(&EdgeKey::new(node, *other)) {
                c.state = CrossingState::Dropped;
                c.settled = true;
            }
        }
        let around = self.before.around_node(mesh.topology(), node);
        self.stroke.stale_labels.extend(around);
        affected.extend(self.before.around_node(mesh.topology(), node));
    }

    /// The smallest parameter of a crossing on an edge.
    fn clearance(&self, mesh: &TetMesh, edge: EdgeKey) -> f64 {
        let [a, b] = edge.nodes().map(|n| mesh.rest(n));
        (0.5 * STICK * self.mean_edge_m() / a.distance(b)).clamp(CLEARANCE, 0.5)
    }

    fn add_crossing(&mut self, mesh: &TetMesh, edge: EdgeKey, mut crossing: Crossing, affected: &mut Vec<TetId>) {
        let [a, b] = edge.nodes();
        if [a, b].iter().any(|n| self.stroke.on_sheet.contains_key(n)) {
            crossing.state = CrossingState::Dropped;
            crossing.settled = true;
        } else {
            self.stroke.unsettled.push(edge);
        }
        self.stroke.ranks.insert(edge, release::split_rank(mesh, edge));
        self.stroke.crossings.insert(edge, crossing);
        affected.extend(self.before.around_edge(mesh.topology(), a, b));
    }

    /// Notes the side of a node, which decides that of the children around it.
    fn tell_side(&mut self, mesh: &TetMesh, node: NodeId, side: i8) {
        if self.stroke.node_sides.insert(node, side) != Some(side) {
            self.stroke.stale_labels.extend(self.before.around_node(mesh.topology(), node));
        }
    }

    /// Leads the sheet past the nodes that turned out to lie on the other side, once the blade has left them.
    pub(crate) fn lead_past_nodes(&mut self, mesh: &TetMesh, affected: &mut Vec<TetId>) {
        let mut pending = std::mem::take(&mut self.stroke.led_past);
        pending.sort_unstable();
        pending.dedup();
        let (left, waiting): (Vec<NodeId>, Vec<NodeId>) = pending.into_iter().partition(|n| !self.stroke.occupied.nodes.contains(n));
        self.stroke.led_past = waiting;
        for node in left {
            let Some(side) = self.stroke.node_sides.get(&node).copied() else { continue };
            if self.stroke.on_sheet.contains_key(&node) {
                continue;
            }
            for other in self.neighbours(mesh, node) {
                let edge = EdgeKey::new(node, other);
                let there = self.stroke.node_sides.get(&other).copied().unwrap_or(-side);
                if self.stroke.hits.contains(&edge) || self.stroke.crossings.contains_key(&edge) || there == side {
                    continue;
                }
                self.tell_side(mesh, other, there);
                let clearance = self.clearance(mesh, edge);
                let crossing =
                    if edge.nodes()[0] == node { Crossing::new(0.0, side, clearance) } else { Crossing::new(1.0, there, clearance) };
                self.add_crossing(mesh, edge, crossing, affected);
            }
        }
    }
}

/// A key that orders finite numbers as their values do.
fn ordered_bits(x: f64) -> i64 {
    let bits = x.to_bits() as i64;
    bits ^ (((bits >> 63) as u64) >> 1) as i64
}
