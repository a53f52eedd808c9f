//! Between two ticks: how far the picture is from the tick before to the newest one.

use bevy::ecs::system::SystemParam;
use bevy::prelude::*;

/// How motion is shown between ticks.
#[derive(Resource, Clone, Copy, Debug, PartialEq, Eq)]
pub enum MotionSettings {
    /// Between the last two ticks: smooth, up to one tick late. The default.
    Blend,
    /// The newest tick as it is: what a picture of a chosen moment needs.
    Newest,
}

/// Access to the fraction of the way from the tick before (0) to the newest tick (1).
#[derive(SystemParam)]
pub struct Smoothing<'w> {
    settings: Res<'w, MotionSettings>,
    fixed: Res<'w, Time<Fixed>>,
}

impl Smoothing<'_> {
    /// The fraction, in [0, 1].
    #[must_use]
    pub fn fraction(&self) -> f32 {
        match *self.settings {
            MotionSettings::Blend => self.fixed.overstep_fraction(),
            MotionSettings::Newest => 1.0,
        }
    }
}
