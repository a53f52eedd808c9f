//! What a hand feels: a force on the tool, as efforts about the port, as an output report.

use crate::profile::{Effort, ForceProfile};
use crate::report::BitField;
use bevy_math::{Isometry3d, Vec3};
use std::time::Duration;

/// What a handle is pushed with: torques about the port, N m, and forces, N. Positive as the degrees of freedom of a handle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HandEffort {
    /// Swings the handle to the right.
    pub yaw_nm: f64,
    /// Swings it up.
    pub pitch_nm: f64,
    /// Pushes it in.
    pub insertion_n: f64,
    /// Turns it about the shaft.
    pub roll_nm: f64,
    /// Opens the rings.
    pub grip_n: f64,
}

impl HandEffort {
    fn of(&self, effort: Effort) -> f64 {
        match effort {
            Effort::Yaw => self.yaw_nm,
            Effort::Pitch => self.pitch_nm,
            Effort::Insertion => self.insertion_n,
            Effort::Roll => self.roll_nm,
            Effort::Grip => self.grip_n,
        }
    }
}

/// What a force (N) at a point (m) of the instrument does to its handle, the shaft turning about the port at `port` (m). `frame` is the
/// instrument's, -Z along the shaft; `up` the port's up in the world, `grip_n` what opens the jaws.
///
/// The moment about the port is `(at - port) x force`. Towards the right of the port it swings the tip up, so the handle down; about the up
/// axis it swings the tip left, so the handle right.
#[must_use]
pub fn effort(port: Vec3, frame: Isometry3d, up: Vec3, force_n: Vec3, at: Vec3, grip_n: f32) -> HandEffort {
    let along = frame.rotation * Vec3::NEG_Z;
    let moment = (at - port).cross(force_n);
    let right = along.cross(up).normalize_or_zero();
    let over = right.cross(along);
    HandEffort {
        yaw_nm: f64::from(moment.dot(over)),
        pitch_nm: -f64::from(moment.dot(right)),
        insertion_n: f64::from(force_n.dot(along)),
        roll_nm: f64::from(moment.dot(along)),
        grip_n: f64::from(grip_n),
    }
}

/// A force that has not been renewed for so long is no force: the simulation stands still.
const STALE: Duration = Duration::from_millis(100);

/// Writes the output report of a profile at its rate.
#[derive(Clone, Debug)]
pub struct ForceOut {
    profile: ForceProfile,
    period: Duration,
    next: Duration,
    fresh: Option<Duration>,
    efforts: [HandEffort; 2],
    report: Vec<u8>,
}

impl ForceOut {
    /// The first report is due at `now`.
    #[must_use]
    pub fn new(profile: ForceProfile, now: Duration) -> Self {
        let period = Duration::from_secs_f64(1.0 / f64::from(profile.rate_hz.clamp(1.0, 1000.0)));
        let mut report = vec![0; 1 + usize::from(profile.bytes)];
        report[0] = profile.report;
        Self { profile, period, next: now, fresh: None, efforts: [HandEffort::default(); 2], report }
    }

    /// Takes what the tick has found.
    pub fn renew(&mut self, now: Duration, efforts: [HandEffort; 2]) {
        self.efforts = efforts;
        self.fresh = Some(now);
    }

    /// Time until the next report is due.
    #[must_use]
    pub fn due_in(&self, now: Duration) -> Duration {
        self.next.saturating_sub(now)
    }

    /// The report that is due now, if one is. Every number in it is limited; all are zero unless the device is sound and the force is new.
    pub fn due(&mut self, now: Duration, sound: bool) -> Option<&[u8]> {
        if now < self.next {
            return None;
        }
        // What was missed is not sent in a bunch.
        self.next = (self.next + self.period).max(now.saturating_sub(self.period));
        let felt = sound && self.fresh.is_some_and(|then| now.saturating_sub(then) <= STALE);
        Some(self.fill(felt))
    }

    /// The report that takes all force away.
    pub fn zero(&mut self) -> &[u8] {
        self.fresh = None;
        self.fill(false)
    }

    fn fill(&mut self, felt: bool) -> &[u8] {
        self.report[1..].fill(0);
        for channel in self.profile.channels.iter().filter(|_| felt) {
            let wanted = self.efforts.get(usize::from(channel.hand)).map_or(0.0, |e| e.of(channel.effort));
            let effort = if wanted.is_finite() { wanted.clamp(-channel.limit, channel.limit) } else { 0.0 };
            let place = BitField { report: None, start: usize::from(channel.start), bits: usize::from(channel.bits), signed: true };
            // The most negative number has no counterpart: a mirrored force would be another one.
            let most = place.limits().1;
            let counts = ((effort * channel.counts_per_unit).round() as i64).clamp(-most, most);
            place.write(&mut self.report[1..], counts);
        }
        &self.report
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;
    use crate::profile::ForceChannel;

    #[test]
    fn the_handle_is_pushed_as_a_rigid_lever_pushes_it() {
        // Into the body along -Z, up is Y, so right is X. The tip is pushed to the right and up, and back out.
        let frame = Isometry3d::from_translation(Vec3::new(0.0, 0.0, -0.1));
        let push = |force| effort(Vec3::ZERO, frame, Vec3::Y, force, Vec3::new(0.0, 0.0, -0.1), 0.0);
        // The lever is 0.1 m: a tip pushed right swings the handle left, one pushed up swings it down.
        let right = push(Vec3::new(2.0, 0.0, 0.0));
        assert!((right.yaw_nm + 0.2).abs() < 1e-7 && right.pitch_nm.abs() < 1e-7 && right.insertion_n.abs() < 1e-7, "{right:?}");
        let up = push(Vec3::new(0.0, 3.0, 0.0));
        assert!((up.pitch_nm + 0.3).abs() < 1e-7 && up.yaw_nm.abs() < 1e-7, "{up:?}");
        let out = push(Vec3::new(0.0, 0.0, 5.0));
        assert!((out.insertion_n + 5.0).abs() < 1e-6 && out.yaw_nm.abs() < 1e-7, "{out:?}");
    }

    #[test]
    fn a_force_is_limited_and_nothing_that_is_not_a_number_is_sent() {
        let channel = ForceChannel { hand: 0, effort: Effort::Insertion, start: 0, bits: 16, counts_per_unit: 100.0, limit: 30.0 };
        let profile = ForceProfile { report: 7, bytes: 2, rate_hz: 500.0, channels: vec![channel] };
        let mut out = ForceOut::new(profile, Duration::ZERO);
        let mut sent = |ms: u64, newton: f64, sound: bool| {
            let now = Duration::from_millis(ms);
            out.renew(now, [HandEffort { insertion_n: newton, ..Default::default() }; 2]);
            let report = out.due(now, sound).unwrap();
            (report[0], i16::from_le_bytes([report[1], report[2]]))
        };
        assert_eq!(sent(0, 12.5, true), (7, 1250));
        assert_eq!(sent(2, -1000.0, true), (7, -3000));
        assert_eq!(sent(4, f64::NAN, true), (7, 0));
        assert_eq!(sent(6, f64::NEG_INFINITY, true), (7, 0));
        assert_eq!(sent(8, 12.5, false), (7, 0));
        assert!(out.due(Duration::from_millis(9), true).is_none());
        let later = Duration::from_millis(200);
        assert_eq!(out.due(later, true).unwrap(), [7, 0, 0], "a force that nobody renews is gone");
    }
}
