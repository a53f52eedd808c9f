//! The camera of the global view: it orbits the scene while the middle mouse button is held, pans with Shift, zooms with Ctrl and the
//! wheel. The right button and the bare wheel belong to the instruments.

use crate::framing::Framing;
use bevy::input::mouse::{AccumulatedMouseMotion, AccumulatedMouseScroll, MouseScrollUnit};
use bevy::prelude::*;
use keyhole_whiteboard::{GlobalView, PointerClaims, ViewMode};

/// How fast the camera follows the mouse.
#[derive(Resource, Clone, Copy, Debug, PartialEq)]
pub struct OrbitSettings {
    /// rad per pixel. Default 0.006.
    pub turn_rad_per_pixel: f32,
    /// Metres per pixel and metre of distance. Default 0.0009.
    pub pan_per_pixel: f32,
    /// Distance per line of the wheel, as a factor. Default 0.9.
    pub zoom_per_line: f32,
}

impl Default for OrbitSettings {
    fn default() -> Self {
        Self { turn_rad_per_pixel: 0.006, pan_per_pixel: 0.0009, zoom_per_line: 0.9 }
    }
}

/// Where the camera of the global view is.
#[derive(Resource, Clone, Copy, Debug, PartialEq)]
pub struct OrbitState {
    /// What it looks at, m.
    pub focus: Vec3,
    /// About the vertical axis, rad; at zero the camera is on the +Z side.
    pub yaw_rad: f32,
    /// Above the horizontal, rad.
    pub pitch_rad: f32,
    /// From the focus, m.
    pub distance_m: f32,
}

impl Default for OrbitState {
    fn default() -> Self {
        Self { focus: Vec3::ZERO, yaw_rad: 0.55, pitch_rad: 0.5, distance_m: 0.3 }
    }
}

impl OrbitState {
    /// Largest pitch, rad: looking straight down has no up.
    const STEEPEST: f32 = 1.5;

    /// The camera's place in the world.
    #[must_use]
    pub fn transform(&self) -> Transform {
        let back = Quat::from_rotation_y(self.yaw_rad) * Quat::from_rotation_x(-self.pitch_rad) * Vec3::Z;
        Transform::from_translation(self.focus + self.distance_m * back).looking_at(self.focus, Vec3::Y)
    }

    /// A camera at a place that looks at a point.
    #[must_use]
    pub fn looking(eye: Vec3, target: Vec3) -> Self {
        let back = eye - target;
        let level = back.with_y(0.0).length();
        let pitch_rad = back.y.atan2(level).clamp(-Self::STEEPEST, Self::STEEPEST);
        Self { focus: target, yaw_rad: back.x.atan2(back.z), pitch_rad, distance_m: back.length() }
    }

    /// Looks at the whole scene.
    pub fn frame(&mut self, framing: &Framing) {
        self.focus = framing.focus;
        self.distance_m = 5.2 * framing.radius_m;
    }
}

/// Goes where the scene wants the camera when another scene has come; where it says nothing, frames it when it has changed.
pub fn follow_framing(framing: Res<Framing>, wanted: Res<GlobalView>, mut orbit: ResMut<OrbitState>) {
    match wanted.0 {
        Some((eye, target)) if wanted.is_changed() => *orbit = OrbitState::looking(eye, target),
        None if framing.is_changed() => orbit.frame(&framing),
        _ => {}
    }
}

/// Claims the mouse for the camera while it is the camera's.
pub fn claim_mouse(
    mode: Res<ViewMode>,
    buttons: Res<ButtonInput<MouseButton>>,
    keys: Res<ButtonInput<KeyCode>>,
    mut claims: ResMut<PointerClaims>,
) {
    let wanted = buttons.pressed(MouseButton::Middle) || keys.any_pressed([KeyCode::ControlLeft, KeyCode::ControlRight]);
    claims.camera = *mode == ViewMode::Global && wanted && !claims.hud;
}

/// Turns, pans and zooms while the mouse is claimed.
pub fn orbit(
    claims: Res<PointerClaims>,
    settings: Res<OrbitSettings>,
    buttons: Res<ButtonInput<MouseButton>>,
    keys: Res<ButtonInput<KeyCode>>,
    motion: Res<AccumulatedMouseMotion>,
    scroll: Res<AccumulatedMouseScroll>,
    mut orbit: ResMut<OrbitState>,
) {
    if !claims.camera {
        return;
    }
    if buttons.pressed(MouseButton::Middle) && motion.delta != Vec2::ZERO {
        if keys.any_pressed([KeyCode::ShiftLeft, KeyCode::ShiftRight]) {
            let place = orbit.transform();
            let per_pixel = orbit.distance_m * settings.pan_per_pixel;
            orbit.focus += (place.up() * motion.delta.y - place.right() * motion.delta.x) * per_pixel;
        } else {
            let turn = motion.delta * settings.turn_rad_per_pixel;
            orbit.yaw_rad -= turn.x;
            orbit.pitch_rad = (orbit.pitch_rad + turn.y).clamp(-OrbitState::STEEPEST, OrbitState::STEEPEST);
        }
    }
    if scroll.delta.y != 0.0 {
        let lines = match scroll.unit {
            MouseScrollUnit::Line => scroll.delta.y,
            MouseScrollUnit::Pixel => scroll.delta.y / MouseScrollUnit::SCROLL_UNIT_CONVERSION_FACTOR,
        };
        orbit.distance_m *= settings.zoom_per_line.powf(lines);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_camera_looks_at_its_focus_from_its_distance() {
        let orbit = OrbitState { focus: Vec3::new(0.1, 0.2, -0.1), yaw_rad: 2.0, pitch_rad: -0.7, distance_m: 0.4 };
        let place = orbit.transform();
        assert!((place.translation.distance(orbit.focus) - 0.4).abs() < 1e-6);
        assert!((place.translation + 0.4 * place.forward()).distance(orbit.focus) < 1e-6);
        let again = OrbitState::looking(place.translation, orbit.focus).transform();
        assert!(again.translation.distance(place.translation) < 1e-6 && again.forward().distance(*place.forward()) < 1e-5);
        let above = OrbitState { pitch_rad: 0.5, ..orbit }.transform();
        assert!(above.translation.y > orbit.focus.y);
    }
}
