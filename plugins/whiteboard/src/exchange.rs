//! The exchange of a hand's instrument through its trocar: out, another one in its place, in again.

use crate::InstrumentKind;
use bevy_ecs::prelude::*;

/// What a hand may have in its trocar besides what is in it now: at the next exchange the first of these comes in, and what comes out goes to the end of the row. On an
/// instrument; one without it stays. Written by the scene, then by instruments.
#[derive(Component, Clone, Debug, Default, PartialEq, Eq)]
pub struct Tray(pub Vec<InstrumentKind>);

/// Where an exchange is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ExchangeStage {
    /// The old instrument is drawn out, its jaws opened first.
    Withdraw,
    /// None is in the trocar.
    Outside,
    /// The new one comes in, its jaws closed.
    Insert,
}

/// An exchange under way: until it is over the hand does not move its instrument. On the instrument. Written by instruments.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct Exchange {
    /// What comes.
    pub to: InstrumentKind,
    /// Where it is.
    pub stage: ExchangeStage,
    /// What is left of the time without an instrument, s.
    pub outside_s: f32,
}
