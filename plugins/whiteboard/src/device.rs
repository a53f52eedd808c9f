//! Devices in the trainee's hands: how they are, where the hands are, and what the hands should feel.
//!
//! [`DeviceStatus`] and [`DeviceHands`] are written by hid; [`DeviceHands`] is carried out by instruments; [`ToolForce`] is written by whoever
//! knows the contact, and read by hid.

use crate::Hand;
use bevy_ecs::prelude::*;
use bevy_math::Vec3;

/// How a device is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum DeviceCondition {
    /// It has been opened and not been heard yet.
    #[default]
    Starting,
    /// It moves its instruments.
    Live,
    /// It moves its instruments, but an axis trembles more than a hand can.
    Noisy,
    /// It moves its instruments, but an axis stays where it is while the others move.
    Stuck,
    /// It does not know yet where it is; the trainee has to move it as the advice says.
    Homing,
    /// It is there and says nothing.
    Silent,
    /// What it says makes no sense.
    Garbage,
    /// It is there and may not be opened.
    Denied,
    /// It is there, but nothing in its reports is what its profile asks for.
    Unsuitable,
    /// It was there and is gone.
    Unplugged,
    /// It was asked for and has never been there.
    Missing,
}

impl DeviceCondition {
    /// Whether the instruments follow the device in this condition. Otherwise they stay where they are.
    #[must_use]
    pub fn moves(self) -> bool {
        matches!(self, Self::Live | Self::Noisy | Self::Stuck)
    }
}

/// One device, for the HUD to show.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DeviceReport {
    /// What it calls itself.
    pub name: String,
    /// Name of the profile that reads it.
    pub profile: String,
    /// The hands that it is in.
    pub hands: Vec<Hand>,
    /// How it is.
    pub condition: DeviceCondition,
    /// What to do about it; empty when nothing has to be done.
    pub advice: String,
    /// Reports that were taken since it was opened.
    pub reports: u64,
    /// Reports that were refused since it was opened.
    pub refused: u64,
}

/// Every device that is served, or should be. Written by hid.
#[derive(Resource, Clone, Debug, Default, PartialEq)]
pub struct DeviceStatus(pub Vec<DeviceReport>);

/// One degree of freedom of a hand.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AxisInput {
    /// Where the device says that the handle is, rad or m; `None` when it tells movements only, or has no such axis.
    pub at: Option<f32>,
    /// By how much it moved since the tick before, rad or m: of a device that tells movements or speeds.
    pub by: f32,
}

/// What a device says about one hand. The angles are those of the handle as the trainee sees it: the tip goes the other way about the port.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DeviceHand {
    /// Whether the instrument follows; otherwise it stays where it is, and a pedal is up.
    pub live: bool,
    /// Counts how often the device has taken over: with each new number the instrument goes on from where it is.
    pub engaged: u64,
    /// The handle swung to the right, rad.
    pub yaw: AxisInput,
    /// The handle swung up, rad.
    pub pitch: AxisInput,
    /// Pushed in, m.
    pub insertion: AxisInput,
    /// Turned about the shaft, rad, right-handed about the direction of insertion.
    pub roll: AxisInput,
    /// The handle's rings, 0 open to 1 closed; `None` when it has none.
    pub grip: Option<f32>,
    /// The pedal, or the button that stands for it.
    pub pedal: bool,
}

/// What the devices say about both hands; `None` for a hand that is in no device. Written by hid in [`crate::SenseSystems::Devices`].
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq)]
pub struct DeviceHands {
    /// The left hand.
    pub left: Option<DeviceHand>,
    /// The right hand.
    pub right: Option<DeviceHand>,
}

impl DeviceHands {
    /// One hand.
    #[must_use]
    pub fn get(&self, hand: Hand) -> Option<&DeviceHand> {
        match hand {
            Hand::Left => self.left.as_ref(),
            Hand::Right => self.right.as_ref(),
        }
    }

    /// One hand, to be written.
    pub fn slot(&mut self, hand: Hand) -> &mut Option<DeviceHand> {
        match hand {
            Hand::Left => &mut self.left,
            Hand::Right => &mut self.right,
        }
    }
}

/// What an instrument meets, for the hand to feel. On an instrument; one without it is not felt.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct ToolForce {
    /// Force on the instrument, N, in the world.
    pub force_n: Vec3,
    /// Where it acts, m, in the world.
    pub at: Vec3,
    /// Force that opens the jaws, N.
    pub grip_n: f32,
}
