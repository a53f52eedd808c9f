//! What a tick knows of the world outside besides the devices: mouse and keys, and where the demonstration is.
//!
//! With [`crate::DeviceHands`], [`crate::CutSettings`] and the demonstration's switch in [`crate::SimulationControl`] this is everything from outside
//! that a tick depends on. It is complete once [`crate::SenseSystems::Devices`] is over: in [`crate::SenseSystems::Inputs`] it is recorded, or replaced
//! by what a recording has.

use crate::Hand;
use bevy_ecs::prelude::*;
use bevy_math::Vec2;

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
    /// Whether the active hand is to change its instrument.
    pub exchange: bool,
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
            exchange: false,
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

/// Where the demonstration is. It advances by ticks while the demonstration runs, never by the wall clock.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq)]
pub struct ScriptClock {
    /// Ticks performed.
    pub ticks: u64,
    /// Simulated time since the demonstration's start, s.
    pub time_s: f64,
    /// Time of the last keyframe, s.
    pub end_s: f64,
}

impl ScriptClock {
    /// Whether the last keyframe has been reached.
    #[must_use]
    pub fn finished(&self) -> bool {
        self.time_s >= self.end_s
    }

    /// One tick of `dt_s` on.
    pub fn advance(&mut self, dt_s: f64) {
        self.ticks += 1;
        self.time_s = self.ticks as f64 * dt_s;
    }
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
}
