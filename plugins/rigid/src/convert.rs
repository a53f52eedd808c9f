//! Between the vectors of this house and those of rapier, which carries another glam. No other file of this crate knows both.

use bevy_math::{Isometry3d, Mat3, Quat, Vec3};
use rapier3d::math::{Matrix, Pose, Rotation, Vector};

pub(crate) fn to_rapier(v: Vec3) -> Vector {
    Vector::from_array(v.to_array())
}

pub(crate) fn from_rapier(v: Vector) -> Vec3 {
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
