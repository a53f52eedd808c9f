//! Events as they stand in a block. Numbers keep every bit.

use crate::recording::event::{Event, TickInput};
use crate::recording::header::Header;
use bevy_math::Vec2;
use keyhole_whiteboard::{AxisInput, CutMethod, CutPattern, CutSettings, DeviceHand, DeviceHands, Hand, HandInput, Moved};
use serde::{Deserialize, Serialize};

/// A block.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) enum Block {
    Header(Header),
    Events {
        events: Vec<WireEvent>,
        /// The digest of the state after the last tick.
        digest: [u8; 32],
    },
    /// Nothing follows: the recording was ended, not cut off.
    End,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[expect(clippy::large_enum_variant, reason = "nearly every event is a tick")]
pub(crate) enum WireEvent {
    Tick { input: WireInput, mark: u32 },
    Reset { clock: u64 },
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct WireInput {
    clock: u64,
    demonstration: Option<u64>,
    mouse: WireMouse,
    devices: [Option<WireHand>; 2],
    cutting: WireCutting,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct WireMouse {
    right_hand: bool,
    moved: WireMoved,
    hand_motion: [f32; 2],
    hand_notches: f32,
    scope_motion: [f32; 2],
    scope_notches: f32,
    scope_roll_notches: f32,
    roll: f32,
    squeezed: bool,
    exchange: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
enum WireMoved {
    Hand,
    Endoscope,
    EndoscopeRoll,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct WireHand {
    live: bool,
    engaged: u64,
    /// Yaw, pitch, insertion and roll: where they are, and by how much they moved.
    axes: [(Option<f32>, f32); 4],
    grip: Option<f32>,
    pedal: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct WireCutting {
    method: WireMethod,
    symmetric: [bool; 2],
    snap: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
enum WireMethod {
    Hybrid,
    Progressive,
    NonProgressive,
}

impl From<&Event> for WireEvent {
    fn from(event: &Event) -> Self {
        match event {
            Event::Tick { input, mark } => Self::Tick { input: input.into(), mark: *mark },
            Event::Reset { clock } => Self::Reset { clock: *clock },
        }
    }
}

impl From<WireEvent> for Event {
    fn from(event: WireEvent) -> Self {
        match event {
            WireEvent::Tick { input, mark } => Self::Tick { input: input.into(), mark },
            WireEvent::Reset { clock } => Self::Reset { clock },
        }
    }
}

impl From<&TickInput> for WireInput {
    fn from(i: &TickInput) -> Self {
        let m = &i.mouse;
        Self {
            clock: i.clock,
            demonstration: i.demonstration,
            mouse: WireMouse {
                right_hand: m.active == Hand::Right,
                moved: match m.moved {
                    Moved::Hand => WireMoved::Hand,
                    Moved::Endoscope => WireMoved::Endoscope,
                    Moved::EndoscopeRoll => WireMoved::EndoscopeRoll,
                },
                hand_motion: m.hand_motion.to_array(),
                hand_notches: m.hand_notches,
                scope_motion: m.scope_motion.to_array(),
                scope_notches: m.scope_notches,
                scope_roll_notches: m.scope_roll_notches,
                roll: m.roll,
                squeezed: m.squeezed,
                exchange: m.exchange,
            },
            devices: [i.devices.left.as_ref().map(WireHand::from), i.devices.right.as_ref().map(WireHand::from)],
            cutting: WireCutting {
                method: match i.cutting.method {
                    CutMethod::Hybrid => WireMethod::Hybrid,
                    CutMethod::Progressive => WireMethod::Progressive,
                    CutMethod::NonProgressive => WireMethod::NonProgressive,
                },
                symmetric: [i.cutting.hull, i.cutting.core].map(|p| p == CutPattern::Symmetric),
                snap: i.cutting.snap,
            },
        }
    }
}

impl From<WireInput> for TickInput {
    fn from(i: WireInput) -> Self {
        let m = i.mouse;
        let [left, right] = i.devices.map(|d| d.map(DeviceHand::from));
        let [hull, core] = i.cutting.symmetric.map(|symmetric| if symmetric { CutPattern::Symmetric } else { CutPattern::Minimal });
        Self {
            clock: i.clock,
            demonstration: i.demonstration,
            mouse: HandInput {
                active: if m.right_hand { Hand::Right } else { Hand::Left },
                moved: match m.moved {
                    WireMoved::Hand => Moved::Hand,
                    WireMoved::Endoscope => Moved::Endoscope,
                    WireMoved::EndoscopeRoll => Moved::EndoscopeRoll,
                },
                hand_motion: Vec2::from_array(m.hand_motion),
                hand_notches: m.hand_notches,
                scope_motion: Vec2::from_array(m.scope_motion),
                scope_notches: m.scope_notches,
                scope_roll_notches: m.scope_roll_notches,
                roll: m.roll,
                squeezed: m.squeezed,
                exchange: m.exchange,
            },
            devices: DeviceHands { left, right },
            cutting: CutSettings {
                method: match i.cutting.method {
                    WireMethod::Hybrid => CutMethod::Hybrid,
                    WireMethod::Progressive => CutMethod::Progressive,
                    WireMethod::NonProgressive => CutMethod::NonProgressive,
                },
                hull,
                core,
                snap: i.cutting.snap,
            },
        }
    }
}

impl From<&DeviceHand> for WireHand {
    fn from(h: &DeviceHand) -> Self {
        let axes = [h.yaw, h.pitch, h.insertion, h.roll].map(|a| (a.at, a.by));
        Self { live: h.live, engaged: h.engaged, axes, grip: h.grip, pedal: h.pedal }
    }
}

impl From<WireHand> for DeviceHand {
    fn from(h: WireHand) -> Self {
        let [yaw, pitch, insertion, roll] = h.axes.map(|(at, by)| AxisInput { at, by });
        Self { live: h.live, engaged: h.engaged, yaw, pitch, insertion, roll, grip: h.grip, pedal: h.pedal }
    }
}
