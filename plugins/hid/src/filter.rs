//! What is done to a number between its field and the hand: smoothing, play, dead zone, turns counted.

use crate::profile::Filter;
use std::f64::consts::TAU;

/// The 1 euro filter (Casiez, Roussel, Vogel, CHI 2012): a low pass whose cut-off rises with the speed, so that rest is quiet and a fast
/// movement is not late.
#[derive(Clone, Copy, Debug)]
pub struct OneEuro {
    settings: Filter,
    last: Option<(f64, f64, f64)>,
}

/// Cut-off for the speed, Hz: the paper's.
const SPEED_CUTOFF_HZ: f64 = 1.0;

fn smoothing(cutoff_hz: f64, dt_s: f64) -> f64 {
    let r = TAU * cutoff_hz * dt_s;
    r / (r + 1.0)
}

impl OneEuro {
    /// A filter that has seen nothing.
    #[must_use]
    pub fn new(settings: Filter) -> Self {
        Self { settings, last: None }
    }

    /// The smoothed value at a time, s. Times that do not grow count as a tenth of a millisecond: reports may arrive in bunches.
    pub fn take(&mut self, at_s: f64, value: f64) -> f64 {
        let Some((then_s, smooth, speed)) = self.last else {
            self.last = Some((at_s, value, 0.0));
            return value;
        };
        let dt_s = (at_s - then_s).max(1e-4);
        let speed = speed + smoothing(SPEED_CUTOFF_HZ, dt_s) * ((value - smooth) / dt_s - speed);
        let cutoff_hz = self.settings.min_cutoff_hz + self.settings.beta * speed.abs();
        let smooth = smooth + smoothing(cutoff_hz, dt_s) * (value - smooth);
        self.last = Some((at_s, smooth, speed));
        smooth
    }

    /// Forgets everything.
    pub fn reset(&mut self) {
        self.last = None;
    }
}

/// A speed with its dead zone taken out: nothing within `zone` (a part of `most`), the whole of `most` at the end, and no step between.
#[must_use]
pub fn dead_zone(speed: f64, most: f64, zone: f64) -> f64 {
    let outside = speed.abs() - zone * most;
    if outside <= 0.0 || most <= 0.0 { 0.0 } else { speed.signum() * (outside / (1.0 - zone)).min(most) }
}

/// A position with play: it stays while the handle moves within `play` and follows behind it outside.
#[must_use]
pub fn follow(position: f64, handle: f64, play: f64) -> f64 {
    position.clamp(handle - play, handle + play)
}

/// The count nearest to `before` that stands for the same angle as `count` on an encoder with `turn` counts.
#[must_use]
pub fn unwrapped(before: f64, count: f64, turn: f64) -> f64 {
    count + turn * ((before - count) / turn).round()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_filter_quietens_rest_and_keeps_up_with_a_movement() {
        let mut filter = OneEuro::new(Filter { min_cutoff_hz: 2.0, beta: 1.0 });
        let noise = |i: u32| if i.is_multiple_of(2) { 0.1 } else { -0.1 };
        let still: Vec<f64> = (0..2000).map(|i| filter.take(f64::from(i) * 1e-3, noise(i))).collect();
        assert!(still[1000..].iter().all(|v| v.abs() < 0.01), "a tenth of the noise at most");
        let mut late: f64 = 0.0;
        for i in 2000..3000 {
            let at_s = f64::from(i) * 1e-3;
            let truth = 100.0 * (at_s - 2.0);
            late = (truth - filter.take(at_s, truth)) / 100.0;
        }
        assert!(late > 0.0 && late < 0.002, "{late} s behind a movement of 100 units a second");
    }

    #[test]
    fn a_dead_zone_has_no_step_and_reaches_the_end() {
        assert_eq!(dead_zone(0.1, 1.0, 0.1), 0.0);
        assert!((dead_zone(0.1 + 1e-9, 1.0, 0.1)).abs() < 1e-8);
        assert_eq!(dead_zone(-1.0, 1.0, 0.1), -1.0);
        assert_eq!(dead_zone(0.5, 1.0, 0.0), 0.5);
    }

    #[test]
    fn turns_are_counted_and_play_is_kept() {
        let mut at = 4000.0;
        for count in [4090.0, 20.0, 2000.0, 4000.0, 100.0] {
            at = unwrapped(at, count, 4096.0);
        }
        assert_eq!(at, 100.0 + 2.0 * 4096.0);
        assert_eq!((follow(0.0, 0.4, 0.5), follow(0.0, 2.0, 0.5), follow(1.5, -2.0, 0.5)), (0.0, 1.5, -1.5));
    }
}
