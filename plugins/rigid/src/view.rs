//! What the endoscope sees.

use bevy_math::{Quat, Vec3};
use keyhole_whiteboard::Endoscope;

/// Whether a ball at a point (m) of a radius (m) is within the round picture, whatever may be in front of it.
#[must_use]
pub fn sees(scope: &Endoscope, centre: Vec3, radius_m: f32) -> bool {
    // The view turns down from the shaft's axis, and about it with the scope's roll.
    let turned = Quat::from_rotation_z(scope.roll_rad) * Quat::from_rotation_x(-scope.direction_of_view_rad);
    let ahead = scope.pose.rotation * turned * Vec3::NEG_Z;
    let to = centre - Vec3::from(scope.pose.translation);
    let distance = to.length();
    if distance <= radius_m {
        return true;
    }
    let widened = scope.angle_of_view_rad / 2.0 + (radius_m / distance).asin();
    ahead.angle_between(to) <= widened
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy_math::Isometry3d;

    /// A scope at the origin along -Z with a view 30 degrees down and 60 across sees from straight ahead to 60 down; rolled by half a turn it sees up.
    #[test]
    fn an_angled_scope_looks_aside() {
        let mut scope = Endoscope {
            pose: Isometry3d::IDENTITY,
            direction_of_view_rad: 30f32.to_radians(),
            angle_of_view_rad: 60f32.to_radians(),
            roll_rad: 0.0,
            head_roll_rad: 0.0,
        };
        let down = |degrees: f32| Quat::from_rotation_x(-degrees.to_radians()) * Vec3::NEG_Z * 0.1;
        let seen = |scope: &Endoscope| [-5.0, 5.0, 55.0, 65.0].map(|angle| sees(scope, down(angle), 0.0));
        assert!(down(5.0).y < 0.0);
        assert_eq!(seen(&scope), [false, true, true, false]);
        scope.roll_rad = std::f32::consts::PI;
        assert_eq!(seen(&scope), [true, false, false, false]);
        assert!(sees(&scope, down(5.0), 0.02) && sees(&scope, Vec3::Z * 0.01, 0.02));
    }
}
