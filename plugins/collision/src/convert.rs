//! Between the vectors of this house and those of parry, which carries another glam. No other file of this crate knows both.

use bevy_math::{Isometry3d, Vec3};
use parry3d::math::{Pose, Rotation, Vector};

pub(crate) fn to_parry(v: Vec3) -> Vector {
    Vector::from_array(v.to_array())
}

pub(crate) fn from_parry(v: Vector) -> Vec3 {
    Vec3::from_array(v.to_array())
}

pub(crate) fn pose_to_parry(pose: Isometry3d) -> Pose {
    Pose::from_parts(to_parry(pose.translation.into()), Rotation::from_array(pose.rotation.to_array()))
}
