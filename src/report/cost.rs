//! What ticks cost, stage by stage.

use keyhole_whiteboard::{TickCost, TickSystems};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Cost of one stage, or of the whole tick, over all ticks: milliseconds of wall-clock time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Cost {
    /// Mean.
    pub mean: f64,
    /// Median.
    pub p50: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Largest.
    pub max: f64,
}

/// The costs of every tick so far. However many there are, it grows no larger.
#[derive(Clone, Debug, Default)]
pub struct Costs {
    stages: [Tally; TickSystems::ALL.len()],
    whole: Tally,
}

/// How often there was which cost: 64 steps from a cost to its double.
#[derive(Clone, Debug, Default)]
struct Tally {
    counts: Vec<u64>,
    ticks: u64,
    sum: f64,
    max: f64,
}

/// Bits of a float that are not told apart.
const BLURRED: u32 = 17;
/// The least cost that is told from none, ms: 60 ns. The first step.
const LEAST_MS: f32 = 1.0 / 16_384.0;
/// Steps up to 16 s.
const STEPS: usize = 28 * 64;

impl Tally {
    fn push(&mut self, ms: f64) {
        let step = (ms as f32).max(LEAST_MS).to_bits().saturating_sub(LEAST_MS.to_bits()) >> BLURRED;
        self.counts.resize(STEPS, 0);
        self.counts[(step as usize).min(STEPS - 1)] += 1;
        self.ticks += 1;
        self.sum += ms;
        self.max = self.max.max(ms);
    }

    /// The nearest rank: within a hundredth the smallest cost that at least this share of the ticks does not exceed.
    fn rank(&self, share: f64) -> f64 {
        let rank = ((share * self.ticks as f64).ceil() as u64).clamp(1, self.ticks.max(1));
        let mut passed = 0;
        let step = self.counts.iter().position(|count| {
            passed += count;
            passed >= rank
        });
        let middle = |step: usize| f32::from_bits(LEAST_MS.to_bits() + ((step as u32) << BLURRED) + (1 << (BLURRED - 1)));
        step.map_or(0.0, |step| f64::from(middle(step)).min(self.max))
    }

    fn cost(&self) -> Cost {
        if self.ticks == 0 {
            return Cost::default();
        }
        Cost { mean: self.sum / self.ticks as f64, p50: self.rank(0.5), p99: self.rank(0.99), max: self.max }
    }
}

impl Costs {
    /// Takes down the tick that has just ended.
    pub fn record(&mut self, cost: &TickCost) {
        let ms = cost.last.map(|d| d.as_secs_f64() * 1e3);
        self.stages.iter_mut().zip(ms).for_each(|(tally, ms)| tally.push(ms));
        self.whole.push(ms.iter().sum());
    }

    /// The whole tick, ms.
    #[must_use]
    pub fn tick(&self) -> Cost {
        self.whole.cost()
    }

    /// Each stage by its name, in order of the tick.
    #[must_use]
    pub fn stages(&self) -> Vec<(String, Cost)> {
        TickSystems::ALL.iter().zip(&self.stages).map(|(stage, tally)| (format!("{stage:?}"), tally.cost())).collect()
    }

    /// Each stage by its name.
    #[must_use]
    pub fn by_stage(&self) -> BTreeMap<String, Cost> {
        self.stages().into_iter().collect()
    }
}

impl Cost {
    /// The statistics of some costs; all zero when there is none.
    #[must_use]
    pub fn of(mut ms: Vec<f64>) -> Self {
        if ms.is_empty() {
            return Self::default();
        }
        ms.sort_unstable_by(f64::total_cmp);
        // Nearest rank: the smallest value that at least this share of the ticks does not exceed.
        let rank = |share: f64| ms[((share * ms.len() as f64).ceil() as usize).clamp(1, ms.len()) - 1];
        Self { mean: ms.iter().sum::<f64>() / ms.len() as f64, p50: rank(0.5), p99: rank(0.99), max: rank(1.0) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranks_are_the_nearest() {
        let cost = Cost::of((1..=200).rev().map(f64::from).collect());
        assert_eq!((cost.p50, cost.p99, cost.max, cost.mean), (100.0, 198.0, 200.0, 100.5));
        assert_eq!(Cost::of(vec![3.0]), Cost { mean: 3.0, p50: 3.0, p99: 3.0, max: 3.0 });
        assert_eq!(Cost::of(Vec::new()), Cost::default());
    }

    /// What is counted is what is sorted, but for a hundredth, and a million ticks take no more room than one.
    #[test]
    fn tallies_are_true_and_small() {
        let costs: Vec<f64> = (0..1_000_000_u64).map(|i| 1e-4 + 20.0 * ((i * 7919) % 1_000_003) as f64 / 1e6).collect();
        let mut tally = Tally::default();
        costs.iter().for_each(|ms| tally.push(*ms));
        let (found, sorted) = (tally.cost(), Cost::of(costs));
        for (a, b) in [(found.mean, sorted.mean), (found.p50, sorted.p50), (found.p99, sorted.p99), (found.max, sorted.max)] {
            assert!((a - b).abs() <= 1e-2 * b, "{a} {b}");
        }
        assert_eq!(tally.counts.len(), STEPS);
        assert_eq!(Tally::default().cost(), Cost::default());
    }
}
