//! Consistent penetration depth: how far, and which way, each node that is inside a body is from where it came in.
//!
//! B. Heidelberger, M. Teschner, R. Keiser, M. Mueller, M. Gross, "Consistent penetration depth estimation for deformable collision response", VMV
//! 2004. With `x_i` the points where edges from a border node `p` to nodes outside cross the surface, `n_i` the surface's normals there and the weights
//! `w_i = 1 / |x_i - p|^2`, the depth of a border node is `sum w_i (x_i - p) . n_i / sum w_i` and its direction `sum w_i n_i`, normalised. From node
//! to node inwards, `d(p) = sum w_i ((p_i - p) . r_i + d_i) / sum w_i` and `r(p) = sum w_i r_i`, over the neighbours `p_i` done before.
//!
//! The paper leaves out nodes that hang together and none of which has an edge to the outside: a body wholly inside another. They are all given the one
//! of 26 directions in which the most of them are out soonest, and each its own way along it: one direction, so that they come out together.

use crate::detect::Hit;
use crate::walk::Deformed;
use bevy_math::Vec3;
use keyhole_tetmesh::{NodeId, TetId};
use rayon::prelude::*;
use smallvec::SmallVec;

/// Length below which the distance of a crossing no longer adds weight, as a part of its edge: a node on the surface has a depth of zero, not of
/// zero by zero.
const LEAST_DISTANCE: f32 = 1e-3;

/// Nodes of a body wholly inside that are asked for the way out.
const SAMPLES: usize = 32;

/// A node inside a body, and the way out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Penetration {
    /// The node.
    pub node: NodeId,
    /// The tetrahedron that it is in: of several the first.
    pub tet: TetId,
    /// Weights of that tetrahedron's corners at the node.
    pub weights: [f32; 4],
    /// Distance to the surface along the direction, m; not negative.
    pub depth_m: f32,
    /// Unit vector, the way out.
    pub direction: Vec3,
}

/// Estimates penetration depths. What it keeps from call to call is room.
#[derive(Clone, Debug, Default)]
pub struct Depths {
    /// By node slot: one more than its place in the list, 0 for nodes outside.
    places: Vec<u32>,
    list: Vec<Penetration>,
    done: Vec<bool>,
    /// Nodes that are done since the last round, with depth and direction.
    fresh: Vec<(usize, f32, Vec3)>,
    border: Vec<Option<(f32, Vec3)>>,
}

/// A weighted mean of depths and directions.
#[derive(Clone, Copy, Debug, Default)]
struct Mean {
    weight: f32,
    depth: f32,
    direction: Vec3,
}

impl Mean {
    fn add(&mut self, weight: f32, depth: f32, direction: Vec3) {
        self.weight += weight;
        self.depth += weight * depth;
        self.direction += weight * direction;
    }

    /// Nothing without a summand, or where directions cancel.
    fn value(&self) -> Option<(f32, Vec3)> {
        let direction = self.direction.try_normalize()?;
        (self.weight > 0.0).then(|| ((self.depth / self.weight).max(0.0), direction))
    }
}

impl Depths {
    /// The depths of the nodes of one body in the tetrahedra of another, or of the same: `hits` are those of this pair, in order of [`Hit::key`]. In
    /// order of node; a node for which no way out is found, deep in broken tetrahedra, is left out.
    pub fn estimate(&mut self, nodes: Deformed, tets: Deformed, hits: &[Hit]) -> &[Penetration] {
        self.list.clear();
        for hit in hits {
            if self.list.last().is_none_or(|last| last.node != hit.node) {
                let Hit { node, tet, weights, .. } = *hit;
                self.list.push(Penetration { node, tet, weights, depth_m: 0.0, direction: Vec3::ZERO });
            }
        }
        self.places.resize(self.places.len().max(nodes.positions.len()), 0);
        for (i, p) in self.list.iter().enumerate() {
            self.places[p.node.index()] = i as u32 + 1;
        }
        self.done.clear();
        self.done.resize(self.list.len(), false);
        let places = &self.places;
        self.list.par_iter().map(|p| border_depth(p, places, nodes, tets)).collect_into_vec(&mut self.border);
        for i in 0..self.border.len() {
            if let Some((depth, direction)) = self.border[i] {
                self.finish(i, depth, direction);
            }
        }
        self.propagate(nodes);
        self.lead_out(nodes, tets);
        for p in &self.list {
            self.places[p.node.index()] = 0;
        }
        let mut done = self.done.iter();
        self.list.retain(|_| done.next() == Some(&true));
        &self.list
    }

    fn finish(&mut self, i: usize, depth_m: f32, direction: Vec3) {
        (self.list[i].depth_m, self.list[i].direction, self.done[i]) = (depth_m, direction, true);
    }

    /// Breadth-first from the border inwards: in each round every node with a neighbour that was done before.
    fn propagate(&mut self, nodes: Deformed) {
        loop {
            self.fresh.clear();
            for (i, p) in self.list.iter().enumerate().filter(|(i, _)| !self.done[*i]) {
                let at = nodes.positions[p.node.index()];
                let mut mean = Mean::default();
                for q in neighbours(nodes, p.node) {
                    let Some(place) = (self.places[q.index()] as usize).checked_sub(1).filter(|place| self.done[*place]) else { continue };
                    let (known, away) = (&self.list[place], nodes.positions[q.index()] - at);
                    mean.add(away.length_squared().recip().min(f32::MAX), away.dot(known.direction) + known.depth_m, known.direction);
                }
                self.fresh.extend(mean.value().map(|(depth, direction)| (i, depth, direction)));
            }
            if self.fresh.is_empty() {
                return;
            }
            for k in 0..self.fresh.len() {
                let (i, depth, direction) = self.fresh[k];
                self.finish(i, depth, direction);
            }
        }
    }

    /// The nodes that no border has reached: one direction for all that hang together.
    fn lead_out(&mut self, nodes: Deformed, tets: Deformed) {
        let mut lost = Vec::new();
        for first in 0..self.list.len() {
            if self.done[first] {
                continue;
            }
            let mut together = vec![first];
            // Marked as done while they are gathered; those without a way out are taken back at the end.
            self.done[first] = true;
            let mut at = 0;
            while at < together.len() {
                for q in neighbours(nodes, self.list[together[at]].node) {
                    let place = (self.places[q.index()] as usize).checked_sub(1);
                    if let Some(place) = place.filter(|place| !self.done[*place]) {
                        self.done[place] = true;
                        together.push(place);
                    }
                }
                at += 1;
            }
            let reach_m = extent(tets);
            let way = |i: &usize, direction: Vec3| {
                let p = &self.list[*i];
                let from = nodes.positions[p.node.index()];
                tets.exit(p.tet, from, from + direction * reach_m).map(|exit| exit.part * reach_m)
            };
            let stride = together.len().div_ceil(SAMPLES);
            let longest = |direction: Vec3| {
                let ways = together.iter().step_by(stride).filter_map(|i| way(i, direction));
                ways.max_by(f32::total_cmp).map(|length| (length, direction))
            };
            let best = directions().filter_map(longest).min_by(|a, b| a.0.total_cmp(&b.0));
            let ways: Vec<Option<f32>> = together.iter().map(|i| best.and_then(|(longest, d)| way(i, d).or(Some(longest)))).collect();
            for (i, depth) in together.iter().zip(ways) {
                match (depth, best) {
                    (Some(depth), Some((_, direction))) => self.finish(*i, depth, direction),
                    _ => lost.push(*i),
                }
            }
        }
        for i in lost {
            self.done[i] = false;
        }
    }
}

/// Depth and direction of a node with edges to the outside; `None` where none of them crosses the surface.
fn border_depth(p: &Penetration, places: &[u32], nodes: Deformed, tets: Deformed) -> Option<(f32, Vec3)> {
    let at = nodes.positions[p.node.index()];
    let mut mean = Mean::default();
    for q in neighbours(nodes, p.node).into_iter().filter(|q| places[q.index()] == 0) {
        let to = nodes.positions[q.index()];
        let Some(exit) = tets.exit(p.tet, at, to) else { continue };
        let least = LEAST_DISTANCE * at.distance(to);
        let away = exit.point - at;
        mean.add((away.length_squared() + least * least).recip(), away.dot(exit.normal), exit.normal);
    }
    mean.value()
}

/// The nodes with an edge to this one, ascending.
pub(crate) fn neighbours(mesh: Deformed, node: NodeId) -> SmallVec<[NodeId; 64]> {
    let around = mesh.topology.around_node(node).iter();
    let mut found: SmallVec<[NodeId; 64]> = around.flat_map(|t| mesh.topology.corners(*t)).filter(|n| *n != node).collect();
    found.sort_unstable();
    found.dedup();
    found
}

/// The diagonal of the box around all finite positions, m: no way out is longer.
fn extent(mesh: Deformed) -> f32 {
    let finite = mesh.positions.iter().filter(|p| p.is_finite());
    let (low, high) = finite.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), p| (low.min(*p), high.max(*p)));
    low.distance(high)
}

/// The directions to the faces, edges and corners of a cube.
fn directions() -> impl Iterator<Item = Vec3> {
    let all = (0..27).map(|i| Vec3::new((i % 3) as f32 - 1.0, (i / 3 % 3) as f32 - 1.0, (i / 9) as f32 - 1.0));
    all.filter_map(Vec3::try_normalize)
}
