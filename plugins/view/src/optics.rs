//! The optics of an angled endoscope: where it looks, and how its lens bends the picture.
//!
//! The picture is drawn by a pinhole and then resampled by one full-screen pass (`optics.wgsl`): barrel distortion, the round mask, the
//! fall of light towards the rim, fog, and a notch in the rim that shows the side to which the scope is rolled.

use bevy::core_pipeline::fullscreen_material::FullscreenMaterial;
use bevy::math::Isometry3d;
use bevy::prelude::*;
use bevy::render::{extract_component::ExtractComponent, render_resource::ShaderType};
use bevy::shader::ShaderRef;
use keyhole_whiteboard::{Endoscope, ScopeOptics};

/// Diameter of the round picture as a fraction of the height of the view.
pub const MASK_DIAMETER: f32 = 0.97;

/// Steps of the inverse of the distortion: an interval of 1 has the width of the last bit of an f32 after 24.
const HALVINGS: u32 = 26;

/// Where the endoscope looks from and to: [`Endoscope::eye_pose`].
#[must_use]
pub fn eye_pose(endoscope: &Endoscope) -> Isometry3d {
    endoscope.eye_pose()
}

/// The lens of a camera that looks through the endoscope.
#[derive(Component, ExtractComponent, Clone, Copy, Debug, Default, PartialEq, ShaderType)]
pub struct Lens {
    /// The part of the target that the picture is in: left, top, width, height, pixels. Without a width the whole target.
    pub viewport: Vec4,
    /// First coefficient of the distortion, see [`ScopeOptics::distortion`].
    pub k1: f32,
    /// Second coefficient.
    pub k2: f32,
    /// [`MASK_DIAMETER`].
    pub mask_diameter: f32,
    /// Where the notch is, rad anticlockwise from the right of the picture.
    pub notch_rad: f32,
    /// Light lost at the rim, as a fraction.
    pub falloff: f32,
    /// How fogged the lens is, 0 to 1.
    pub fog: f32,
}

impl Lens {
    /// The lens of an endoscope, clean, over the whole target.
    #[must_use]
    pub fn of(endoscope: &Endoscope, optics: &ScopeOptics) -> Self {
        let [k1, k2] = optics.distortion;
        Self {
            viewport: Vec4::ZERO,
            k1,
            k2,
            mask_diameter: MASK_DIAMETER,
            notch_rad: endoscope.roll_rad - endoscope.head_roll_rad - std::f32::consts::FRAC_PI_2,
            falloff: 0.35,
            fog: 0.0,
        }
    }

    /// The radius in the pinhole's picture that is seen at radius `r` of the round picture, both with the rim at 1: see
    /// [`ScopeOptics::distortion`]. The shader has the same.
    #[must_use]
    pub fn undistorted(&self, r: f32) -> f32 {
        let r2 = r * r;
        r * (1.0 + r2 * (self.k1 + self.k2 * r2)) / (1.0 + self.k1 + self.k2)
    }

    /// The radius of the round picture at which the pinhole's radius `r`, 0 to 1, is seen: the inverse of [`Lens::undistorted`], by bisection,
    /// for what a scene may have for coefficients grows from rim to rim.
    #[must_use]
    pub fn distorted(&self, r: f32) -> f32 {
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            if self.undistorted(middle) < r { low = middle } else { high = middle }
        }
        0.5 * (low + high)
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
    use proptest::prelude::*;

    fn scope(view: f32, roll: f32) -> Endoscope {
        let pose = Isometry3d::new(Vec3::new(0.1, 0.2, 0.3), Quat::from_euler(EulerRot::YXZ, 0.7, -0.4, 0.0));
        Endoscope { pose, direction_of_view_rad: view, angle_of_view_rad: 1.2, roll_rad: roll, head_roll_rad: 0.0 }
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

    /// The camera head turns the picture about its middle and nothing else: the horizon is off by as much, and the notch goes with the scope.
    #[test]
    fn rolling_the_camera_head_loses_the_horizon() {
        let level = scope(0.5, 0.3);
        for head in [-1.2, 0.4, 2.0] {
            let rolled = Endoscope { head_roll_rad: head, ..level };
            let (before, after) = (eye_pose(&level).rotation, eye_pose(&rolled).rotation);
            assert!((before * Vec3::NEG_Z).distance(after * Vec3::NEG_Z) < 1e-6);
            let up = after.inverse() * (before * Vec3::Y);
            assert!((up.x - head.sin()).abs() < 1e-5 && (up.y - head.cos()).abs() < 1e-5, "{up}");
            let optics = ScopeOptics::default();
            let turned = Lens::of(&level, &optics).notch_rad - Lens::of(&rolled, &optics).notch_rad;
            assert!((turned - head).abs() < 1e-6);
        }
    }

    #[test]
    fn the_lens_has_its_distortion_and_keeps_the_rim() {
        let optics = ScopeOptics::default();
        let lens = Lens::of(&scope(0.5, 0.0), &optics);
        assert!((lens.undistorted(1.0) - 1.0).abs() < 1e-6);
        // With the middle's magnification the rim, which the pinhole has at 1, would be at 1 / slope.
        let slope = lens.undistorted(1e-3) / 1e-3;
        assert!((1.0 - slope - ScopeOptics::DISTORTION).abs() < 1e-5, "{slope}");
        assert!((optics.distortion_at_rim() - ScopeOptics::DISTORTION).abs() < 1e-6);
    }

    proptest! {
        /// Over all coefficients that a scene may have the mapping grows, and its inverse undoes it.
        #[test]
        fn the_inverse_undoes_the_distortion(k1 in -0.3_f32..1.0, k2 in -0.15_f32..1.0, r in 0.0_f32..1.0) {
            prop_assume!((0.0..=1.0).contains(&(k1 + k2)));
            let lens = Lens { k1, k2, ..Lens::default() };
            prop_assert!((lens.undistorted(1.0) - 1.0).abs() < 1e-5);
            prop_assert!(lens.undistorted(r + 1e-3) > lens.undistorted(r));
            prop_assert!((lens.undistorted(lens.distorted(r)) - r).abs() < 1e-5);
            prop_assert!((lens.distorted(lens.undistorted(r)) - r).abs() < 1e-5);
        }
    }
}
