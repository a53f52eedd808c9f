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

/// What the jaws hold now. Written by grasping; the angle read by instruments, whether they grip by collision.
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
    /// Whether the jaws take hold of what they touch: since they began to close, until they open.
    pub takes: bool,
}

impl Grasp {
    /// Whether what lies on the pads is held by them: collision leaves it alone.
    #[must_use]
    pub fn grips(&self) -> bool {
        self.takes || self.points > 0
    }
}

/// Pressure of a pad (Pa) beyond which it bruises an organ; an organ without it is as the settings of grasping say. Written by the scene.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct PinchLimit(pub f32);

/// How badly an organ has been bruised by pads that pressed too hard. On every organ. Written by grasping.
#[derive(Component, Clone, Debug, Default, PartialEq)]
pub struct Bruises {
    /// By node slot, from 0, sound, to 1, at twice the pressure that the organ bears; nodes beyond the end are sound.
    pub by_node: Vec<f32>,
}

/// What grasping has to report since the scene started. Written by grasping.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq)]
pub struct GraspReport {
    /// Grasps that bruised something: each counts once, however long it lasts.
    pub bruising: u64,
    /// Area of the pads under which tissue was bruised, m2: each part of a pad counts once a grasp.
    pub bruised_m2: f32,
    /// Greatest pressure of a part of a pad, Pa.
    pub most_pa: f32,
}
