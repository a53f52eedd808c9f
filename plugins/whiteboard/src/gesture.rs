//! The order of the gestures within a tick.

use crate::TickSystems;
use bevy_ecs::prelude::*;
use bevy_ecs::schedule::Schedule;

/// The order within [`TickSystems::Gesture`]. Gestures write the same attachments, so that each has its place; one from outside belongs into
/// [`GestureSystems::Further`], and two of those order themselves.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum GestureSystems {
    /// Jaws on tissue.
    Grasp,
    /// Clips.
    Clip,
    /// Needle and thread.
    Suture,
    /// Every other gesture.
    Further,
}

/// Chains the gestures.
pub(crate) fn order(schedule: &mut Schedule) {
    use GestureSystems::{Clip, Further, Grasp, Suture};
    schedule.configure_sets((Grasp, Clip, Suture, Further).chain().in_set(TickSystems::Gesture));
}
