//! The optics of an angled endoscope: where it looks, and how its lens bends the picture.
//!
//! The picture is drawn by a pinhole and then resampled by one full-screen pass (`optics.wgsl`): barrel distortion, the round mask, the
//! fall of light towards the rim, and a notch in the rim that shows the side to which the scope is rolled.

use bevy::core_pipeline::fullscreen_material::FullscreenMaterial;
use bevy::math::Isometry3d;
use bevy::prelude::*;
use bevy::render::{extract_component::ExtractComponent, render_resource::ShaderType};
use bevy::shader::ShaderRef;
use keyhole_whiteboard::Endoscope;

/// Barrel distortion at the rim, as a fraction of the undistorted radius. Laparoscopes measure 7 to 23 % (doi 10.1089/end.2012.0140).
pub const BARREL_DISTORTION: f32 = 0.12;

/// Diameter of the round picture as a fraction of the height of the view.
pub const MASK_DIAMETER: f32 = 0.97;

/// Where the endoscope looks from and to: [`Endoscope::eye_pose`].
#[must_use]
pub fn eye_pose(endoscope: &Endoscope) -> Isometry3d {
    endoscope.eye_pose()
}

/// The lens of a camera that looks through the endoscope.
#[derive(Component, ExtractComponent, Clone, Copy, Debug, Default, PartialEq, ShaderType)]
pub struct Lens {
    /// Coefficient of the distortion, see [`Lens::undistorted`].
    pub kappa: f32,
    /// [`MASK_DIAMETER`].
    pub mask_diameter: f32,
    /// Where the notch is, rad anticlockwise from the right of the picture.
    pub notch_rad: f32,
    /// Light lost at the rim, as a fraction.
    pub falloff: f32,
}

impl Lens {
    /// The lens of an endoscope.
    #[must_use]
    pub fn of(endoscope: &Endoscope) -> Self {
        Self {
            kappa: BARREL_DISTORTION / (1.0 - BARREL_DISTORTION),
            mask_diameter: MASK_DIAMETER,
            notch_rad: endoscope.roll_rad - std::f32::consts::FRAC_PI_2,
            falloff: 0.35,
        }
    }

    /// The radius in the pinhole's picture that is seen at radius `r` of the round picture, both with the rim at 1:
    /// `r (1 + kappa r^2) / (1 + kappa)`. Undistorted by the scale of its centre, `1 / (1 + kappa)`, the rim would be at `1 + kappa`: the
    /// distortion there is `-kappa / (1 + kappa)`.
    #[must_use]
    pub fn undistorted(&self, r: f32) -> f32 {
        r * (1.0 + self.kappa * r * r) / (1.0 + self.kappa)
    }
}

impl FullscreenMaterial for Lens {
    fn fragment_shader() -> ShaderRef {
        "embedded://keyhole_view/optics.wgsl".into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scope(view: f32, roll: f32) -> Endoscope {
        let pose = Isometry3d::new(Vec3::new(0.1, 0.2, 0.3), Quat::from_euler(EulerRot::YXZ, 0.7, -0.4, 0.0));
        Endoscope { pose, direction_of_view_rad: view, angle_of_view_rad: 1.2, roll_rad: roll }
    }

    #[test]
    fn the_view_is_tilted_by_the_direction_of_view_at_every_roll() {
        for roll in [0.0, 0.4, 1.9, -2.5] {
            let scope = scope(0.52, roll);
            let eye = eye_pose(&scope);
            let angle = (eye.rotation * Vec3::NEG_Z).angle_between(scope.pose.rotation * Vec3::NEG_Z);
            assert!((angle - 0.52).abs() < 1e-4, "{angle} at roll {roll}");
            assert_eq!(eye.translation, scope.pose.translation);
        }
        let down = eye_pose(&scope(0.52, 0.0)).rotation * Vec3::NEG_Z;
        let expected = scope(0.52, 0.0).pose.rotation * Vec3::new(0.0, -0.52_f32.sin(), -0.52_f32.cos());
        assert!(down.distance(expected) < 1e-6);
        let straight = scope(0.0, 1.0);
        assert!((eye_pose(&straight).rotation * Vec3::Y).distance(straight.pose.rotation * Vec3::Y) < 1e-6);
    }

    #[test]
    fn roll_orbits_the_view_and_keeps_the_horizon() {
        let view = 30_f32.to_radians();
        for step in 0..24 {
            let roll = f32::to_radians(15.0 * step as f32);
            let scope = scope(view, roll);
            let eye = eye_pose(&scope);
            // The view's direction seen along the shaft has turned by the roll.
            let seen = scope.pose.rotation.inverse() * (eye.rotation * Vec3::NEG_Z);
            let turned = Quat::from_rotation_z(roll) * Vec3::new(0.0, -view.sin(), -view.cos());
            assert!(seen.distance(turned) < 1e-5);
            // The shaft's up, seen in the picture, stays up.
            let up = eye.rotation.inverse() * (scope.pose.rotation * Vec3::Y);
            let tilt = up.x.atan2(up.y).abs();
            assert!(tilt.tan() <= (1.0 - view.cos()) / (2.0 * view.cos().sqrt()) + 1e-5, "{tilt} at roll {roll}");
            if step % 6 == 0 {
                assert!(tilt < 1e-5, "{tilt} at roll {roll}");
            }
        }
    }

    #[test]
    fn the_lens_has_its_distortion_and_keeps_the_rim() {
        let lens = Lens::of(&scope(0.5, 0.0));
        assert!((lens.undistorted(1.0) - 1.0).abs() < 1e-6);
        let centre_scale = lens.undistorted(1e-3) / 1e-3;
        // The rim of an undistorted picture with the centre's magnification lies at 1 / scale.
        let distortion = 1.0 - centre_scale.recip();
        assert!((distortion * centre_scale + BARREL_DISTORTION).abs() < 1e-5, "{distortion}");
    }
}
