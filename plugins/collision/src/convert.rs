//! Between the vectors of this house and those of parry, which carries another glam and counts in millimetres here. No other file of this crate knows
//! both.
//!
//! In metres parry's distances between convex shapes of the size of a jaw are wrong: its search for the nearest points ends where squares of lengths
//! come near the rounding of one. A jaw 17.7 mm above a triangle was 20.1 mm away from it, and one 3.7 mm above it touched it.

use bevy_math::{Isometry3d, Vec3};
use parry3d::math::{Pose, Rotation, Vector};

/// Parry's units a metre.
pub(crate) const MM: f32 = 1000.0;

/// A point (m).
pub(crate) fn to_parry(v: Vec3) -> Vector {
    Vector::from_array((v * MM).to_array())
}

/// A point (m).
pub(crate) fn from_parry(v: Vector) -> Vec3 {
    direction_from_parry(v) / MM
}

/// A direction, without a unit.
pub(crate) fn direction_from_parry(v: Vector) -> Vec3 {
    Vec3::from_array(v.to_array())
}

pub(crate) fn pose_to_parry(pose: Isometry3d) -> Pose {
    Pose::from_parts(to_parry(pose.translation.into()), Rotation::from_array(pose.rotation.to_array()))
}
