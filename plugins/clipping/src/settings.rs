//! How clips close and hold.

use bevy_ecs::prelude::*;

/// How clips close and hold.
#[derive(Resource, Clone, Copy, Debug, PartialEq)]
pub struct ClipSettings {
    /// Stiffness of the legs against the tissue, over their whole length, N/m. Default 20 000, as of a grasper's pads.
    pub stiffness_n_m: f32,
    /// Speed at which the legs come together, m/s. Default 0.04: the last 8 mm in a fifth of a second.
    pub closing_m_s: f32,
    /// Angle of the jaws from the shaft's axis below which a grasper's jaws hold a clip that is between them, rad. Default 0.15; they let it go at half as
    /// much again.
    pub grip_rad: f32,
}

impl Default for ClipSettings {
    fn default() -> Self {
        Self { stiffness_n_m: 20_000.0, closing_m_s: 0.04, grip_rad: 0.15 }
    }
}
