//! Voxels, patient and world: the three frames, and the one function that goes from patient to world.

use glam::{DAffine3, DMat3, DVec3};

/// World metres of a patient point in DICOM's LPS+ axes, mm.
///
/// The world is right-handed with Y up, the patient stands in it and faces the camera's side:
/// X = patient left (L), Y = superior (S), Z = anterior (A = -P). L x S = A, so the map is a rotation and keeps left and right.
#[must_use]
pub fn world_from_patient(lps_mm: DVec3) -> DVec3 {
    DVec3::new(lps_mm.x, lps_mm.z, -lps_mm.y) * 1e-3
}

/// Patient point (LPS+, mm) of a world point, metres: the inverse of [`world_from_patient`].
#[must_use]
pub fn patient_from_world(world_m: DVec3) -> DVec3 {
    DVec3::new(world_m.x, -world_m.z, world_m.y) * 1e3
}

/// LPS+ of an affine whose output is NIfTI's RAS+: x and y change sign.
#[must_use]
pub(crate) fn lps_from_ras(ras: DAffine3) -> DAffine3 {
    DAffine3::from_mat3(DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0))) * ras
}

/// Lengths of the voxel axes, mm.
#[must_use]
pub(crate) fn spacing(voxel_to_lps: &DAffine3) -> DVec3 {
    let m = voxel_to_lps.matrix3;
    DVec3::new(m.x_axis.length(), m.y_axis.length(), m.z_axis.length())
}

/// Largest deviation of two voxel axes from a right angle, degrees.
#[must_use]
pub(crate) fn shear_degrees(voxel_to_lps: &DAffine3) -> f64 {
    let m = voxel_to_lps.matrix3;
    let off = |a: DVec3, b: DVec3| (a.normalize().dot(b.normalize())).abs().min(1.0).asin().to_degrees();
    off(m.x_axis, m.y_axis).max(off(m.y_axis, m.z_axis)).max(off(m.z_axis, m.x_axis))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn world_is_a_rotation_of_the_patient() {
        let [l, p, s] = [DVec3::X, DVec3::Y, DVec3::Z].map(|v| world_from_patient(v) * 1e3);
        assert_eq!((l, s, -p), (DVec3::X, DVec3::Y, DVec3::Z));
        assert!((l.cross(p) - s).length() < 1e-12, "handedness is kept");
        let q = DVec3::new(1.0, -2.0, 3.0);
        assert!((patient_from_world(world_from_patient(q)) - q).length() < 1e-12);
    }
}
