//! One device that is served: reports in, force out, and how it is. Runs on a thread of its own, or is stepped on a virtual clock.

use crate::error::{FitError, TransportError};
use crate::force::{ForceOut, HandEffort};
use crate::mapping::{Dof, HandReading, Mapping, Taken};
use crate::profile::Profile;
use crate::transport::Transport;
use crate::watch::StreamWatch;
use keyhole_whiteboard::DeviceCondition;
use std::time::Duration;
use triple_buffer::{Input, Output, triple_buffer};

/// Longest report, bytes.
const LONGEST_REPORT: usize = 4096;
/// Longest wait for a report.
const LONGEST_WAIT: Duration = Duration::from_millis(50);
/// Wait for a report while a speed acts.
const DRIFT_WAIT: Duration = Duration::from_millis(4);
/// Time in which a device that always sends has to be heard first.
const FIRST_WORD: Duration = Duration::from_secs(2);

/// The newest that is known of a device.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Snapshot {
    /// How it is.
    pub condition: DeviceCondition,
    /// The axis that is noisy or stuck, with its hand.
    pub axis: Option<(usize, Dof)>,
    /// The flag of homing that is not set.
    pub not_homed: Option<usize>,
    /// The profile's hands.
    pub hands: [HandReading; 2],
    /// Counts how often the device took over.
    pub engaged: u64,
    /// Reports that were taken.
    pub reports: u64,
    /// Reports that were refused.
    pub refused: u64,
    /// When the newest report came, on the device's clock.
    pub heard: Duration,
}

/// The other end of a session: what a tick reads and what it sends, without ever waiting.
#[derive(Debug)]
pub struct Line {
    /// The newest that is known.
    pub newest: Output<Snapshot>,
    /// What the profile's hands should feel.
    pub feel: Input<[HandEffort; 2]>,
}

/// A device that is served.
pub struct Session {
    transport: Box<dyn Transport>,
    mapping: Mapping,
    stream: StreamWatch,
    always_sends: bool,
    opened: Duration,
    force: Option<ForceOut>,
    efforts: Output<[HandEffort; 2]>,
    newest: Input<Snapshot>,
    snapshot: Snapshot,
    buffer: Vec<u8>,
}

/// Why a device cannot be served.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SessionError {
    /// It does not answer.
    #[error(transparent)]
    Transport(#[from] TransportError),
    /// The profile is not for it.
    #[error(transparent)]
    Fit(#[from] FitError),
}

impl Session {
    /// Serves an open device with a profile.
    ///
    /// # Errors
    /// When the device does not tell what its reports are, or they are not what the profile asks for.
    pub fn new(mut transport: Box<dyn Transport>, profile: &Profile) -> Result<(Self, Line), SessionError> {
        let descriptor = transport.descriptor()?;
        let mapping = Mapping::fit(profile, &descriptor)?;
        let now = transport.now();
        let (newest, output) = triple_buffer(&Snapshot::default());
        let (feel, efforts) = triple_buffer(&[HandEffort::default(); 2]);
        let session = Self {
            transport,
            mapping,
            stream: StreamWatch::new(now, profile.rate_hz),
            always_sends: profile.rate_hz.is_some(),
            opened: now,
            force: profile.force.clone().map(|force| ForceOut::new(force, now)),
            efforts,
            newest,
            snapshot: Snapshot::default(),
            buffer: vec![0; LONGEST_REPORT],
        };
        Ok((session, Line { newest: output, feel }))
    }

    /// Time on the device's clock.
    #[must_use]
    pub fn now(&self) -> Duration {
        self.transport.now()
    }

    /// The newest that is known.
    #[must_use]
    pub fn snapshot(&self) -> &Snapshot {
        &self.snapshot
    }

    /// Waits for one report, at most for `most`, and does everything that is due.
    ///
    /// # Errors
    /// When the device is gone: the session is over.
    pub fn step(&mut self, most: Duration) -> Result<(), TransportError> {
        let mut wait = most.min(if self.mapping.drifts() { DRIFT_WAIT } else { LONGEST_WAIT });
        if let Some(force) = &self.force {
            wait = wait.min(force.due_in(self.transport.now()));
        }
        match self.transport.read(&mut self.buffer, wait) {
            Ok(0) => self.mapping.integrate(self.transport.now()),
            Ok(length) => self.hear(length.min(LONGEST_REPORT)),
            Err(error) => return Err(self.end(error)),
        }
        self.judge();
        self.push();
        self.newest.write(self.snapshot);
        Ok(())
    }

    fn hear(&mut self, length: usize) {
        let now = self.transport.now();
        let taken = self.mapping.take(now, &self.buffer[..length]);
        self.stream.hear(now, taken.is_ok());
        match taken {
            Ok(taken) => {
                self.snapshot.reports += 1;
                self.snapshot.heard = now;
                self.snapshot.engaged += u64::from(taken == Taken::Elsewhere);
            }
            Err(_) => self.snapshot.refused += 1,
        }
    }

    fn judge(&mut self) {
        let now = self.transport.now();
        let followed = self.snapshot.condition.moves();
        let (noisy, stuck) = (self.mapping.noisy(), self.mapping.stuck());
        self.snapshot.axis = noisy.or(stuck);
        self.snapshot.not_homed = self.mapping.not_homed();
        self.snapshot.condition = if self.stream.garbage() {
            DeviceCondition::Garbage
        } else if self.snapshot.reports == 0 {
            let waited = now.saturating_sub(self.opened) > FIRST_WORD;
            if self.always_sends && waited { DeviceCondition::Silent } else { DeviceCondition::Starting }
        } else if self.stream.silent(now) {
            DeviceCondition::Silent
        } else if self.snapshot.not_homed.is_some() {
            DeviceCondition::Homing
        } else if noisy.is_some() {
            DeviceCondition::Noisy
        } else if stuck.is_some() {
            DeviceCondition::Stuck
        } else {
            DeviceCondition::Live
        };
        match (followed, self.snapshot.condition.moves()) {
            (false, true) => self.snapshot.engaged += 1,
            (true, false) => {
                self.mapping.settle();
                self.mapping.let_go();
            }
            _ => {}
        }
        self.snapshot.hands = [self.mapping.reading(0), self.mapping.reading(1)];
    }

    /// Sends the force that is due. A device that refuses one is told none from then on, and it does not matter to the hands.
    fn push(&mut self) {
        let Some(force) = &mut self.force else { return };
        let now = self.transport.now();
        if self.efforts.update() {
            force.renew(now, *self.efforts.output_buffer());
        }
        let sound = self.snapshot.condition.moves();
        if let Some(report) = force.due(now, sound)
            && self.transport.write(report).is_err()
        {
            // The last word to it is that there is no force, should it hear that.
            drop(self.transport.write(force.zero()));
            self.force = None;
        }
    }

    fn end(&mut self, error: TransportError) -> TransportError {
        self.mapping.let_go();
        self.snapshot.condition = DeviceCondition::Unplugged;
        self.snapshot.hands = [self.mapping.reading(0), self.mapping.reading(1)];
        self.newest.write(self.snapshot);
        error
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        if let Some(force) = &mut self.force {
            // A device that is gone feels nothing anyway.
            drop(self.transport.write(force.zero()));
        }
    }
}
