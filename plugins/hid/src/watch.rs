//! Whether what a device says can be believed.

use std::time::Duration;

/// Reports that are looked back on.
const MEMORY: u32 = 32;
/// Of those, refused ones that make a device one that sends garbage.
const MOST_REFUSED: u32 = MEMORY / 2;
/// Good ones in a row that make it sound again.
const GOOD_AGAIN: u32 = MEMORY / 2;
/// Shortest silence of a device that always sends, s.
const SHORTEST_SILENCE_S: f64 = 0.25;
/// Reports that may be missing.
const MISSING_REPORTS: f64 = 20.0;

/// The stream of reports of one device.
#[derive(Clone, Copy, Debug)]
pub struct StreamWatch {
    /// A bit a report, the newest lowest: set when it was refused.
    refused: u32,
    garbage: bool,
    silence: Option<Duration>,
    heard: Duration,
}

impl StreamWatch {
    /// A device that was opened at `now`, and sends `rate_hz` reports a second if it always sends.
    #[must_use]
    pub fn new(now: Duration, rate_hz: Option<f32>) -> Self {
        let silence = rate_hz.map(|hz| Duration::from_secs_f64((MISSING_REPORTS / f64::from(hz)).max(SHORTEST_SILENCE_S)));
        Self { refused: 0, garbage: false, silence, heard: now }
    }

    /// Takes note of a report.
    pub fn hear(&mut self, now: Duration, good: bool) {
        self.refused = self.refused << 1 | u32::from(!good);
        if good {
            self.heard = now;
        }
        if self.refused.count_ones() >= MOST_REFUSED {
            self.garbage = true;
        } else if self.refused.trailing_zeros() >= GOOD_AGAIN {
            self.garbage = false;
        }
    }

    /// Whether too much of what it sends makes no sense.
    #[must_use]
    pub fn garbage(&self) -> bool {
        self.garbage
    }

    /// Whether it has said nothing for longer than it should.
    #[must_use]
    pub fn silent(&self, now: Duration) -> bool {
        self.silence.is_some_and(|most| now.saturating_sub(self.heard) > most)
    }
}

/// Part of an axis's range that its trembling has to have before it is called noisy.
const NOISE: f64 = 0.01;
/// Second over first differences: 1.7 for white noise, far below 1 for a hand.
const ROUGH: f64 = 1.2;
/// Reports over which differences are averaged.
const AVERAGED: f64 = 64.0;
/// Part of an axis's range that it has to move before that counts as travel.
const STRIDE: f64 = 0.02;
/// Ranges that the other axes travel before one that did not change once is called stuck.
const LONG_WAY: f64 = 6.0;

/// One axis.
#[derive(Clone, Copy, Debug, Default)]
pub struct AxisWatch {
    last: Option<f64>,
    step: f64,
    mean_step: f64,
    mean_turn: f64,
    anchor: Option<f64>,
    /// Ranges that the other axes have travelled since this one changed.
    others: f64,
}

impl AxisWatch {
    /// Takes note of a position as a part of the axis's range; gives how far it travelled, in ranges.
    pub fn hear(&mut self, part: f64) -> f64 {
        let Some(last) = self.last.replace(part) else {
            self.anchor = Some(part);
            return 0.0;
        };
        let step = part - last;
        self.mean_step += (step.abs() - self.mean_step) / AVERAGED;
        self.mean_turn += ((step - self.step).abs() - self.mean_turn) / AVERAGED;
        self.step = step;
        if step != 0.0 {
            self.others = 0.0;
        }
        let stride = (part - self.anchor.unwrap_or(part)).abs();
        if stride < STRIDE {
            return 0.0;
        }
        self.anchor = Some(part);
        stride
    }

    /// The hand is somewhere else: the way there was no trembling.
    pub fn settle(&mut self) {
        *self = Self { others: self.others, ..Self::default() };
    }

    /// Takes note that the other axes of the hand travelled so many ranges.
    pub fn others_travelled(&mut self, ranges: f64) {
        self.others += ranges;
    }

    /// Whether it trembles more than a hand can.
    #[must_use]
    pub fn noisy(&self) -> bool {
        self.mean_step > NOISE && self.mean_turn > ROUGH * self.mean_step
    }

    /// Whether it stays where it is while the others move.
    #[must_use]
    pub fn stuck(&self) -> bool {
        self.others > LONG_WAY
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_told_from_a_fast_hand() {
        let mut tremor = AxisWatch::default();
        let mut hand = AxisWatch::default();
        let mut seed = 1u32;
        for i in 0..1000 {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            tremor.hear(0.5 + 0.1 * (f64::from(seed) / f64::from(u32::MAX) - 0.5));
            // The whole range, four times a second, heard a hundred times a second.
            hand.hear(0.5 + 0.5 * (f64::from(i) * 0.01 * 4.0 * std::f64::consts::TAU).sin());
        }
        assert!(tremor.noisy() && !hand.noisy(), "{tremor:?} {hand:?}");
    }

    #[test]
    fn half_of_the_reports_refused_is_garbage_and_a_run_of_good_ones_is_not() {
        let mut watch = StreamWatch::new(Duration::ZERO, Some(1000.0));
        for i in 0..64 {
            watch.hear(Duration::from_millis(i), i % 2 == 0);
        }
        assert!(watch.garbage());
        for i in 64..64 + u64::from(GOOD_AGAIN) {
            assert!(watch.garbage());
            watch.hear(Duration::from_millis(i), true);
        }
        assert!(!watch.garbage());
        assert!(!watch.silent(Duration::from_millis(300)) && watch.silent(Duration::from_millis(400)));
    }
}
