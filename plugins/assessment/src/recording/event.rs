//! What is recorded: the input of a tick, and what happens between ticks.

use keyhole_whiteboard::{CutSettings, DeviceHands, HandInput};

/// Everything from outside that a tick depends on.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TickInput {
    /// The clock of fixed time during the tick, in steps of a tick since the program started. It goes on while the simulation is paused.
    pub clock: u64,
    /// When the demonstration drives the instruments: its ticks before this one.
    pub demonstration: Option<u64>,
    /// Mouse and keys.
    pub mouse: HandInput,
    /// What the devices say.
    pub devices: DeviceHands,
    /// How cutting is done.
    pub cutting: CutSettings,
}

/// Something that happens in a recording, in order.
#[derive(Clone, Copy, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "nearly every event is a tick")]
pub enum Event {
    /// A tick.
    Tick {
        /// What it depends on.
        input: TickInput,
        /// The first four bytes of the digest of the state that it leaves: see [`crate::recording::digest`].
        mark: u32,
    },
    /// The scene is started over.
    Reset {
        /// The clock of fixed time, as in [`TickInput::clock`].
        clock: u64,
    },
}

impl Event {
    /// Its time on the clock of fixed time.
    #[must_use]
    pub fn clock(&self) -> u64 {
        match self {
            Self::Tick { input, .. } => input.clock,
            Self::Reset { clock } => *clock,
        }
    }
}
