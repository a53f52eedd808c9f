//! How rigid bodies are stepped.

use bevy_ecs::prelude::*;

/// How rigid bodies are stepped.
#[derive(Resource, Clone, Copy, Debug, PartialEq)]
pub struct RigidSettings {
    /// Steps of rapier a tick, each of four of its own substeps. Default 4: with 2 a clip in twenty that falls on its edge passes a floor of small
    /// triangles.
    pub steps: u32,
    /// Coulomb's coefficient of a rigid body without a `SurfaceFriction` of its own. Default 0.3: smooth steel and titanium on wet tissue hold little.
    pub body_friction: f32,
    /// The same of tissue. Default 0.3.
    pub tissue_friction: f32,
    /// The same of anatomy. Default 0.3.
    pub anatomy_friction: f32,
    /// The same of instruments. Default 0.3.
    pub instrument_friction: f32,
    /// For how long a fragment has to be free of every hold before it may become rigid, s: its shape then is what it is frozen in. Default 0.25.
    pub settle_s: f32,
}

impl Default for RigidSettings {
    fn default() -> Self {
        Self { steps: 4, body_friction: 0.3, tissue_friction: 0.3, anatomy_friction: 0.3, instrument_friction: 0.3, settle_s: 0.25 }
    }
}
