//! What detection keeps of a mesh: the corners of its tetrahedra and which nodes are on the surface, carried over topology changes at a cost that
//! depends on the change alone.

use keyhole_tetmesh::{NodeEdit, NodeId, TetMesh, TopologyDelta};

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
        Self { corners, roles }
    }

    /// Carries the shape over `delta`; `mesh` is the mesh after it.
    pub fn update(&mut self, mesh: &TetMesh, delta: &TopologyDelta) {
        self.corners.resize(mesh.tet_slots(), VACANT);
        self.roles.resize(mesh.node_slots(), Role::Unused);
        let mut touched: Vec<NodeId> = Vec::new();
        for tet in &delta.removed {
            let gone = std::mem::replace(&mut self.corners[tet.index()], VACANT);
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
        for node in touched {
            self.roles[node.index()] = role(mesh, node);
        }
    }

    /// The corners of the tetrahedra by slot; an unused slot has four corners that no node has.
    pub(crate) fn corners(&self) -> &[[NodeId; 4]] {
        &self.corners
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
