//! What the paper says beside what was measured. Every verdict is computed.

use crate::study::Study;
use crate::study::plan::{Combination, PATTERNS, Plan};
use crate::study::run::Run;
use crate::study::strokes::Stroke;
use keyhole_whiteboard::{CutMethod, CutPattern};

/// Growth of the paper's symmetric subdivision: "almost 3".
pub const PAPER_SYMMETRIC: [f64; 2] = [2.5, 3.0];
/// Growth of the paper's hybrid method.
pub const PAPER_HYBRID: f64 = 1.5;
/// Part of the operations that the paper's hybrid method avoids.
pub const PAPER_AVOIDED: f64 = 0.8;

/// Growth of one stroke through one mesh by the settings that the paper compares.
#[derive(Clone, Debug)]
pub struct Growth<'s> {
    /// Progressive, symmetric.
    pub symmetric: &'s Run,
    /// Progressive, minimal.
    pub minimal: &'s Run,
    /// Hybrid, minimal, snapping as by default.
    pub hybrid: &'s Run,
    /// Hybrid, minimal, without snapping.
    pub hybrid_unsnapped: &'s Run,
    /// Hybrid, the paper's own mixture of patterns, snapping as by default.
    pub mixture: &'s Run,
    /// The same without snapping.
    pub mixture_unsnapped: &'s Run,
}

impl Growth<'_> {
    /// Whether symmetric grows as the paper's does.
    #[must_use]
    pub fn is_the_papers_case(&self) -> bool {
        let [low, high] = PAPER_SYMMETRIC;
        (low..=high).contains(&self.symmetric.end().growth)
    }

    /// Whether hybrid grows no more than the paper's.
    #[must_use]
    pub fn agrees(&self) -> bool {
        self.hybrid.end().growth <= PAPER_HYBRID
    }

    /// How many parts a cut tetrahedron may have on average for hybrid to grow as the paper's: the share of cut tetrahedra is set by mesh and stroke.
    #[must_use]
    pub fn parts_allowed(&self) -> f64 {
        1.0 + (PAPER_HYBRID - 1.0) / self.hybrid_unsnapped.cut_share().max(f64::MIN_POSITIVE)
    }
}

/// Growth on every mesh for every stroke, at the coarser rate.
#[must_use]
pub fn growth(study: &Study) -> Vec<Growth<'_>> {
    let [on, off] = Plan::snaps();
    places(study)
        .into_iter()
        .filter_map(|place| {
            let run = |method, pattern, snap| study.find(&Combination { method, pattern, snap, ..place });
            let hybrid = CutMethod::Hybrid;
            Some(Growth {
                symmetric: run(CutMethod::Progressive, PATTERNS[1], off)?,
                minimal: run(CutMethod::Progressive, PATTERNS[0], off)?,
                hybrid: run(hybrid, PATTERNS[0], on)?,
                hybrid_unsnapped: run(hybrid, PATTERNS[0], off)?,
                mixture: run(hybrid, PATTERNS[2], on)?,
                mixture_unsnapped: run(hybrid, PATTERNS[2], off)?,
            })
        })
        .collect()
}

/// Mesh and stroke of each cut at the coarser rate, the rest of the combination that of the first.
fn places(study: &Study) -> Vec<Combination> {
    let mut places: Vec<Combination> = Vec::new();
    for run in &study.runs {
        let c = run.combination;
        if study.plan.rates.first() == Some(&c.rate) && !places.iter().any(|p| p.mesh == c.mesh && p.stroke == c.stroke) {
            places.push(c);
        }
    }
    places
}

/// Operations that hybrid avoids.
#[derive(Clone, Copy, Debug)]
pub struct Avoided<'s> {
    /// Progressive.
    pub progressive: &'s Run,
    /// Non-progressive, with hybrid's patterns and snapping: nothing is done twice, so no method avoids more.
    pub non_progressive: &'s Run,
    /// Hybrid.
    pub hybrid: &'s Run,
}

impl Avoided<'_> {
    /// What is to be expected of deletions and updates if a cut core tetrahedron costs hybrid what it costs the non-progressive method, a hull one what
    /// it costs the progressive one, and all cost the same on average: the core's share of what the non-progressive method avoids.
    #[must_use]
    pub fn expected(&self) -> f64 {
        let sum = |r: &Run| r.end().operations.deleted + r.end().operations.updated;
        self.progressive.core_share() * Self::part(sum(self.non_progressive), sum(self.progressive))
    }

    fn part(hybrid: u64, progressive: u64) -> f64 {
        1.0 - hybrid as f64 / progressive.max(1) as f64
    }

    /// Of deletions.
    #[must_use]
    pub fn deleted(&self) -> f64 {
        Self::part(self.hybrid.end().operations.deleted, self.progressive.end().operations.deleted)
    }

    /// Of creations.
    #[must_use]
    pub fn created(&self) -> f64 {
        Self::part(self.hybrid.end().operations.created, self.progressive.end().operations.created)
    }

    /// Of updates.
    #[must_use]
    pub fn updated(&self) -> f64 {
        Self::part(self.hybrid.end().operations.updated, self.progressive.end().operations.updated)
    }

    /// Of all three.
    #[must_use]
    pub fn all(&self) -> f64 {
        let sum = |r: &Run| {
            let o = r.end().operations;
            o.deleted + o.created + o.updated
        };
        Self::part(sum(self.hybrid), sum(self.progressive))
    }

    /// Of what can be avoided at most: deletions and updates.
    #[must_use]
    pub fn deleted_and_updated(&self) -> f64 {
        let sum = |r: &Run| r.end().operations.deleted + r.end().operations.updated;
        Self::part(sum(self.hybrid), sum(self.progressive))
    }

    /// Whether hybrid avoids as much as the paper says.
    #[must_use]
    pub fn agrees(&self) -> bool {
        self.deleted_and_updated() >= PAPER_AVOIDED
    }
}

/// What hybrid avoids, for every mesh, stroke, pattern, snapping and rate, both methods with the same settings but for the method.
#[must_use]
pub fn avoided(study: &Study) -> Vec<Avoided<'_>> {
    study
        .runs
        .iter()
        .filter(|r| r.combination.method == CutMethod::Hybrid)
        .filter_map(|hybrid| {
            let with = |method| study.find(&Combination { method, ..hybrid.combination });
            Some(Avoided { progressive: with(CutMethod::Progressive)?, non_progressive: with(CutMethod::NonProgressive)?, hybrid })
        })
        .collect()
}

/// The same against symmetric progressive subdivision without snapping, for hybrid with minimal patterns and snapping as by default.
#[must_use]
pub fn avoided_of_symmetric(study: &Study) -> Vec<Avoided<'_>> {
    let on = Plan::snaps()[0];
    let minimal = |c: &Combination| c.pattern.hull == CutPattern::Minimal && c.pattern.core == CutPattern::Minimal;
    study
        .runs
        .iter()
        .filter(|r| r.combination.method == CutMethod::Hybrid && minimal(&r.combination) && r.combination.snap == on)
        .filter_map(|hybrid| {
            let c = Combination { method: CutMethod::Progressive, pattern: PATTERNS[1], snap: 0.0, ..hybrid.combination };
            let settled = Combination { method: CutMethod::NonProgressive, ..hybrid.combination };
            Some(Avoided { progressive: study.find(&c)?, non_progressive: study.find(&settled)?, hybrid })
        })
        .collect()
}

/// How the mean edge ratio goes for the three methods with the same patterns and snapping, in the order progressive, non-progressive, hybrid.
#[derive(Clone, Copy, Debug)]
pub struct Quality<'s> {
    /// The three.
    pub runs: [&'s Run; 3],
}

impl Quality<'_> {
    /// Depth of the deepest local minimum of the mean edge ratio: how far it is below the higher values both before and after it. The first fifth of
    /// the cut, of few tetrahedra, is left out.
    #[must_use]
    pub fn dip(run: &Run) -> f64 {
        let ratios = Self::ratios(run);
        let highest = |part: &[f64]| part.iter().copied().fold(0.0, f64::max);
        (0..ratios.len()).map(|i| highest(&ratios[..=i]).min(highest(&ratios[i..])) - ratios[i]).fold(0.0, f64::max)
    }

    fn ratios(run: &Run) -> Vec<f64> {
        run.figures.iter().filter(|f| f.progress > 0.2).filter_map(|f| f.mean_edge_ratio).collect()
    }

    /// Number of local minima: moments with a lower mean than those before and after it.
    #[must_use]
    pub fn minima(run: &Run) -> usize {
        Self::ratios(run).windows(3).filter(|w| w[1] < w[0] && w[1] < w[2]).count()
    }

    /// Whether progressive has local minima.
    #[must_use]
    pub fn progressive_dips(&self) -> bool {
        Self::minima(self.runs[0]) > 0 && Self::dip(self.runs[0]) > 0.0
    }

    /// Whether hybrid's mean is above progressive's over the cut: the mean of their difference over the moments that both have.
    #[must_use]
    pub fn hybrid_above_progressive(&self) -> f64 {
        let [progressive, _, hybrid] = self.runs;
        let pairs: Vec<f64> =
            progressive.figures.iter().zip(&hybrid.figures).filter_map(|(p, h)| Some(h.mean_edge_ratio? - p.mean_edge_ratio?)).collect();
        pairs.iter().sum::<f64>() / pairs.len().max(1) as f64
    }

    /// Whether the three end in the same mesh, to the bit.
    #[must_use]
    pub fn same_end(&self) -> bool {
        self.runs.iter().all(|r| r.fingerprint == self.runs[0].fingerprint)
    }
}

/// Every mesh, stroke, pattern and snapping at the coarser rate.
#[must_use]
pub fn quality(study: &Study) -> Vec<Quality<'_>> {
    let progressive = study.runs.iter().filter(|r| r.combination.method == CutMethod::Progressive);
    progressive
        .filter(|r| study.plan.rates.first() == Some(&r.combination.rate))
        .filter_map(|run| {
            let with = |method| study.find(&Combination { method, ..run.combination });
            Some(Quality { runs: [run, with(CutMethod::NonProgressive)?, with(CutMethod::Hybrid)?] })
        })
        .collect()
}

/// The run with the largest lag in mean edges of one method at one rate, and that lag.
#[must_use]
pub fn largest_lag(study: &Study, method: CutMethod, rate: f64) -> Option<(&Run, f64)> {
    let of = study.runs.iter().filter(|r| r.combination.method == method && r.combination.rate == rate);
    of.map(|r| (r, r.max_lag_mm / r.mean_edge_mm)).max_by(|a, b| a.1.total_cmp(&b.1))
}

/// Mean of the lags of all cuts of one method at one rate and all their moments at which the blade is in the tissue's surface or has been, in mean edges.
#[must_use]
pub fn mean_lag(study: &Study, method: CutMethod, rate: f64) -> f64 {
    let of = study.runs.iter().filter(|r| r.combination.method == method && r.combination.rate == rate);
    let lags: Vec<f64> = of.flat_map(|r| r.figures.iter().filter(|f| f.swept_mm2 > 0.0).map(|f| f.lag_mm / r.mean_edge_mm)).collect();
    lags.iter().sum::<f64>() / lags.len().max(1) as f64
}

/// The pair of mesh and stroke in which symmetric comes closest to the middle of the paper's growth.
#[must_use]
pub fn closest<'a, 's>(all: &'a [Growth<'s>]) -> Option<&'a Growth<'s>> {
    let middle = PAPER_SYMMETRIC.iter().sum::<f64>() / 2.0;
    let off = |g: &Growth| (g.symmetric.end().growth - middle).abs();
    all.iter().min_by(|a, b| off(a).total_cmp(&off(b)))
}

/// Name of a run's mesh and stroke.
#[must_use]
pub fn place(study: &Study, run: &Run) -> String {
    let c = run.combination;
    let stroke: Stroke = c.stroke;
    format!("{}, {}", study.plan.meshes[c.mesh].name, stroke.name())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::run::Figures;

    fn run(ratios: &[f64]) -> Run {
        let n = ratios.len() as f64;
        let figures = |(i, r): (usize, &f64)| Figures { progress: (i + 1) as f64 / n, mean_edge_ratio: Some(*r), ..Figures::default() };
        Run {
            combination: Combination { mesh: 0, stroke: Stroke::S, method: CutMethod::Hybrid, pattern: PATTERNS[0], snap: 0.0, rate: 0.25 },
            mean_edge_mm: 1.0,
            tets_before: 100,
            samples: 1,
            figures: ratios.iter().enumerate().map(figures).collect(),
            cut_tets: 10,
            cut_core: 4,
            parts: 47,
            core: None,
            fragments: 1,
            max_lag_mm: 0.0,
            fingerprint: 0,
            latency: crate::study::run::Latency::default(),
        }
    }

    #[test]
    fn dips_and_minima_are_counted() {
        let smooth = run(&[0.1, 0.2, 0.5, 0.5, 0.5]);
        assert_eq!((Quality::dip(&smooth), Quality::minima(&smooth)), (0.0, 0));
        // Down from 0.5 to 0.3, but no more than 0.4 after it.
        let rough = run(&[0.1, 0.2, 0.5, 0.3, 0.4, 0.35, 0.4]);
        assert!((Quality::dip(&rough) - 0.1).abs() < 1e-12);
        assert_eq!(Quality::dip(&run(&[0.1, 0.2, 0.5, 0.4, 0.3])), 0.0);
        assert_eq!(Quality::minima(&rough), 2);
        assert_eq!((rough.core_share(), rough.cut_share(), rough.parts_a_tet()), (0.4, 0.1, 4.7));
    }
}
