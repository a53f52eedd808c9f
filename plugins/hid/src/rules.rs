//! What a profile may say: each rule with a message that names the place and what was expected.

use crate::error::RuleError;
use crate::guard::LONGEST;
use crate::profile::{Axis, Button, ForceProfile, HandChoice, HandProfile, Mode, Profile, Source};

/// Least difference between the counts of both ends: a millionth of what a field can tell apart.
const LEAST_COUNTS: f64 = 1e-6;

fn broken(what: impl Into<String>) -> Result<(), RuleError> {
    Err(RuleError(what.into()))
}

impl Profile {
    /// What a profile says that cannot be.
    pub(crate) fn check(&self) -> Result<(), RuleError> {
        if self.name.trim().is_empty() || self.matches.is_empty() {
            return broken("a profile has a name and at least one entry in `matches`");
        }
        if self.hands.is_empty() || self.hands.len() > 2 {
            return broken(format!("a profile has one or two `hands`, this one has {}", self.hands.len()));
        }
        if let [a, b] = &self.hands[..]
            && (a.hand == b.hand || a.hand == HandChoice::Any || b.hand == HandChoice::Any)
        {
            return broken("a profile with two `hands` has one Left and one Right");
        }
        if let Some(rate) = self.rate_hz.filter(|r| !(1.0..=10_000.0).contains(r)) {
            return broken(format!("rate_hz is {rate}; expected 1 to 10000"));
        }
        for flag in &self.homing {
            flag.flag.check("homing")?;
        }
        for hand in &self.hands {
            hand.check()?;
        }
        self.force.as_ref().map_or(Ok(()), |force| force.check(self.hands.len()))
    }
}

impl HandProfile {
    fn check(&self) -> Result<(), RuleError> {
        if self.direction.is_some() && (self.yaw.is_some() || self.pitch.is_some()) {
            return broken("a hand has `direction`, or `yaw` and `pitch`, not both");
        }
        for (name, axis) in self.axes() {
            axis.map_or(Ok(()), |a| a.check(name))?;
        }
        if self.opening.as_ref().is_some_and(|o| o.mode != Mode::Absolute) {
            return broken("opening: only an Absolute mode says how far rings are open");
        }
        if let Some(direction) = &self.direction {
            for source in [&direction.right, &direction.up, &direction.inward] {
                source.check("direction")?;
            }
        }
        self.closes.iter().try_for_each(|b| b.check("closes"))?;
        self.pedal.iter().try_for_each(|b| b.check("pedal"))
    }
}

impl Axis {
    fn check(&self, name: &str) -> Result<(), RuleError> {
        self.from.check(name)?;
        let finite = |(a, b): (f64, f64)| a.is_finite() && b.is_finite() && a.abs() < 1e10 && b.abs() < 1e10;
        if self.counts.is_some_and(|c| !finite(c) || (c.1 - c.0).abs() < LEAST_COUNTS) {
            return broken(format!("{name}: `counts` are two different numbers, below 1e10 and not nearer than {LEAST_COUNTS}"));
        }
        if !finite(self.means) || self.means.0 == self.means.1 {
            return broken(format!("{name}: `means` are two different numbers: what the axis reads at both ends"));
        }
        if !(0.0..=0.9).contains(&self.dead_zone) {
            return broken(format!("{name}: dead_zone is {}; expected 0 to 0.9", self.dead_zone));
        }
        if let Some(f) = self.filter
            && !((0.01..=1000.0).contains(&f.min_cutoff_hz) && (0.0..=1000.0).contains(&f.beta))
        {
            return broken(format!("{name}: filter: expected min_cutoff_hz from 0.01 to 1000 and beta from 0 to 1000"));
        }
        if self.mode != Mode::Absolute && (self.filter.is_some() || self.wraps) {
            return broken(format!("{name}: only an Absolute axis has a filter or wraps"));
        }
        Ok(())
    }
}

impl Source {
    fn check(&self, name: &str) -> Result<(), RuleError> {
        match self {
            Self::Usage { .. } => Ok(()),
            Self::Bits { start, bits, .. } if (1..=32).contains(bits) && usize::from(*start) < 8 * LONGEST => Ok(()),
            Self::Bits { start, bits, .. } => broken(format!("{name}: {bits} bits from bit {start}; expected 1 to 32 bits")),
            Self::Buttons { plus, minus } => plus.check(name).and_then(|()| minus.check(name)),
        }
    }
}

impl Button {
    fn check(&self, name: &str) -> Result<(), RuleError> {
        match *self.from {
            Source::Buttons { .. } => broken(format!("{name}: a button is read from Usage or Bits, not from Buttons")),
            ref source => source.check(name),
        }
    }
}

impl ForceProfile {
    fn check(&self, hands: usize) -> Result<(), RuleError> {
        if !(1..=64).contains(&self.bytes) || !(1.0..=1000.0).contains(&self.rate_hz) {
            return broken("force: expected 1 to 64 bytes and a rate_hz from 1 to 1000");
        }
        for channel in &self.channels {
            let end = usize::from(channel.start) + usize::from(channel.bits);
            if !(2..=32).contains(&channel.bits) || end > 8 * usize::from(self.bytes) {
                return broken(format!("force: {:?}: expected 2 to 32 bits within the report's {} bytes", channel.effort, self.bytes));
            }
            let sound = channel.counts_per_unit.is_finite() && channel.limit.is_finite() && channel.limit >= 0.0;
            if usize::from(channel.hand) >= hands || !sound {
                return broken(format!("force: {:?}: expected one of the {hands} hands, and finite numbers", channel.effort));
            }
        }
        Ok(())
    }
}
