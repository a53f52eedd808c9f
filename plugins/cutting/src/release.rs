//! Release: when a crossing becomes effective, and which faces have a point. The only place where the methods differ.

use crate::cutter::Cutter;
use crate::sheet::{clear_of_border, weighted};
use crate::stroke::{CrossingState, FaceWeights, SplitRank};
use keyhole_tetmesh::{EdgeKey, FaceKey, NodeId, TetId, TetMesh};
use keyhole_whiteboard::{CutMethod, CutPattern};
use smallvec::SmallVec;
use std::cmp::Ordering;

/// Whether a face that has a point is crossed on one side of it only, or the sheet runs right through.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum FaceState {
    Open,
    Full,
}

/// The place of an edge in the order of splitting, from the rest shape as the stroke finds it.
pub(crate) fn split_rank(mesh: &TetMesh, edge: EdgeKey) -> SplitRank {
    let [a, b] = edge.nodes().map(|n| mesh.rest(n));
    SplitRank { length_squared: a.distance_squared(b), midpoint: (a + b) / 2.0 }
}

/// Longer edges first: better shapes than by id. Ties by midpoint, then by id.
pub(crate) fn split_order(a: (&SplitRank, EdgeKey), b: (&SplitRank, EdgeKey)) -> Ordering {
    b.0.length_squared
        .total_cmp(&a.0.length_squared)
        .then_with(|| a.0.midpoint.x.total_cmp(&b.0.midpoint.x))
        .then_with(|| a.0.midpoint.y.total_cmp(&b.0.midpoint.y))
        .then_with(|| a.0.midpoint.z.total_cmp(&b.0.midpoint.z))
        .then_with(|| a.1.cmp(&b.1))
}

impl Cutter {
    /// Whether a feature of these nodes is released as soon as it is found.
    fn is_immediate(&self, nodes: &[NodeId]) -> bool {
        match self.settings.method {
            CutMethod::Progressive => true,
            CutMethod::NonProgressive => false,
            CutMethod::Hybrid => nodes.iter().any(|n| self.is_surface_node(*n)),
        }
    }

    /// Whether a blade is in a base tetrahedron.
    pub(crate) fn is_occupied(&self, base: TetId) -> bool {
        self.courses.iter().any(|c| c.occupied.tets.contains(&base))
    }

    /// Whether a blade is in a base tetrahedron around a node.
    pub(crate) fn is_beside_blade(&self, node: NodeId) -> bool {
        self.courses.iter().any(|c| c.occupied.nodes.contains(&node))
    }

    fn has_left(&self, mut tets: impl Iterator<Item = TetId>) -> bool {
        tets.all(|t| !self.is_occupied(t))
    }

    /// Settles what the blade has left, snaps, and releases what the policy lets go. `candidates` gains the base tetrahedra concerned.
    pub(crate) fn settle_and_release(&mut self, mesh: &mut TetMesh, candidates: &mut Vec<TetId>) {
        for edge in &self.stroke.unsettled {
            if self.is_immediate(&edge.nodes())
                && let Some(c) = self.stroke.crossings.get_mut(edge)
                && c.state == CrossingState::Recorded
            {
                c.state = CrossingState::Released;
                let [a, b] = edge.nodes();
                candidates.extend(self.before.around_edge(mesh.topology(), a, b));
            }
        }
        let unsettled = std::mem::take(&mut self.stroke.unsettled);
        let snapping = self.settings.snap > 0.0;
        let (left, waiting): (Vec<EdgeKey>, Vec<EdgeKey>) = unsettled.into_iter().partition(|edge| {
            let [a, b] = edge.nodes();
            if snapping {
                // With snapping the whole neighbourhood of both nodes must be final, for a node decides for all of its edges.
                !self.is_beside_blade(a) && !self.is_beside_blade(b)
            } else {
                self.has_left(self.around_twins(mesh, [a, b]))
            }
        });
        self.stroke.unsettled = waiting;
        if snapping {
            self.snap(mesh, &left, candidates);
        }
        for edge in left {
            let [a, b] = edge.nodes();
            candidates.extend(self.before.around_edge(mesh.topology(), a, b));
            if let Some(c) = self.stroke.crossings.get_mut(&edge) {
                c.settled = true;
                if c.state == CrossingState::Recorded {
                    c.state = CrossingState::Released;
                }
            }
        }
    }

    /// The point that a face has, if any: a function of the face alone, so that its two tetrahedra agree.
    pub(crate) fn face_point(&self, mesh: &TetMesh, face: FaceKey) -> Option<(FaceWeights, FaceState)> {
        let nodes = face.nodes();
        let edges = face.edges();
        let states = edges.map(|e| self.stroke.crossings.get(&e).map(|c| c.state));
        let those_in = |state: CrossingState| {
            let mut found: SmallVec<[usize; 3]> = SmallVec::new();
            for (i, known) in states.into_iter().enumerate() {
                if known == Some(state) {
                    found.push(i);
                }
            }
            found
        };
        let released = those_in(CrossingState::Released);
        if released.is_empty() {
            return None;
        }
        let waiting = those_in(CrossingState::Recorded);
        // A node on the sheet counts where the sheet goes on from it to the opposite edge.
        let mut through = released.clone();
        through.retain(|i| self.stroke.on_sheet.contains_key(&nodes[*i]));
        let immediate = self.is_immediate(&nodes);
        match (released.as_slice(), through.as_slice()) {
            ([one], []) => {
                if let [other] = waiting.as_slice() {
                    let stored = self.stroke.face_points.get(&face).map(|(w, _)| *w);
                    let between = || middle(self.on_edge(face, *one), self.on_edge(face, *other));
                    return immediate.then(|| (stored.unwrap_or_else(between), FaceState::Open));
                }
                if !waiting.is_empty() {
                    return None;
                }
                let left = immediate || self.has_left(self.around_twins(mesh, nodes));
                left.then(|| self.deepest(mesh, face, *one)).flatten().map(|w| (clear_of_border(w), FaceState::Open))
            }
            ([one, two], []) if self.pattern(face) == CutPattern::Symmetric => {
                Some((middle(self.on_edge(face, *one), self.on_edge(face, *two)), FaceState::Full))
            }
            ([one], [node]) if self.pattern(face) == CutPattern::Symmetric => {
                let mut corner = [0.0; 3];
                corner[*node] = 1.0;
                Some((middle(corner, self.on_edge(face, *one)), FaceState::Full))
            }
            _ => None,
        }
    }

    /// How far the cut goes in a face that is crossed on its edge `one` only: as far as a line has come, or the border of the sheet.
    fn deepest(&self, mesh: &TetMesh, face: FaceKey, one: usize) -> Option<FaceWeights> {
        let found = [self.stroke.reach.get(&face), self.stroke.border.get(&face)].into_iter().flatten();
        found.copied().max_by(|a, b| self.depth(mesh, face, one, *a).total_cmp(&self.depth(mesh, face, one, *b)))
    }

    /// Squared distance of a point of a face from the crossing on the face's edge `one`, m2.
    fn depth(&self, mesh: &TetMesh, face: FaceKey, one: usize, w: FaceWeights) -> f64 {
        let nodes = face.nodes().map(|n| mesh.rest(n));
        weighted(nodes, w).distance_squared(weighted(nodes, self.on_edge(face, one)))
    }

    /// Notes how far the present line of a blade has come in the faces that the sheet crosses on one edge only.
    pub(crate) fn note_reach(&mut self, mesh: &TetMesh, course: usize) {
        let front: Vec<(FaceKey, FaceWeights)> = self.courses[course].front.iter().map(|(f, w)| (*f, *w)).collect();
        for (face, w) in front {
            let edges = face.edges();
            let crossed: SmallVec<[usize; 3]> = (0..3).filter(|&i| self.stroke.crossings.contains_key(&edges[i])).collect();
            let [one] = crossed[..] else { continue };
            let known = self.stroke.reach.get(&face);
            if known.is_none_or(|r| self.depth(mesh, face, one, *r) < self.depth(mesh, face, one, w)) {
                self.stroke.reach.insert(face, w);
            }
        }
    }

    /// The pattern of a face: that of the hull when one of its nodes lies on the surface.
    fn pattern(&self, face: FaceKey) -> CutPattern {
        if face.nodes().iter().any(|n| self.is_surface_node(*n)) { self.settings.hull } else { self.settings.core }
    }

    /// The crossing on edge `i` of a face (opposite to its node `i`), as weights of the face's nodes.
    fn on_edge(&self, face: FaceKey, i: usize) -> FaceWeights {
        let t = self.stroke.crossings.get(&face.edges()[i]).map_or(0.5, |c| c.t);
        match i {
            0 => [0.0, 1.0 - t, t],
            1 => [1.0 - t, 0.0, t],
            _ => [1.0 - t, t, 0.0],
        }
    }
}

fn middle(a: FaceWeights, b: FaceWeights) -> FaceWeights {
    std::array::from_fn(|i| (a[i] + b[i]) / 2.0)
}
