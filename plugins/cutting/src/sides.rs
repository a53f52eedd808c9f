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
use crate::lips::Twins;
use crate::meet::Meeting;
use crate::release;
use crate::sheet::{CLEARANCE, Hit};
use crate::stroke::{Crossing, CrossingState};
use keyhole_tetmesh::{EdgeKey, NodeId, TetId, TetMesh};
use rustc_hash::FxHashMap;
use smallvec::SmallVec;

/// The sheet goes through a node of an earlier cut that it passes within this part of the mesh's mean edge.
pub(crate) const STICK: f64 = 0.1;

/// A second crossing of an edge within this part of the edge's length is the same cut: the blade goes back and forth in it.
const SAME_CUT: f64 = 0.25;

/// Whether a strip can be taken into the stroke.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Conflict {
    None,
    /// It meets what the stroke has cut.
    WithCut,
    /// It meets what another blade is cutting.
    WithBlade,
}

impl Cutter {
    /// Takes what the sheet crosses in one step into the stroke. `affected` gains the base tetrahedra around new crossings.
    pub(crate) fn record_hits(&mut self, mesh: &TetMesh, hits: FxHashMap<EdgeKey, Hit>, affected: &mut Vec<TetId>) {
        let turn = if self.goes_back(&hits) { -1 } else { 1 };
        let mut ordered: Vec<(EdgeKey, Hit)> = hits.into_iter().collect();
        ordered.sort_by_cached_key(|(edge, _)| {
            let [a, b] = edge.nodes().map(|n| mesh.rest(n));
            ((a + b) / 2.0).to_array().map(ordered_bits)
        });
        for (edge, hit) in ordered {
            self.record_hit(mesh, edge, Hit { side: hit.side * turn, ..hit }, affected);
        }
    }

    /// What stands against it that a blade's strip is part of one sheet with what this stroke has cut before, by this blade long ago or by another one:
    /// nodes that would be on both sides of it.
    pub(crate) fn conflict(&self, course: usize, hits: &FxHashMap<EdgeKey, Hit>) -> Conflict {
        let turn = if self.goes_back(hits) { -1 } else { 1 };
        let (visits, mean_edge_m) = (&self.stroke.visits, self.mean_edge_m());
        let mut conflict = Conflict::None;
        for (edge, hit) in hits {
            if self.stroke.crossings.get(edge).is_some_and(|c| (c.exact - hit.t).abs() < SAME_CUT) {
                continue;
            }
            for (node, side) in edge.nodes().into_iter().zip([hit.side * turn, -hit.side * turn]) {
                if self.side_of(node).is_none_or(|s| s == side) || !visits.is_return(&self.courses[course], node, mean_edge_m) {
                    continue;
                }
                if visits.is_beside_other(&self.courses, course, node, mean_edge_m) {
                    return Conflict::WithBlade;
                }
                conflict = Conflict::WithCut;
            }
        }
        conflict
    }

    /// The side of a node that is known for certain.
    fn side_of(&self, node: NodeId) -> Option<i8> {
        self.stroke.node_sides.get(&node).copied().filter(|_| !self.stroke.guessed.contains(&node))
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
        if let Some(known) = self.stroke.crossings.get(&edge).copied() {
            if known.side == -hit.side && (known.exact - hit.t).abs() >= SAME_CUT {
                if self.is_by_cut_node(mesh, edge, known.exact) {
                    // The first was but the node's own place on the sheet.
                    self.tell_other_ends(mesh, edge, hit);
                } else {
                    // Crossed and crossed back: the node beyond the second crossing is on the side of the one before the first.
                    self.stroke.led_past.push(if hit.t > known.exact { high } else { low });
                }
            }
            return;
        }
        if self.is_by_cut_node(mesh, edge, hit.t) {
            for (node, side) in [(low, hit.side), (high, -hit.side)] {
                if !self.stroke.on_sheet.contains_key(&node) && !self.stroke.node_sides.contains_key(&node) {
                    self.tell_side(mesh, node, side);
                    self.stroke.guessed.extend(self.twins(mesh, node));
                }
            }
            self.add_crossing(mesh, edge, Crossing::new(hit.t, hit.side, self.clearance(mesh, edge)), affected);
            return;
        }
        let (at_low, at_high) = (self.side_of(low).unwrap_or(hit.side), self.side_of(high).unwrap_or(-hit.side));
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

    /// Whether a crossing of an edge at `t` is beside an end of it that the sheet goes through: what it says of the other end is but a guess, for an
    /// edge that runs along the sheet from there may cross it once more.
    fn is_by_cut_node(&self, mesh: &TetMesh, edge: EdgeKey, t: f64) -> bool {
        let [low, high] = edge.nodes();
        let near = SAME_CUT * self.mean_edge_m() / mesh.rest(low).distance(mesh.rest(high));
        (t <= near && self.stroke.on_sheet.contains_key(&low)) || (1.0 - t <= near && self.stroke.on_sheet.contains_key(&high))
    }

    /// Notes the sides of those ends of an edge that the sheet does not go through.
    fn tell_other_ends(&mut self, mesh: &TetMesh, edge: EdgeKey, hit: Hit) {
        for (node, side) in edge.nodes().into_iter().zip([hit.side, -hit.side]) {
            if !self.stroke.on_sheet.contains_key(&node) {
                self.tell_side(mesh, node, side);
            }
        }
    }

    /// Lets the sheet go through the nodes of earlier cuts that it passes within [`STICK`] of. They stay where they are, so that a blade that comes
    /// back through a cut runs along it instead of cutting ever thinner slices.
    pub(crate) fn stick(&mut self, mesh: &TetMesh, meeting: &Meeting, affected: &mut Vec<TetId>) {
        let mut edges: Vec<(EdgeKey, Hit)> = meeting.hits.iter().map(|(e, h)| (*e, *h)).collect();
        edges.retain(|(e, _)| e.nodes().iter().any(|n| self.is_wound_node(*n)));
        edges.sort_unstable_by_key(|(e, _)| *e);
        for (edge, hit) in edges {
            let [low, high] = edge.nodes();
            for (node, side, away) in [(low, hit.side, hit.away[0]), (high, -hit.side, hit.away[1])] {
                let is_near = away <= STICK * self.mean_edge_m() || meeting.beside.binary_search(&node).is_ok();
                if is_near && self.is_wound_node(node) {
                    self.stick_node(mesh, node, side, affected);
                }
            }
        }
    }

    /// Lets the sheet go through a node and its twins, when no edge of them is split yet.
    fn stick_node(&mut self, mesh: &TetMesh, node: NodeId, side: i8, affected: &mut Vec<TetId>) {
        if self.stroke.on_sheet.contains_key(&node) {
            return;
        }
        let twins = self.twins(mesh, node);
        let neighbours: SmallVec<[_; 2]> = twins.iter().map(|n| self.neighbours(mesh, *n)).collect();
        let is_split = |(n, around): (&NodeId, &SmallVec<_>)| around.iter().any(|o| self.stroke.released(EdgeKey::new(*n, *o)).is_some());
        if twins.iter().zip(&neighbours).any(is_split) {
            return;
        }
        for (node, neighbours) in twins.into_iter().zip(&neighbours) {
            let side = self.stroke.node_sides.get(&node).copied().unwrap_or(side);
            self.put_on_sheet(mesh, node, side, neighbours, affected);
        }
    }

    /// Whether a node is one of an earlier cut.
    pub(crate) fn is_wound_node(&self, node: NodeId) -> bool {
        self.on_wound.get(node.index()).copied().unwrap_or(false)
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

    /// Notes the side of a node and its twins, which decides that of the children around them.
    fn tell_side(&mut self, mesh: &TetMesh, node: NodeId, side: i8) {
        for node in self.twins(mesh, node) {
            self.stroke.guessed.remove(&node);
            if self.stroke.node_sides.insert(node, side) != Some(side) {
                self.stroke.stale_labels.extend(self.before.around_node(mesh.topology(), node));
            }
        }
    }

    /// Leads the sheet past the nodes that turned out to lie on the other side, once the blade has left them.
    pub(crate) fn lead_past_nodes(&mut self, mesh: &TetMesh, affected: &mut Vec<TetId>) {
        let mut pending: Vec<Twins> = std::mem::take(&mut self.stroke.led_past).into_iter().map(|n| self.twins(mesh, n)).collect();
        pending.sort_unstable();
        pending.dedup();
        let (left, waiting): (Vec<Twins>, Vec<Twins>) = pending.into_iter().partition(|twins| !self.is_beside_blade(twins[0]));
        self.stroke.led_past.extend(waiting.into_iter().map(|twins| twins[0]));
        for node in left.into_iter().flatten() {
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
