//! A patch that keeps its shape: as long as it does, nothing of it has come into itself.
//!
//! The nodes of a patch and those of the surface next to it are written in the frame of four of them far apart. An affine map of all of them leaves
//! every node on its side of every face. With `d` the largest distance of a node from where the frame puts it, measured in the shape that the
//! patch had when it was looked at last, a node and a tetrahedron that a plane held apart by more than `2 d` then are still apart. This takes the
//! place of Verlet's lists of pairs (L. Verlet, "Computer experiments on classical fluids", Physical Review 159, 1967), but bears any motion of
//! the whole patch, and its stretching.

use crate::inside::Weights;
use crate::patches::Patch;
use crate::shape::Shape;
use bevy_math::{Mat3A, Vec3, Vec3A};

/// Part of the gap by which nodes may leave their places. Half is the limit in exact arithmetic.
const SLACK: f32 = 0.25;
/// Tetrahedra of a patch that are looked at in any case, so that the gap of all others is wide: one of so many.
const WATCHED: usize = 10;
/// Least gap, as a part of the patch's extent: below it rounding may decide whether a node is in a tetrahedron.
const LEAST_GAP: f32 = 0.02;
/// Largest product of the norms of the map and of its inverse. Of a rotation it is 3.
const CONDITION: f32 = 30.0;

/// What is known of a patch.
#[derive(Clone, Debug, Default)]
pub(crate) struct Calm {
    /// Of the patch's nodes and then those near: weights of the three edges of the frame.
    weights: Vec<Vec3A>,
    /// Places in the list of the patch's nodes.
    frame: [usize; 4],
    /// Edges of the frame as columns, and the inverse.
    edges: Mat3A,
    inverse: Mat3A,
    /// By how much a node may leave its place, m; zero where nothing is known.
    slack_m: f32,
    /// Places in the list of the patch's tetrahedra: those that have to be looked at in any case.
    pub(crate) watched: Vec<u32>,
    keys: Vec<(f32, u32)>,
}

impl Calm {
    /// Forgets.
    pub(crate) fn forget(&mut self) {
        self.slack_m = 0.0;
    }

    /// Whether all tetrahedra of the patch but those watched have no other node of the patch, and none near it, in them.
    pub(crate) fn holds(&self, patch: &Patch, positions: &[Vec3]) -> bool {
        if self.slack_m == 0.0 {
            return false;
        }
        let at = |k: usize| Vec3A::from(positions[patch.nodes[self.frame[k]].index()]);
        let origin = at(0);
        let edges = Mat3A::from_cols(at(1) - origin, at(2) - origin, at(3) - origin);
        let back = norm(self.edges * edges.inverse());
        let reach = self.slack_m / back;
        let limit = reach * reach;
        // Comparisons that what is not a number fails.
        let well_posed = norm(edges * self.inverse) * back <= CONDITION;
        let nodes = patch.nodes.iter().chain(&patch.near);
        well_posed
            && nodes.zip(&self.weights).all(|(n, w)| (Vec3A::from(positions[n.index()]) - origin - edges * *w).length_squared() <= limit)
    }

    /// Memory that is kept, bytes.
    pub(crate) fn bytes(&self) -> usize {
        16 * self.weights.capacity() + 4 * self.watched.capacity() + 8 * self.keys.capacity()
    }

    /// Looks at the patch as it is now.
    pub(crate) fn renew(&mut self, patch: &Patch, shape: &Shape, positions: &[Vec3]) {
        self.forget();
        let at = |n: keyhole_tetmesh::NodeId| Vec3A::from(positions[n.index()]);
        let Some(extent) = self.span(patch, positions) else { return };
        self.weights.clear();
        let origin = at(patch.nodes[self.frame[0]]);
        self.weights.extend(patch.nodes.iter().chain(&patch.near).map(|n| self.inverse * (at(*n) - origin)));
        self.keys.clear();
        for (i, tet) in patch.tets.iter().enumerate() {
            let corners = shape.corners()[tet.index()];
            let mut least = 0.0;
            if let Some(weights) = Weights::of(corners.map(at)) {
                let faces: [(Vec3A, f32); 4] = std::array::from_fn(|f| (weights.gradient(f), weights.gradient(f).length_recip()));
                // No gap is wider than what the tetrahedron may shrink by.
                least = faces.iter().map(|(_, height)| *height).fold(f32::INFINITY, f32::min);
                for near in patch.near.iter().filter(|n| !corners.contains(n)) {
                    let w = weights.at(at(*near));
                    let gap = (0..4).map(|f| -w[f] * faces[f].1).fold(f32::NEG_INFINITY, f32::max);
                    least = least.min(gap);
                }
            }
            self.keys.push((if least.is_finite() { least } else { 0.0 }, i as u32));
        }
        self.keys.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let gap = self.keys[self.keys.len() / WATCHED].0.max(LEAST_GAP * extent);
        self.watched.clear();
        self.watched.extend(self.keys.iter().take_while(|(key, _)| *key < gap).map(|(_, i)| *i));
        self.watched.sort_unstable();
        self.slack_m = SLACK * gap;
    }

    /// Chooses the frame; the distance of its first two nodes, m. `None` of a patch that is flat or not finite.
    fn span(&mut self, patch: &Patch, positions: &[Vec3]) -> Option<f32> {
        let at = |i: usize| Vec3A::from(positions[patch.nodes[i].index()]);
        let farthest = |measure: &dyn Fn(Vec3A) -> f32| {
            (0..patch.nodes.len()).map(|i| (measure(at(i)), i)).max_by(|a, b| a.0.total_cmp(&b.0)).map_or(0, |(_, i)| i)
        };
        let a = if patch.nodes.is_empty() { return None } else { farthest(&|p| p.distance_squared(at(0))) };
        let b = farthest(&|p| p.distance_squared(at(a)));
        let c = farthest(&|p| (p - at(a)).cross(at(b) - at(a)).length_squared());
        let normal = (b != a).then(|| (at(b) - at(a)).cross(at(c) - at(a)))?;
        let d = farthest(&|p| (p - at(a)).dot(normal).abs());
        self.frame = [a, b, c, d];
        self.edges = Mat3A::from_cols(at(b) - at(a), at(c) - at(a), at(d) - at(a));
        self.inverse = self.edges.inverse();
        // Of a flat frame the inverse is not finite.
        (norm(self.edges) * norm(self.inverse)).is_finite().then(|| at(a).distance(at(b)))
    }
}

/// Frobenius' norm: no vector becomes longer by more than this.
fn norm(m: Mat3A) -> f32 {
    (m.x_axis.length_squared() + m.y_axis.length_squared() + m.z_axis.length_squared()).sqrt()
}
