//! What a scene requires, and the laws of its world.

use bevy_ecs::prelude::*;
use bevy_math::Vec3;

/// Gravity, m/s2. Written by the scene.
#[derive(Resource, Clone, Copy, Debug, PartialEq)]
pub struct Gravity(pub Vec3);

impl Default for Gravity {
    fn default() -> Self {
        Self(Vec3::new(0.0, -9.81, 0.0))
    }
}

/// Which modules the scene needs: a module that is not required does not run and allocates nothing. Written by the scene.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SceneRequirements {
    /// There is an organ.
    pub tissue: bool,
    /// There is an instrument with a blade, and an organ.
    pub cutting: bool,
    /// There is an instrument.
    pub instruments: bool,
    /// There is an organ, and something that it may touch: an instrument, another organ, solid anatomy, or itself once it has been cut.
    pub collision: bool,
    /// There is something rigid, or there may be: clips that can drop, a needle, fragments that become rigid.
    pub rigid: bool,
    /// There is a needle.
    pub suturing: bool,
    /// There is a hand, or a view, to be measured.
    pub assessment: bool,
    /// There is a clip applier, or a vessel that can bleed. What is dropped falls only where rigid is required too.
    pub clipping: bool,
}

/// A scene has been taken off the whiteboard: modules let go of what they kept of it, for the next one may not require them. Triggered by the app.
#[derive(Event, Clone, Copy, Debug)]
pub struct SceneCleared;

impl SceneRequirements {
    /// Run condition of tissue.
    #[must_use]
    pub fn tissue(requirements: Res<Self>) -> bool {
        requirements.tissue
    }

    /// Run condition of cutting.
    #[must_use]
    pub fn cutting(requirements: Res<Self>) -> bool {
        requirements.cutting
    }

    /// Run condition of collision.
    #[must_use]
    pub fn collision(requirements: Res<Self>) -> bool {
        requirements.collision
    }

    /// Run condition of rigid.
    #[must_use]
    pub fn rigid(requirements: Res<Self>) -> bool {
        requirements.rigid
    }

    /// Run condition of suturing.
    #[must_use]
    pub fn suturing(requirements: Res<Self>) -> bool {
        requirements.suturing
    }

    /// Run condition of clipping.
    #[must_use]
    pub fn clipping(requirements: Res<Self>) -> bool {
        requirements.clipping
    }

    /// Run condition of instruments.
    #[must_use]
    pub fn instruments(requirements: Res<Self>) -> bool {
        requirements.instruments
    }

    /// Run condition of assessment.
    #[must_use]
    pub fn assessment(requirements: Res<Self>) -> bool {
        requirements.assessment
    }
}
