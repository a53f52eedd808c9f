//! Carries a body and its state over a topology change, at a cost that depends on the change alone.

use crate::body::{Body, Momentum};
use crate::element::Element;
use bevy_math::{DVec3, Vec3};
use keyhole_tetmesh::{NodeEdit, NodeId, NodeWeights, TetId, TetMesh, TopologyDelta};
use keyhole_whiteboard::TissueState;

/// What an adoption did to the momentum.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Adopted {
    /// Momentum of the touched nodes before the change.
    pub before: Momentum,
    /// The same after it, with what departed, before the difference was given back.
    pub after: Momentum,
    /// The same after the difference was given back.
    pub settled: Momentum,
    /// Velocity that every touched node was given so that the momentum is what it was, m/s. Whatever departed needs the same.
    pub given_back: Vec3,
}

impl Adopted {
    /// Change of linear momentum that the transfer of nodes alone would have made, relative to the sum of the magnitudes of the touched
    /// nodes' momenta; 0 when nothing moves.
    #[must_use]
    pub fn relative_jump(&self) -> f64 {
        let scale = self.before.scale.max(self.after.scale);
        if scale > 0.0 { (self.after.linear - self.before.linear).length() / scale } else { 0.0 }
    }

    /// What is left of that change after it was given back: rounding.
    #[must_use]
    pub fn relative_error(&self) -> f64 {
        let scale = self.before.scale.max(self.settled.scale);
        if scale > 0.0 { (self.settled.linear - self.before.linear).length() / scale } else { 0.0 }
    }
}

/// Carries positions and velocities over the node edits, in order. Nodes that no edit names keep theirs to the bit; the slots of removed nodes
/// keep their last values.
pub fn edit_nodes(state: &mut TissueState, edits: &[NodeEdit]) {
    for edit in edits {
        let (node, position, velocity) = match edit {
            NodeEdit::Added { node, from } | NodeEdit::Moved { node, from } => {
                (*node, weighted(&state.positions, from), weighted(&state.velocities, from))
            }
            NodeEdit::Split { node, of } => (*node, state.positions[of.index()], state.velocities[of.index()]),
            NodeEdit::Removed { .. } => continue,
        };
        if state.positions.len() <= node.index() {
            state.positions.resize(node.index() + 1, Vec3::ZERO);
            state.velocities.resize(node.index() + 1, Vec3::ZERO);
        }
        state.positions[node.index()] = position;
        state.velocities[node.index()] = velocity;
    }
}

/// Carries a body and its state over `delta`; `mesh` is the mesh after it. `departed` is the momentum of what left the body for another
/// one, as its nodes are after their edits.
///
/// Where mass moves from node to node the linear momentum of the touched nodes would change a little; the difference, divided by their mass,
/// is given back to all of them as one velocity, so that the momentum after is that before, to rounding.
pub fn adopt(
    body: &mut Body,
    state: &mut TissueState,
    mesh: &TetMesh,
    delta: &TopologyDelta,
    departed: impl FnOnce(&TissueState) -> Momentum,
) -> Adopted {
    body.wake();
    let reshaped = delta.reshaped(mesh.topology());
    let touched = touched_nodes(body, mesh, delta, &reshaped);
    let before = momentum_of(body, state, &touched);

    edit_nodes(state, &delta.nodes);
    state.positions.resize(mesh.node_slots().max(state.positions.len()), Vec3::ZERO);
    state.velocities.resize(state.positions.len(), Vec3::ZERO);
    body.masses.resize(state.positions.len(), 0.0);
    if body.elements.len() < mesh.tet_slots() {
        body.elements.resize(mesh.tet_slots(), Element::VACANT);
    }
    for tet in &delta.removed {
        if let Some(element) = body.elements.get_mut(tet.index()).filter(|e| !e.is_empty()) {
            body.graph.remove(tet.index(), element.nodes);
            *element = Element::VACANT;
        }
        body.colouring.remove(*tet);
    }
    for tet in &reshaped {
        body.elements[tet.index()] = body.element(mesh, *tet);
    }
    for added in &delta.added {
        body.elements[added.tet.index()] = body.element(mesh, added.tet);
        body.graph.insert(added.tet.index(), added.nodes.map(|n| n.0));
        body.colouring.insert(added.tet, added.nodes, mesh.topology());
    }
    for node in &touched {
        body.lump(mesh, *node);
    }
    body.xpbd.adopt(mesh, &body.elements, &body.colouring, delta);
    body.implicit.newton.adopt(mesh, &body.elements, delta, &reshaped, &touched);

    let left = departed(state);
    let after = momentum_of(body, state, &touched).plus(left);
    let given_back = if after.mass > 0.0 { ((before.linear - after.linear) / after.mass).as_vec3() } else { Vec3::ZERO };
    for node in &touched {
        if body.masses[node.index()] > 0.0 {
            state.velocities[node.index()] += given_back;
        }
    }
    let mut left_settled = left;
    left_settled.linear += given_back.as_dvec3() * left.mass;
    let settled = momentum_of(body, state, &touched).plus(left_settled);
    Adopted { before, after, settled, given_back }
}

/// All nodes whose mass or state may change, ascending.
fn touched_nodes(body: &Body, mesh: &TetMesh, delta: &TopologyDelta, reshaped: &[TetId]) -> Vec<NodeId> {
    let mut nodes: Vec<NodeId> = delta.added.iter().flat_map(|a| a.nodes).collect();
    for tet in &delta.removed {
        if let Some(element) = body.elements.get(tet.index()).filter(|e| !e.is_empty()) {
            nodes.extend(element.nodes.map(NodeId));
        }
    }
    nodes.extend(reshaped.iter().flat_map(|t| mesh.corners(*t)));
    nodes.extend(delta.nodes.iter().map(|edit| match edit {
        NodeEdit::Added { node, .. } | NodeEdit::Moved { node, .. } | NodeEdit::Split { node, .. } | NodeEdit::Removed { node } => *node,
    }));
    nodes.sort_unstable();
    nodes.dedup();
    nodes
}

fn momentum_of(body: &Body, state: &TissueState, nodes: &[NodeId]) -> Momentum {
    let mut sum = Momentum::default();
    for i in nodes.iter().map(|n| n.index()) {
        if let Some(mass) = body.masses.get(i).filter(|m| **m > 0.0) {
            sum.add(*mass, state.positions[i], state.velocities[i]);
        }
    }
    sum
}

fn weighted(values: &[Vec3], from: &NodeWeights) -> Vec3 {
    from.iter().map(|(node, weight)| values[node.index()].as_dvec3() * *weight).sum::<DVec3>().as_vec3()
}
