//! The trainee's hands on mouse and keyboard: what one tick makes of what was gathered at frame rate.

use crate::kinematics::{TrocarLimits, TrocarState, move_handle};
use bevy_ecs::prelude::*;
use keyhole_whiteboard::{HandInput, Moved};

/// Every key and button of this room and what it does.
pub const KEYS: &[(&str, &str)] = &[
    ("Mouse", "moves the handle of the active instrument; the tip goes the other way about the port"),
    ("Mouse wheel", "pushes the active instrument in and pulls it out"),
    ("Left mouse button", "closes the jaws, scissors cut as they close; hook and scalpel cut while it is down"),
    ("Q / E", "roll the active instrument; with C or the right mouse button the camera head, and with it the horizon"),
    ("Tab", "the other hand; the one left behind holds still"),
    ("X", "the active hand changes its instrument, if the scene has others for it"),
    ("C or right mouse button", "held: the mouse moves the endoscope, the wheel pushes it in and pulls it out"),
    ("Shift", "with C or the right mouse button: the wheel turns the angled scope about its shaft"),
];

/// How motion of mouse and keys becomes motion of a hand.
#[derive(Resource, Clone, Copy, Debug, PartialEq)]
pub struct HandSettings {
    /// Motion of the handle per count of the mouse, m. Default 0.3 mm.
    pub metres_per_count: f32,
    /// Insertion per notch of the wheel, m. Default 4 mm.
    pub metres_per_notch: f32,
    /// Speed of rolling while a key is held, rad/s. Default 2.
    pub roll_rad_s: f32,
    /// Turn of an angled scope per notch of the wheel, rad. Default 5 degrees.
    pub scope_roll_rad_per_notch: f32,
    /// Turn of the endoscope about its port per count of the mouse, rad. Default 0.06 degrees.
    pub scope_rad_per_count: f32,
    /// Time in which the jaws close or open, s. Default 0.2.
    pub grip_s: f32,
}

impl Default for HandSettings {
    fn default() -> Self {
        Self {
            metres_per_count: 0.0003,
            metres_per_notch: 0.004,
            roll_rad_s: 2.0,
            scope_roll_rad_per_notch: 5f32.to_radians(),
            scope_rad_per_count: 0.06f32.to_radians(),
            grip_s: 0.2,
        }
    }
}

/// The active hand's instrument after one tick of `dt_s`.
#[must_use]
pub fn hand_tick(
    state: TrocarState,
    input: &HandInput,
    settings: &HandSettings,
    limits: &TrocarLimits,
    shaft_length_m: f32,
    dt_s: f32,
) -> TrocarState {
    let motion = input.hand_motion * settings.metres_per_count;
    let mut state = move_handle(state, shaft_length_m, motion.x, motion.y);
    state.insertion_m += input.hand_notches * settings.metres_per_notch;
    if input.moved == Moved::Hand {
        state.roll_rad += input.roll * settings.roll_rad_s * dt_s;
    }
    let step = dt_s / settings.grip_s;
    state.grip += if input.squeezed { step } else { -step };
    state.pedal = input.squeezed;
    limits.clamp(state)
}

/// The endoscope after one tick: the mouse pans and tilts the view itself, not the camera head.
#[must_use]
pub fn scope_tick(state: TrocarState, input: &HandInput, settings: &HandSettings, limits: &TrocarLimits) -> TrocarState {
    limits.clamp(TrocarState {
        yaw_rad: state.yaw_rad + input.scope_motion.x * settings.scope_rad_per_count,
        pitch_rad: state.pitch_rad + input.scope_motion.y * settings.scope_rad_per_count,
        insertion_m: state.insertion_m + input.scope_notches * settings.metres_per_notch,
        roll_rad: state.roll_rad + input.scope_roll_notches * settings.scope_roll_rad_per_notch,
        ..state
    })
}

/// By how much the camera head turns in one tick of `dt_s`, rad: the keys that roll the hand otherwise roll it while the endoscope is moved.
#[must_use]
pub fn head_roll(input: &HandInput, settings: &HandSettings, dt_s: f32) -> f32 {
    if input.moved == Moved::Hand { 0.0 } else { 0.5 * input.roll * settings.roll_rad_s * dt_s }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy_math::Vec2;

    #[test]
    fn the_endoscope_takes_the_mouse_while_its_key_is_held() {
        let mut input = HandInput { moved: Moved::EndoscopeRoll, ..HandInput::default() };
        input.gather(Vec2::X, 2.0);
        assert_eq!((input.hand_motion, input.hand_notches), (Vec2::ZERO, 0.0));
        let settings = HandSettings::default();
        let state = scope_tick(TrocarState { insertion_m: 0.1, ..Default::default() }, &input, &settings, &TrocarLimits::default());
        assert_eq!(state.roll_rad, 2.0 * settings.scope_roll_rad_per_notch);
        assert_eq!(state.insertion_m, 0.1);
        assert!(state.yaw_rad > 0.0);
    }

    #[test]
    fn the_rolling_keys_turn_the_hand_or_the_camera_head() {
        let (settings, limits) = (HandSettings::default(), TrocarLimits::default());
        let state = TrocarState { insertion_m: 0.1, ..Default::default() };
        for (moved, hand, head) in [(Moved::Hand, 2.0, 0.0), (Moved::Endoscope, 0.0, 1.0), (Moved::EndoscopeRoll, 0.0, 1.0)] {
            let input = HandInput { moved, roll: 1.0, ..HandInput::default() };
            assert_eq!(hand_tick(state, &input, &settings, &limits, 0.33, 1.0).roll_rad, hand);
            assert_eq!(head_roll(&input, &settings, 1.0), head);
        }
    }

    #[test]
    fn a_squeeze_closes_the_jaws_in_time_and_no_further() {
        let (settings, limits) = (HandSettings::default(), TrocarLimits::default());
        let input = HandInput { squeezed: true, ..HandInput::default() };
        let mut state = TrocarState { insertion_m: 0.1, ..Default::default() };
        for _ in 0..11 {
            state = hand_tick(state, &input, &settings, &limits, 0.33, 1.0 / 60.0);
        }
        assert!(state.grip > 0.9 && state.grip < 1.0);
        for _ in 0..10 {
            state = hand_tick(state, &input, &settings, &limits, 0.33, 1.0 / 60.0);
        }
        assert_eq!(state.grip, 1.0);
    }
}
