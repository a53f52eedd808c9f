//! The kinematics of a trocar: four degrees of freedom about a port, forward and inverse.
//!
//! The frame of a port: `forward` into the body, `up` the world's Y made perpendicular to it, `right` = `forward` x `up`. With yaw `y`
//! and pitch `p` the shaft points along `cos p (cos y forward + sin y right) + sin p up`, and the instrument's pivot lies `insertion` along
//! it. The shaft passes the port by construction.

use bevy_ecs::prelude::*;
use bevy_math::{Isometry3d, Mat3, Quat, Vec3};
use keyhole_whiteboard::Port;

/// Where an instrument stands in its port. Written by instruments; its first value by the scene.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct TrocarState {
    /// Angle to the port's right, rad.
    pub yaw_rad: f32,
    /// Angle upwards, rad.
    pub pitch_rad: f32,
    /// From the port to the origin of the instrument's frame, m.
    pub insertion_m: f32,
    /// About the shaft, rad, right-handed about the direction of insertion. Of an endoscope: of the scope against the camera head.
    pub roll_rad: f32,
    /// 0 open to 1 closed.
    pub grip: f32,
    /// Whether the pedal is down: hook and scalpel cut while it is.
    pub pedal: bool,
}

/// How far the degrees of freedom go.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct TrocarLimits {
    /// Largest angle from the port's inward direction in yaw and in pitch, rad. Below pi/2.
    pub angle_rad: f32,
    /// Smallest insertion, m: the tip stays inside the body.
    pub insertion_min_m: f32,
    /// Largest insertion, m: the handle stays outside.
    pub insertion_max_m: f32,
}

impl Default for TrocarLimits {
    /// 75 degrees, 1 cm to 30 cm: a laparoscope and its instruments are 30 to 35 cm long.
    fn default() -> Self {
        Self { angle_rad: 75f32.to_radians(), insertion_min_m: 0.01, insertion_max_m: 0.30 }
    }
}

impl TrocarLimits {
    /// The nearest state within the limits; the grip into 0 to 1.
    #[must_use]
    pub fn clamp(&self, state: TrocarState) -> TrocarState {
        TrocarState {
            yaw_rad: state.yaw_rad.clamp(-self.angle_rad, self.angle_rad),
            pitch_rad: state.pitch_rad.clamp(-self.angle_rad, self.angle_rad),
            insertion_m: state.insertion_m.clamp(self.insertion_min_m, self.insertion_max_m),
            grip: state.grip.clamp(0.0, 1.0),
            ..state
        }
    }
}

/// A port with its three axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PortFrame {
    /// The pivot in the world, m.
    pub position: Vec3,
    /// Into the body.
    pub forward: Vec3,
    /// Yaw is towards here.
    pub right: Vec3,
    /// Pitch is towards here.
    pub up: Vec3,
}

impl PortFrame {
    /// The axes of a port. A port that points straight up or down takes the world's -Z for its up.
    #[must_use]
    pub fn of(port: &Port) -> Self {
        let forward = port.inward.normalize_or(Vec3::NEG_Y);
        // A quarter of a degree from the vertical the world's up no longer tells a direction.
        let reference = if forward.cross(Vec3::Y).length() > 0.25f32.to_radians() { Vec3::Y } else { Vec3::NEG_Z };
        let right = forward.cross(reference).normalize();
        Self { position: port.position, forward, right, up: right.cross(forward) }
    }

    /// Unit vector along the shaft, into the body.
    #[must_use]
    pub fn shaft(&self, yaw_rad: f32, pitch_rad: f32) -> Vec3 {
        let ((sy, cy), (sp, cp)) = (yaw_rad.sin_cos(), pitch_rad.sin_cos());
        cp * (cy * self.forward + sy * self.right) + sp * self.up
    }

    /// Frame of the instrument in the world: origin at the pivot of the jaws, -Z along the shaft, Y up when the roll is zero.
    #[must_use]
    pub fn pose(&self, state: &TrocarState) -> Isometry3d {
        let along = self.shaft(state.yaw_rad, state.pitch_rad);
        let (sy, cy) = state.yaw_rad.sin_cos();
        let x = cy * self.right - sy * self.forward;
        let level = Quat::from_mat3(&Mat3::from_cols(x, along.cross(-x), -along));
        Isometry3d::new(self.position + state.insertion_m * along, level * Quat::from_rotation_z(-state.roll_rad))
    }

    /// Yaw and pitch (rad) of a shaft towards a direction of the world. `None` for a zero or non-finite direction.
    #[must_use]
    pub fn angles(&self, direction: Vec3) -> Option<(f32, f32)> {
        let d = direction.try_normalize()?;
        Some((d.dot(self.right).atan2(d.dot(self.forward)), d.dot(self.up).clamp(-1.0, 1.0).asin()))
    }

    /// The state whose point `reach_m` ahead of the frame's origin on the shaft's axis is at `tip` (world, m); roll, grip and pedal stay
    /// as in `state`. `None` when the tip is at the port or not finite.
    #[must_use]
    pub fn reach(&self, tip: Vec3, reach_m: f32, state: &TrocarState) -> Option<TrocarState> {
        let to = tip - self.position;
        let (yaw_rad, pitch_rad) = self.angles(to)?;
        Some(TrocarState { yaw_rad, pitch_rad, insertion_m: to.length() - reach_m, ..*state })
    }

    /// The state of an endoscope whose view, tilted down from the shaft by `tilt_rad`, has `target` (world, m) in its centre, from a tip
    /// `distance_m` away from it.
    ///
    /// In the triangle of port, tip and target the view turns by the tilt at the tip, so with `D` from port to target the shaft passes
    /// above the target by `asin(distance sin(tilt) / D)` and is inserted by `sqrt(D^2 - distance^2 sin^2(tilt)) - distance cos(tilt)`.
    /// `None` when no such triangle is there: the target is nearer to the port than `distance_m sin(tilt)`.
    #[must_use]
    pub fn look_at(&self, target: Vec3, distance_m: f32, tilt_rad: f32, state: &TrocarState) -> Option<TrocarState> {
        let to = target - self.position;
        let (yaw_rad, pitch_rad) = self.angles(to)?;
        let (sin, cos) = tilt_rad.sin_cos();
        let sine = distance_m * sin / to.length();
        if !(-1.0..=1.0).contains(&sine) {
            return None;
        }
        let insertion_m = to.length() * (1.0 - sine * sine).sqrt() - distance_m * cos;
        Some(TrocarState { yaw_rad, pitch_rad: pitch_rad + sine.asin(), insertion_m, roll_rad: 0.0, ..*state })
    }
}

/// The state after the trainee's hand moved the handle by `right_m` and `up_m` (m, along the port's right and up).
///
/// The motion is mirrored about the port and scaled by inside length over outside length: the handle is `shaft_length_m - insertion`
/// outside, so the angle is the motion over that, and the tip goes the other way.
#[must_use]
pub fn move_handle(state: TrocarState, shaft_length_m: f32, right_m: f32, up_m: f32) -> TrocarState {
    // A hand cannot hold the shaft nearer to the port than a tenth of its length.
    let outside = (shaft_length_m - state.insertion_m).max(0.1 * shaft_length_m);
    TrocarState { yaw_rad: state.yaw_rad - right_m / outside, pitch_rad: state.pitch_rad - up_m / outside, ..state }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn unit() -> impl Strategy<Value = Vec3> {
        (-1f32..1.0, -1f32..1.0, -1f32..1.0).prop_filter_map("not zero", |(x, y, z)| {
            let v = Vec3::new(x, y, z);
            (v.length() > 0.1).then(|| v.normalize())
        })
    }

    fn port() -> impl Strategy<Value = PortFrame> {
        ((-0.3f32..0.3, -0.3f32..0.3, -0.3f32..0.3), unit())
            .prop_map(|(p, inward)| PortFrame::of(&Port { position: Vec3::from(p), inward }))
    }

    fn state() -> impl Strategy<Value = TrocarState> {
        (-1.2f32..1.2, -1.2f32..1.2, 0.02f32..0.3, -3f32..3.0).prop_map(|(yaw_rad, pitch_rad, insertion_m, roll_rad)| TrocarState {
            yaw_rad,
            pitch_rad,
            insertion_m,
            roll_rad,
            ..Default::default()
        })
    }

    proptest! {
        #[test]
        fn the_shaft_passes_its_port(port in port(), state in state(), shaft in 0.3f32..0.4) {
            let pose = port.pose(&state);
            let (tip, handle) = (Vec3::from(pose.translation), pose * Vec3::new(0.0, 0.0, shaft));
            let along = (handle - tip).normalize();
            let off = (port.position - tip).reject_from_normalized(along).length();
            prop_assert!(off < 1e-5 * shaft, "{off} m off the port");
            prop_assert!((handle.distance(tip) - shaft).abs() < 1e-5 * shaft);
        }

        #[test]
        fn inverse_undoes_forward(port in port(), state in state(), reach in 0f32..0.08) {
            let pose = port.pose(&state);
            let tip = pose * Vec3::new(0.0, 0.0, -reach);
            let back = port.reach(tip, reach, &state).unwrap();
            prop_assert!((back.yaw_rad - state.yaw_rad).abs() < 1e-3);
            prop_assert!((back.pitch_rad - state.pitch_rad).abs() < 1e-3);
            prop_assert!((back.insertion_m - state.insertion_m).abs() < 1e-6);
            prop_assert_eq!(back.roll_rad, state.roll_rad);
        }

        #[test]
        fn the_frame_is_right_handed_with_up_above(port in port(), state in state()) {
            let pose = port.pose(&TrocarState { roll_rad: 0.0, ..state });
            let (x, y, z) = (pose.rotation * Vec3::X, pose.rotation * Vec3::Y, pose.rotation * Vec3::Z);
            prop_assert!(x.cross(y).distance(z) < 1e-4);
            prop_assert!(y.dot(port.up) > 0.0);
            prop_assert!((z + port.shaft(state.yaw_rad, state.pitch_rad)).length() < 1e-4);
        }

        #[test]
        fn the_tip_mirrors_the_handle(port in port(), insertion in 0.05f32..0.2, (dx, dy) in (-1e-3f32..1e-3, -1e-3f32..1e-3)) {
            let shaft = 0.33f32;
            let before = TrocarState { insertion_m: insertion, ..Default::default() };
            let after = move_handle(before, shaft, dx, dy);
            let (a, b) = (port.pose(&before), port.pose(&after));
            let tip = Vec3::from(b.translation - a.translation);
            let handle = (b * Vec3::new(0.0, 0.0, shaft)) - (a * Vec3::new(0.0, 0.0, shaft));
            // To first order: the rest is of the second in the angle, here below 1 mm / 13 cm.
            prop_assert!((handle - dx * port.right - dy * port.up).length() < 2e-5);
            prop_assert!((tip + handle * insertion / (shaft - insertion)).length() < 2e-5);
        }

        #[test]
        fn the_view_meets_its_target(port in port(), (yaw, pitch) in (-0.8f32..0.8, -0.4f32..0.4), far in 0.1f32..0.3, near in 0.02f32..0.08) {
            let tilt = 30f32.to_radians();
            let target = port.position + far * port.shaft(yaw, pitch);
            let state = port.look_at(target, near, tilt, &TrocarState::default()).unwrap();
            let pose = port.pose(&state);
            let view = pose.rotation * (Quat::from_rotation_x(-tilt) * Vec3::NEG_Z);
            prop_assert!((Vec3::from(pose.translation) + near * view).distance(target) < 1e-4 * far);
        }
    }

    #[test]
    fn a_vertical_port_has_a_frame() {
        let port = PortFrame::of(&Port { position: Vec3::ZERO, inward: Vec3::NEG_Y });
        let pose = port.pose(&TrocarState { insertion_m: 0.1, ..Default::default() });
        assert!(Vec3::from(pose.translation).distance(Vec3::new(0.0, -0.1, 0.0)) < 1e-6);
        assert!(port.right.distance(Vec3::X) < 1e-6, "{:?}", port.right);
    }
}
