//! What the hand feels: everything that pushes and pulls an instrument, as one force on a line.

use bevy_math::Vec3;
use keyhole_whiteboard::ToolForce;

/// Sums forces and their torques about the port.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Felt {
    /// Force, N.
    pub force_n: Vec3,
    /// Torque about the port, N m.
    pub torque_n_m: Vec3,
}

impl Felt {
    /// Adds a force (N) that acts at a place `from_port` away from the port (m).
    pub fn add(&mut self, force_n: Vec3, from_port: Vec3) {
        self.force_n += force_n;
        self.torque_n_m += from_port.cross(force_n);
    }

    /// As one force on a line: at the line's point nearest to the port it has the same torque about it, but for the part that twists about the line
    /// itself, which no single force has. Where no force is left it acts at `tip` (m, in the world, as `port` is).
    #[must_use]
    pub fn on_a_line(&self, port: Vec3, tip: Vec3, grip_n: f32) -> ToolForce {
        let arm = self.force_n.cross(self.torque_n_m) / self.force_n.length_squared();
        ToolForce { force_n: self.force_n, at: if arm.is_finite() { port + arm } else { tip }, grip_n }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_force_does_what_several_do() {
        let port = Vec3::new(0.2, 0.1, 0.3);
        let mut felt = Felt::default();
        assert_eq!(felt.on_a_line(port, Vec3::ONE, 2.0), ToolForce { force_n: Vec3::ZERO, at: Vec3::ONE, grip_n: 2.0 });
        // All in a plane, so that nothing twists.
        for (force, at) in [(Vec3::Y, Vec3::new(0.1, 0.0, 0.0)), (Vec3::new(0.5, -3.0, 0.0), Vec3::new(0.2, 0.1, 0.0))] {
            felt.add(force, at);
        }
        let one = felt.on_a_line(port, Vec3::ZERO, 0.0);
        assert_eq!(one.force_n, Vec3::new(0.5, -2.0, 0.0));
        assert!(((one.at - port).cross(one.force_n) - felt.torque_n_m).length() < 1e-6);
    }
}
