//! Jaws that hold tissue.

use bevy_ecs::prelude::*;
use bevy_math::Vec3;

/// The pads of an instrument's jaws: what tissue is held between. An instrument without them holds nothing. Written by the scene, or by instruments
/// from the kind.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
#[require(Grasp)]
pub struct JawPads {
    /// From the pivot of the jaws to the near end of the pads, m.
    pub from_m: f32,
    /// From the pivot to their far end, m.
    pub to_m: f32,
    /// Half of their width, m.
    pub half_width_m: f32,
    /// From the middle plane to each pad when the jaws are closed, m; above zero.
    pub closed_gap_m: f32,
}

/// What the jaws hold now. Written by grasping; the angle read by instruments.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct Grasp {
    /// Points of the pads that hold tissue.
    pub points: u32,
    /// Force with which each jaw presses on what is between them, mean of both, N.
    pub pinch_n: f32,
    /// Force of the tissue on the jaws, both together, N.
    pub pull_n: Vec3,
    /// Points that slid on their pads in the last tick.
    pub sliding: u32,
    /// The tissue between the jaws lets them close no further than to this angle from the shaft's axis, rad; zero when nothing is between them.
    pub least_angle_rad: f32,
}
