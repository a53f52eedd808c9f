//! Between the vectors of this house and those of rapier, which carries another glam and other units: its lengths are centimetres. No other file of this
//! crate knows both.
//!
//! Parry's tolerances are absolute numbers made for things of about one unit. In metres a clip is as small as they are, and a tilted one falls
//! through a floor of small triangles.

use bevy_math::{Isometry3d, Mat3, Quat, Vec3};
use rapier3d::math::{Matrix, Pose, Rotation, Vector};

/// Rapier's unit of length, m.
const LENGTH_UNIT_M: f32 = 0.01;

/// Of a length, a velocity or an acceleration, m.
pub(crate) fn to_rapier(v: Vec3) -> Vector {
    Vector::from_array((v / LENGTH_UNIT_M).to_array())
}

/// Back to metres.
pub(crate) fn from_rapier(v: Vector) -> Vec3 {
    Vec3::from_array(v.to_array()) * LENGTH_UNIT_M
}

pub(crate) fn length_to_rapier(length_m: f32) -> f32 {
    length_m / LENGTH_UNIT_M
}

/// Of what has no length in it: an angular velocity.
pub(crate) fn turn_to_rapier(v: Vec3) -> Vector {
    Vector::from_array(v.to_array())
}

pub(crate) fn turn_from_rapier(v: Vector) -> Vec3 {
    Vec3::from_array(v.to_array())
}

pub(crate) fn matrix_to_rapier(m: Mat3) -> Matrix {
    Matrix::from_cols_array(&m.to_cols_array())
}

pub(crate) fn pose_to_rapier(pose: Isometry3d) -> Pose {
    Pose::from_parts(to_rapier(pose.translation.into()), Rotation::from_array(pose.rotation.to_array()))
}

pub(crate) fn pose_from_rapier(pose: &Pose) -> Isometry3d {
    Isometry3d::new(from_rapier(pose.translation), Quat::from_array(pose.rotation.to_array()))
}
