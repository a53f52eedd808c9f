//! The trainee's hands on mouse and keyboard: what is gathered at frame rate, and what one tick makes of it.

use crate::kinematics::{TrocarLimits, TrocarState, move_handle};
use bevy_ecs::prelude::*;
use bevy_math::Vec2;
use keyhole_whiteboard::Hand;

/// Every key and button of this room and what it does.
pub const KEYS: &[(&str, &str)] = &[
    ("Mouse", "moves the handle of the active instrument; the tip goes the other way about the port"),
    ("Mouse wheel", "pushes the active instrument in and pulls it out"),
    ("Left mouse button", "closes the jaws, scissors cut as they close; hook and scalpel cut while it is down"),
    ("Q / E", "roll the active instrument"),
    ("Tab", "the other hand; the one left behind holds still"),
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

/// What the wheel and the mouse move.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Moved {
    /// The active hand.
    #[default]
    Hand,
    /// The endoscope; the wheel inserts.
    Endoscope,
    /// The endoscope; the wheel turns the scope about its shaft.
    EndoscopeRoll,
}

/// Input gathered since the last tick, and what is held. The tick consumes the motion, so a frame that runs no tick loses none, and a
/// frame that runs several gives it to the first.
#[derive(Resource, Clone, Copy, Debug, PartialEq)]
pub struct HandInput {
    /// Which hand is moved.
    pub active: Hand,
    /// What the mouse moves now.
    pub moved: Moved,
    /// Motion of the mouse for the hand, counts; x to the right, y upwards.
    pub hand_motion: Vec2,
    /// Notches of the wheel for the hand, pushing positive.
    pub hand_notches: f32,
    /// Motion of the mouse for the endoscope, counts; x to the right, y upwards.
    pub scope_motion: Vec2,
    /// Notches that insert the endoscope.
    pub scope_notches: f32,
    /// Notches that turn the scope about its shaft.
    pub scope_roll_notches: f32,
    /// -1, 0 or 1: the keys of rolling that are held.
    pub roll: f32,
    /// Whether the active hand is squeezed.
    pub squeezed: bool,
}

impl Default for HandInput {
    fn default() -> Self {
        Self {
            active: Hand::Right,
            moved: Moved::Hand,
            hand_motion: Vec2::ZERO,
            hand_notches: 0.0,
            scope_motion: Vec2::ZERO,
            scope_notches: 0.0,
            scope_roll_notches: 0.0,
            roll: 0.0,
            squeezed: false,
        }
    }
}

impl HandInput {
    /// Adds one frame of the mouse: `motion` in counts (x right, y up) and `notches` of the wheel.
    pub fn gather(&mut self, motion: Vec2, notches: f32) {
        match self.moved {
            Moved::Hand => {
                self.hand_motion += motion;
                self.hand_notches += notches;
            }
            Moved::Endoscope => {
                self.scope_motion += motion;
                self.scope_notches += notches;
            }
            Moved::EndoscopeRoll => {
                self.scope_motion += motion;
                self.scope_roll_notches += notches;
            }
        }
    }

    /// Switches to the other hand; motion gathered for the old one is dropped.
    pub fn switch_hand(&mut self) {
        self.active = match self.active {
            Hand::Left => Hand::Right,
            Hand::Right => Hand::Left,
        };
        self.hand_motion = Vec2::ZERO;
        self.hand_notches = 0.0;
    }

    /// Hands the gathered motion over: what was gathered becomes zero, what is held stays.
    #[must_use]
    pub fn take(&mut self) -> Self {
        let taken = *self;
        *self = Self { active: taken.active, moved: taken.moved, roll: taken.roll, squeezed: taken.squeezed, ..Self::default() };
        taken
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
    state.roll_rad += input.roll * settings.roll_rad_s * dt_s;
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gathered_motion_is_consumed_once_and_held_keys_stay() {
        let mut input = HandInput::default();
        input.gather(Vec2::new(3.0, -1.0), 1.0);
        input.gather(Vec2::new(2.0, 0.0), 0.0);
        input.squeezed = true;
        let first = input.take();
        assert_eq!((first.hand_motion, first.hand_notches, first.squeezed), (Vec2::new(5.0, -1.0), 1.0, true));
        let second = input.take();
        assert_eq!((second.hand_motion, second.hand_notches, second.squeezed), (Vec2::ZERO, 0.0, true));
    }

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
