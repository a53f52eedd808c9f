//! Non-finite state never spreads: the last finite positions are kept, and put back.

use bevy_math::Vec3;
use keyhole_tetmesh::NodeId;
use keyhole_whiteboard::TissueState;

/// The last finite positions of a body.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Guard {
    positions: Vec<Vec3>,
}

impl Guard {
    /// Keeps the positions when the state is finite. Otherwise puts the last finite ones back, at rest, and names the first node at
    /// fault. A node that had none is put where it is, or else into the middle of the others.
    pub fn check(&mut self, state: &mut TissueState) -> Option<NodeId> {
        let finite = |(x, v): (&Vec3, &Vec3)| x.is_finite() && v.is_finite();
        let Some(fault) = state.positions.iter().zip(&state.velocities).position(|node| !finite(node)) else {
            self.positions.clone_from(&state.positions);
            return None;
        };
        let middle = self.positions.iter().sum::<Vec3>() / self.positions.len().max(1) as f32;
        for (i, x) in state.positions.iter_mut().enumerate() {
            match self.positions.get(i) {
                Some(last) => *x = *last,
                None if !x.is_finite() => *x = middle,
                None => {}
            }
        }
        state.velocities.fill(Vec3::ZERO);
        Some(NodeId(fault as u32))
    }
}
