//! The sweep of the snapping threshold: what each does to shape, growth and stable step, and which is best.

use crate::study::Study;
use crate::study::plan::Combination;
use crate::study::run::Run;

/// One threshold of the sweep, over all meshes and strokes: geometric means of figures relative to those without snapping.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Threshold {
    /// The threshold.
    pub snap: f64,
    /// Smallest dihedral angle.
    pub min_dihedral: f64,
    /// First percentile of dihedral angles.
    pub p1_dihedral: f64,
    /// Smallest altitude.
    pub altitude: f64,
    /// Growth.
    pub growth: f64,
    /// Stable step.
    pub stable_step: f64,
    /// Smallest dihedral angle in what was core.
    pub core_min_dihedral: f64,
    /// First percentile of dihedral angles in what was core.
    pub core_p1_dihedral: f64,
    /// Smallest altitude in what was core.
    pub core_altitude: f64,
}

/// A figure of a run for the sweep, with whether more of it is better.
type Judged = (&'static str, fn(&Threshold) -> f64, bool);

/// The shape of what was core alone: the hull is released at once and does not snap.
pub const JUDGED_CORE: [Judged; 3] = [
    ("core: smallest dihedral angle", |t| t.core_min_dihedral, true),
    ("core: first percentile", |t| t.core_p1_dihedral, true),
    ("core: smallest altitude", |t| t.core_altitude, true),
];

/// What thresholds are judged by.
pub const JUDGED: [Judged; 5] = [
    ("smallest dihedral angle", |t| t.min_dihedral, true),
    ("first percentile of dihedral angles", |t| t.p1_dihedral, true),
    ("smallest altitude", |t| t.altitude, true),
    ("growth", |t| t.growth, false),
    ("stable step", |t| t.stable_step, true),
];

/// The sweep relative to no snapping.
#[must_use]
pub fn thresholds(study: &Study) -> Vec<Threshold> {
    let mean = |snap: f64, of: fn(&Run) -> Option<f64>| {
        let mut logs = Vec::new();
        for run in study.sweep.iter().filter(|r| r.combination.snap == snap) {
            let reference = Combination { snap: 0.0, ..run.combination };
            let zero = study.sweep.iter().find(|r| r.combination == reference);
            if let (Some(value), Some(zero)) = (of(run), zero.and_then(of))
                && value > 0.0
                && zero > 0.0
            {
                logs.push((value / zero).ln());
            }
        }
        (logs.iter().sum::<f64>() / logs.len().max(1) as f64).exp()
    };
    let threshold = |&snap: &f64| Threshold {
        snap,
        min_dihedral: mean(snap, |r| r.end().min_dihedral_deg),
        p1_dihedral: mean(snap, |r| r.end().p1_dihedral_deg),
        altitude: mean(snap, |r| r.end().min_altitude_mm),
        growth: mean(snap, |r| Some(r.end().growth)),
        stable_step: mean(snap, |r| r.end().stable_step_us),
        core_min_dihedral: mean(snap, |r| Some(r.core?.min_dihedral_deg)),
        core_p1_dihedral: mean(snap, |r| Some(r.core?.p1_dihedral_deg)),
        core_altitude: mean(snap, |r| Some(r.core?.min_altitude_m)),
    };
    study.plan.sweep.iter().map(threshold).collect()
}

/// The best threshold by one figure: the smallest of those within a thousandth of the best.
#[must_use]
pub fn best_by(all: &[Threshold], of: fn(&Threshold) -> f64, more_is_better: bool) -> Option<f64> {
    let score = |t: &Threshold| if more_is_better { of(t) } else { 1.0 / of(t) };
    let best = all.iter().map(score).fold(0.0, f64::max);
    all.iter().find(|t| score(t) >= best * (1.0 - 1e-3)).map(|t| t.snap)
}

/// The best threshold by several figures together: the largest product of gains, that is their geometric mean with equal weights.
#[must_use]
pub fn best(all: &[Threshold], judged: &[Judged]) -> Option<f64> {
    let gain = |t: &Threshold| judged.iter().map(|(_, of, more)| if *more { of(t) } else { 1.0 / of(t) }).product();
    let highest = all.iter().map(gain).fold(0.0, f64::max);
    all.iter().find(|t| gain(t) >= highest * (1.0 - 1e-3)).map(|t| t.snap)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_best_threshold_is_the_least_that_is_as_good_as_any() {
        let at = |snap, angle, growth| Threshold {
            snap,
            min_dihedral: angle,
            p1_dihedral: 1.0,
            altitude: 1.0,
            growth,
            stable_step: 1.0,
            core_min_dihedral: 1.0,
            core_p1_dihedral: 1.0,
            core_altitude: 1.0,
        };
        let all = [at(0.0, 1.0, 1.0), at(0.1, 2.0, 0.9), at(0.2, 2.0, 0.9), at(0.3, 1.5, 0.8)];
        assert_eq!(best_by(&all, |t| t.min_dihedral, true), Some(0.1));
        assert_eq!(best_by(&all, |t| t.growth, false), Some(0.3));
        assert_eq!(best(&all, &JUDGED), Some(0.1));
        assert_eq!(best(&[], &JUDGED), None);
    }
}
