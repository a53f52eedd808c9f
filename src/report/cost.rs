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

/// The costs of every tick so far.
#[derive(Clone, Debug, Default)]
pub struct Costs {
    ticks: Vec<[f64; TickSystems::ALL.len()]>,
}

impl Costs {
    /// Takes down the tick that has just ended.
    pub fn record(&mut self, cost: &TickCost) {
        self.ticks.push(cost.last.map(|d| d.as_secs_f64() * 1e3));
    }

    /// The whole tick, ms.
    #[must_use]
    pub fn tick(&self) -> Cost {
        Cost::of(self.ticks.iter().map(|stages| stages.iter().sum()).collect())
    }

    /// Each stage by its name, in order of the tick.
    #[must_use]
    pub fn stages(&self) -> Vec<(String, Cost)> {
        let stage = |(i, stage)| (format!("{stage:?}"), Cost::of(self.ticks.iter().map(|t| t[i]).collect()));
        TickSystems::ALL.iter().enumerate().map(stage).collect()
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
}
