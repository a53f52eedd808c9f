//! What detection keeps of a mesh: the corners of its tetrahedra and which nodes are on the surface, carried over topology changes at a cost that
//! depends on the change alone.

use keyhole_tetmesh::{FACES, NodeEdit, NodeId, TetId, TetMesh, TopologyDelta};

/// Marks a tetrahedron slot that is not in use.
pub(crate) const VACANT: [NodeId; 4] = [NodeId(u32::MAX); 4];

/// What a node slot is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Role {
    /// No tetrahedron uses it.
    #[default]
    Unused,
    /// Inside the body.
    Inner,
    /// On the boundary.
    Surface,
}

/// The corners of the tetrahedra of a mesh by slot, and the roles of its nodes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Shape {
    corners: Vec<[NodeId; 4]>,
    /// By tetrahedron slot: a bit for each of its faces that is on the boundary.
    open_faces: Vec<u8>,
    roles: Vec<Role>,
}

impl Shape {
    /// The shape of a mesh.
    #[must_use]
    pub fn of(mesh: &TetMesh) -> Self {
        let mut corners = vec![VACANT; mesh.tet_slots()];
        for (tet, nodes) in mesh.iter() {
            corners[tet.index()] = nodes;
        }
        let roles = (0..mesh.node_slots()).map(|n| role(mesh, NodeId(n as u32))).collect();
        let mut open_faces = vec![0; mesh.tet_slots()];
        for (tet, _) in mesh.iter() {
            open_faces[tet.index()] = faces_on_boundary(mesh, tet);
        }
        Self { corners, open_faces, roles }
    }

    /// So many points without any tetrahedron: things to be looked for in those of others.
    #[must_use]
    pub fn of_points(count: usize) -> Self {
        Self { corners: Vec::new(), open_faces: Vec::new(), roles: vec![Role::Surface; count] }
    }

    /// Carries the shape over `delta`; `mesh` is the mesh after it. Returns the nodes around which anything has changed, ascending.
    pub fn update(&mut self, mesh: &TetMesh, delta: &TopologyDelta) -> Vec<NodeId> {
        self.corners.resize(mesh.tet_slots(), VACANT);
        self.open_faces.resize(mesh.tet_slots(), 0);
        self.roles.resize(mesh.node_slots(), Role::Unused);
        let mut touched: Vec<NodeId> = Vec::new();
        for tet in &delta.removed {
            let gone = std::mem::replace(&mut self.corners[tet.index()], VACANT);
            self.open_faces[tet.index()] = 0;
            touched.extend(gone.into_iter().filter(|_| gone != VACANT));
        }
        for added in &delta.added {
            self.corners[added.tet.index()] = added.nodes;
            touched.extend(added.nodes);
        }
        touched.extend(delta.nodes.iter().map(|edit| match edit {
            NodeEdit::Added { node, .. } | NodeEdit::Moved { node, .. } | NodeEdit::Split { node, .. } | NodeEdit::Removed { node } => {
                *node
            }
        }));
        touched.sort_unstable();
        touched.dedup();
        for node in &touched {
            self.roles[node.index()] = role(mesh, *node);
            for tet in mesh.topology().around_node(*node) {
                self.open_faces[tet.index()] = faces_on_boundary(mesh, *tet);
            }
        }
        touched
    }

    /// The corners of the tetrahedra by slot; an unused slot has four corners that no node has.
    pub(crate) fn corners(&self) -> &[[NodeId; 4]] {
        &self.corners
    }

    /// The triangles of the boundary, normals outward, in ascending order of tetrahedron.
    pub fn triangles(&self) -> impl Iterator<Item = [NodeId; 3]> + '_ {
        let open = self.open_faces.iter().zip(&self.corners).filter(|(open, _)| **open != 0);
        open.flat_map(|(open, corners)| (0..4).filter(move |face| open >> face & 1 == 1).map(move |face| FACES[face].map(|i| corners[i])))
    }

    /// The roles of the nodes by slot.
    #[must_use]
    pub fn roles(&self) -> &[Role] {
        &self.roles
    }

    /// The role of a node.
    #[must_use]
    pub fn role(&self, node: NodeId) -> Role {
        self.roles[node.index()]
    }
}

fn role(mesh: &TetMesh, node: NodeId) -> Role {
    match (mesh.topology().around_node(node).is_empty(), mesh.topology().is_boundary_node(node)) {
        (true, _) => Role::Unused,
        (false, true) => Role::Surface,
        (false, false) => Role::Inner,
    }
}

fn faces_on_boundary(mesh: &TetMesh, tet: TetId) -> u8 {
    (0..4).map(|face| u8::from(mesh.topology().neighbour(tet, face).is_none()) << face).sum()
}
