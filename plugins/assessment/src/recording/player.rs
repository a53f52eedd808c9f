//! Where a replay is, and whether it is true to the recording.

use crate::recording::digest::StateDigest;
use crate::recording::event::{Event, TickInput};
use crate::recording::reader::Recording;

/// A recording that is being played.
#[derive(Clone, Debug)]
pub struct Play {
    recording: Recording,
    /// Where the scene is started over.
    restarts: Vec<Position>,
    /// Events that are over.
    next: usize,
    ticks: u64,
    compared: u64,
    difference: Option<Difference>,
}

/// A place in a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Position {
    /// Events before it.
    event: usize,
    /// Ticks before it.
    pub ticks: u64,
}

/// The first tick after which the state was not the one that was recorded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Difference {
    /// The tick, from 1.
    pub tick: u64,
}

impl Play {
    /// A recording from its start.
    #[must_use]
    pub fn new(recording: Recording) -> Self {
        let (mut restarts, mut ticks) = (Vec::new(), 0);
        for (event, what) in recording.events.iter().enumerate() {
            match what {
                Event::Tick { .. } => ticks += 1,
                Event::Reset { .. } => restarts.push(Position { event, ticks }),
            }
        }
        Self { recording, restarts, next: 0, ticks: 0, compared: 0, difference: None }
    }

    /// What is played.
    #[must_use]
    pub fn recording(&self) -> &Recording {
        &self.recording
    }

    /// Back to the start. A difference that was found stays.
    pub fn rewind(&mut self) {
        self.go_to(Position::default());
    }

    /// Where it is.
    #[must_use]
    pub fn position(&self) -> Position {
        Position { event: self.next, ticks: self.ticks }
    }

    /// Goes where it has been, or where [`Play::scene_of`] says that a scene begins. The state is the caller's to put there.
    pub fn go_to(&mut self, position: Position) {
        (self.next, self.ticks) = (position.event.min(self.recording.events.len()), position.ticks);
    }

    /// Where the scene begins that the state after `ticks` ticks is of: at the restart before them, else at the start.
    #[must_use]
    pub fn scene_of(&self, ticks: u64) -> Position {
        let before = self.restarts.partition_point(|restart| restart.ticks < ticks);
        before.checked_sub(1).map_or_else(Position::default, |i| self.restarts[i])
    }

    /// Whether a restart of the scene comes next.
    #[must_use]
    pub fn comes_restart(&self) -> bool {
        matches!(self.peek(), Some(Event::Reset { .. }))
    }

    /// What comes next; `None` at the end.
    #[must_use]
    pub fn peek(&self) -> Option<&Event> {
        self.recording.events.get(self.next)
    }

    /// Goes on over a restart of the scene. Gives its clock, `None` when something else comes next.
    pub fn take_reset(&mut self) -> Option<u64> {
        let Some(Event::Reset { clock }) = self.peek() else { return None };
        let clock = *clock;
        self.next += 1;
        Some(clock)
    }

    /// Goes on over a tick. Gives its input, `None` when something else comes next.
    pub fn take_tick(&mut self) -> Option<TickInput> {
        let Some(Event::Tick { input, .. }) = self.peek() else { return None };
        let input = *input;
        self.next += 1;
        self.ticks += 1;
        Some(input)
    }

    /// Compares the state that the last tick has left with the recorded one.
    pub fn compare(&mut self, state: StateDigest) {
        let Some(Event::Tick { mark, .. }) = self.next.checked_sub(1).and_then(|i| self.recording.events.get(i)) else { return };
        let whole = self.recording.digests.binary_search_by_key(&self.next, |(after, _)| *after).ok();
        let matches = *mark == state.mark() && whole.is_none_or(|i| self.recording.digests[i].1 == state.bytes());
        self.compared += 1;
        if !matches && self.difference.is_none() {
            self.difference = Some(Difference { tick: self.ticks });
        }
    }

    /// Whether everything has been played.
    #[must_use]
    pub fn finished(&self) -> bool {
        self.peek().is_none()
    }

    /// Ticks played since the start.
    #[must_use]
    pub fn ticks(&self) -> u64 {
        self.ticks
    }

    /// Ticks after which the state was compared.
    #[must_use]
    pub fn compared(&self) -> u64 {
        self.compared
    }

    /// The first difference; `None` while everything is the same.
    #[must_use]
    pub fn difference(&self) -> Option<Difference> {
        self.difference
    }
}
