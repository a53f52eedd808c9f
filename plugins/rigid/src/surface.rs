//! The surface of tissue near a rigid body: what the body can touch in a tick.
//!
//! The faces that are on the boundary are kept from tick to tick and carried over topology changes at a cost that depends on the change alone. A piece
//! is taken anew when tissue has moved or the body has left the box that the piece covers; otherwise it stays, so that a body on tissue at rest can fall
//! asleep.

use crate::world::Piece;
use bevy_math::Vec3;
use keyhole_tetmesh::{FACES, NodeEdit, NodeId, TetMesh, TopologyDelta};
use keyhole_whiteboard::TissueState;

/// Part of a body's reach by which a piece is larger than what the body can touch in one tick.
const MARGIN: f32 = 0.5;

/// Part of a body's reach by which tissue may have moved since the piece was taken.
const STALE: f32 = 1e-3;

/// Which faces of a mesh are on its boundary.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OrganSurface {
    corners: Vec<Option<[NodeId; 4]>>,
    /// By tetrahedron slot: a bit for each face without a neighbour.
    open: Vec<u8>,
}

/// A box in the world: lowest and highest corner, m.
pub type Bounds = (Vec3, Vec3);

/// What a piece was taken from.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Taken {
    covers: Option<Bounds>,
    nodes: Vec<(NodeId, Vec3)>,
}

impl OrganSurface {
    /// The surface of a mesh.
    #[must_use]
    pub fn of(mesh: &TetMesh) -> Self {
        let mut surface = Self { corners: vec![None; mesh.tet_slots()], open: vec![0; mesh.tet_slots()] };
        for (tet, corners) in mesh.iter() {
            surface.corners[tet.index()] = Some(corners);
            surface.open[tet.index()] = open_faces(mesh, tet);
        }
        surface
    }

    /// Carries the surface over `delta`; `mesh` is the mesh after it.
    pub fn update(&mut self, mesh: &TetMesh, delta: &TopologyDelta) {
        self.corners.resize(mesh.tet_slots(), None);
        self.open.resize(mesh.tet_slots(), 0);
        let mut touched: Vec<NodeId> = Vec::new();
        for tet in &delta.removed {
            touched.extend(self.corners[tet.index()].take().into_iter().flatten());
            self.open[tet.index()] = 0;
        }
        for added in &delta.added {
            self.corners[added.tet.index()] = Some(added.nodes);
            touched.extend(added.nodes);
        }
        touched.extend(delta.nodes.iter().filter_map(|edit| match edit {
            NodeEdit::Split { node, .. } => Some(*node),
            NodeEdit::Added { .. } | NodeEdit::Moved { .. } | NodeEdit::Removed { .. } => None,
        }));
        touched.sort_unstable();
        touched.dedup();
        for node in touched.into_iter().filter(|n| mesh.contains_node(*n)) {
            for tet in mesh.topology().around_node(node) {
                self.open[tet.index()] = open_faces(mesh, *tet);
            }
        }
    }

    /// The triangles of the boundary, normals outward, in ascending order of tetrahedron.
    pub fn triangles(&self) -> impl Iterator<Item = [NodeId; 3]> + '_ {
        let with_open = self.corners.iter().zip(&self.open).filter(|(_, open)| **open != 0);
        with_open.flat_map(|(corners, open)| {
            let faces = (0..4).filter(move |face| open >> face & 1 == 1);
            faces.filter_map(move |face| corners.map(|c| FACES[face].map(|i| c[i])))
        })
    }

    /// The nodes of the boundary, ascending.
    #[must_use]
    pub fn nodes(&self) -> Vec<NodeId> {
        let mut nodes: Vec<NodeId> = self.triangles().flatten().collect();
        nodes.sort_unstable();
        nodes.dedup();
        nodes
    }

    /// The piece of the surface whose triangles meet a box.
    fn piece(&self, state: &TissueState, (low, high): Bounds, friction: f32) -> (Piece, Vec<(NodeId, Vec3)>) {
        let at = |n: &NodeId| state.positions.get(n.index()).copied().unwrap_or(Vec3::NAN);
        let meets = |t: &[NodeId; 3]| {
            let [a, b, c] = [at(&t[0]), at(&t[1]), at(&t[2])];
            // False where a position is no number.
            a.min(b).min(c).cmple(high).all() && a.max(b).max(c).cmpge(low).all() && (a + b + c).is_finite()
        };
        let triangles: Vec<[NodeId; 3]> = self.triangles().filter(meets).collect();
        let mut nodes: Vec<NodeId> = triangles.iter().flatten().copied().collect();
        nodes.sort_unstable();
        nodes.dedup();
        let place = |n: NodeId| nodes.binary_search(&n).unwrap_or(0) as u32;
        let velocity = nodes.iter().filter_map(|n| state.velocities.get(n.index())).sum::<Vec3>() / nodes.len().max(1) as f32;
        let piece = Piece {
            vertices: nodes.iter().map(at).collect(),
            triangles: triangles.iter().map(|t| t.map(place)).collect(),
            velocity_m_s: velocity,
            friction,
        };
        let nodes = nodes.iter().map(|n| (*n, at(n))).collect();
        (piece, nodes)
    }

    /// The piece near a body that may be anywhere in a box during the tick and reaches so far (m); `None` when the one that was taken before still does,
    /// which is when tissue is where it was and the body within what the piece covers.
    pub fn take(&self, taken: &mut Taken, state: &TissueState, (low, high): Bounds, reach_m: f32, friction: f32) -> Option<Piece> {
        let still = |(n, was): &(NodeId, Vec3)| state.positions.get(n.index()).is_some_and(|x| x.distance(*was) <= STALE * reach_m);
        let within = taken.covers.is_some_and(|(l, h)| l.cmple(low).all() && h.cmpge(high).all());
        if within && !taken.nodes.is_empty() && taken.nodes.iter().all(still) {
            return None;
        }
        let margin = Vec3::splat(MARGIN * reach_m);
        let covers = (low - margin, high + margin);
        let (piece, nodes) = self.piece(state, covers, friction);
        *taken = Taken { covers: Some(covers), nodes };
        Some(piece)
    }
}

fn open_faces(mesh: &TetMesh, tet: keyhole_tetmesh::TetId) -> u8 {
    (0..4).map(|face| u8::from(mesh.topology().neighbour(tet, face).is_none()) << face).sum()
}

impl Taken {
    /// What is taken next is taken anew: the surface has changed.
    pub fn forget(&mut self) {
        *self = Self::default();
    }

    /// Whether there is nothing of the organ near the body.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }
}
