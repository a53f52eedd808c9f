//! `keyhole study trade`: what a soft-tissue model costs and how right it is, for every model, its settings and several meshes.
//!
//! A run drops the loads on the body at once and lets it come to rest by drag. Its *error* is that of the answer (see [`Case::answer`]) against the reference
//! on the same mesh: what the model makes of it. Its *total error* is that against the closed form, or else against the reference in ten-node elements on the finest
//! mesh: what mesh and model make of it together. *Way* is the largest distance of the beam's tip from the reference's way in the quarter of a second after the
//! load was dropped on it, without drag, as a part of its sag at rest; *swing* the time of its first turn against the reference's.

use crate::study::contender::{Bout, Contender, TICK_S};
use crate::study::specimen::{Case, Specimen};
use keyhole_imaging::ImagingError;
use keyhole_tissue::TissueSettings;
use keyhole_tissue::reference::{Dynamics, ReferenceError};

/// What a study of the trade is about.
#[derive(Clone, Debug)]
pub struct TradePlan {
    /// The cases, and how many of the sizes of each are run, the coarsest first.
    pub cases: Vec<(Case, usize)>,
    /// Who is compared.
    pub contenders: Vec<Contender>,
    /// A run whose first tick shows that it would take longer than this is left out, s.
    pub patience_s: f64,
}

impl Default for TradePlan {
    fn default() -> Self {
        Self { cases: Case::ALL.into_iter().map(|c| (c, 2)).collect(), contenders: Contender::all(), patience_s: 20.0 }
    }
}

/// Why there is no result.
#[derive(Debug, thiserror::Error)]
pub enum TradeError {
    /// The phantom.
    #[error("the phantom's kidney: {0}")]
    Phantom(#[from] ImagingError),
    /// The reference.
    #[error("{case}, {tets} tets: {source}")]
    Reference {
        /// Name of the case.
        case: &'static str,
        /// Size of the mesh.
        tets: usize,
        /// What it says.
        source: ReferenceError,
    },
}

/// One mesh of one case.
#[derive(Clone, Debug)]
pub struct Bench {
    /// The case.
    pub case: Case,
    /// Number of tetrahedra.
    pub tets: usize,
    /// The answer of the reference on this mesh.
    pub reference: f64,
    /// The reference's way after the load was dropped, tick by tick, where it is looked at.
    pub way: Option<Vec<f64>>,
    /// Time of its first turn, s.
    pub swing_s: Option<f64>,
    /// The closed form, or the reference in ten-node elements: on the finest mesh, of the kidney on the same one, whose shape is its own.
    pub truth: f64,
    /// Whether the truth is a closed form.
    pub is_closed: bool,
}

/// One run.
#[derive(Clone, Debug)]
pub struct TradeRun {
    /// Index of the mesh.
    pub bench: usize,
    /// Who.
    pub contender: Contender,
    /// Wall time a simulated second, s.
    pub cost: f64,
    /// Its answer; not a number when it left the finite numbers.
    pub answer: f64,
    /// The answer against that of the reference on this mesh, less one.
    pub error: f64,
    /// The answer against the truth, less one.
    pub total_error: f64,
    /// Root mean square of the distance from the reference's place, over all nodes, as a part of their way.
    pub shape_error: f64,
    /// Largest distance from the reference's way, as a part of its sag; infinite when it left the finite numbers.
    pub way_error: Option<f64>,
    /// Time of the first turn against the reference's, less one.
    pub swing_error: Option<f64>,
}

/// The whole study.
#[derive(Clone, Debug)]
pub struct Trade {
    /// Meshes.
    pub benches: Vec<Bench>,
    /// Runs.
    pub runs: Vec<TradeRun>,
}

/// Longest time that a body gets to come to rest, s.
const LONGEST_S: f32 = 2.5;
/// Change of the answer in a tick below which a body may be at rest, as a part of the answer...
const STILL: f64 = 2e-6;
/// ...and is, after so many ticks of it.
const STILL_TICKS: u32 = 12;

/// Time during which the dropped beam is looked at, s.
const WATCHED_S: f64 = 0.25;

/// Runs everything, one after another so that the clock measures one alone. `done` hears of each run.
///
/// # Errors
/// When the reference has no answer or the phantom cannot be meshed.
pub fn conduct(plan: &TradePlan, mut done: impl FnMut(&str)) -> Result<Trade, TradeError> {
    let mut trade = Trade { benches: Vec::new(), runs: Vec::new() };
    for (case, count) in &plan.cases {
        let specimens = case.sizes().iter().take(*count).map(|s| case.specimen(*s)).collect::<Result<Vec<_>, _>>()?;
        let failed = |s: &Specimen, source| TradeError::Reference { case: case.name(), tets: s.mesh.tet_count(), source };
        let (mut common, mut truths) = (None, Vec::new());
        for specimen in specimens.iter().rev() {
            // Of the finest mesh first: what the others are measured by as well.
            let own_shape = *case == Case::Kidney;
            if specimen.closed_form.is_none() && (common.is_none() || own_shape) {
                done(&format!("{}, reference in ten-node elements, {} tets", case.name(), specimen.mesh.tet_count()));
            }
            let truth = match (specimen.closed_form, common) {
                (Some(closed), _) => closed,
                (None, Some(truth)) if !own_shape => truth,
                _ => {
                    let body = specimen.quadratic().map_err(|e| failed(specimen, e))?;
                    let x = specimen.rest(&body).map_err(|e| failed(specimen, e))?;
                    specimen.ask(|n| x[n.index()])
                }
            };
            common = Some(truth);
            truths.push(truth);
        }
        truths.reverse();
        for (specimen, truth) in specimens.iter().zip(truths) {
            let tets = specimen.mesh.tet_count();
            done(&format!("{}, reference, {tets} tets", case.name()));
            let x = specimen.problem().and_then(|p| specimen.rest(&p)).map_err(|e| failed(specimen, e))?;
            let reference = specimen.ask(|n| x[n.index()]);
            let way = if specimen.swings() { Some(way_of_reference(specimen).map_err(|e| failed(specimen, e))?) } else { None };
            let (way, swing_s) = way.unzip();
            trade.benches.push(Bench {
                case: *case,
                tets,
                reference,
                way,
                swing_s: swing_s.flatten(),
                truth,
                is_closed: specimen.closed_form.is_some(),
            });
            let bench = trade.benches.len() - 1;
            for contender in &plan.contenders {
                done(&format!("{}, {} tets, {} {}", case.name(), tets, contender.name(), contender.setting()));
                if let Some(run) = run(specimen, contender, &x, &trade.benches[bench], bench, plan.patience_s) {
                    trade.runs.push(run);
                }
            }
        }
    }
    Ok(trade)
}

fn run(
    specimen: &Specimen,
    contender: &Contender,
    x: &[bevy_math::DVec3],
    bench: &Bench,
    index: usize,
    patience_s: f64,
) -> Option<TradeRun> {
    let mut bout = Bout::new(contender, &specimen.mesh, &specimen.materials, specimen.drag_1_s).ok()?;
    // Fixed nodes may have to go somewhere: in the first tick.
    let holds = specimen.holds();
    let gravity = specimen.gravity.as_vec3();
    let ticks = (LONGEST_S / TICK_S).round() as u32;
    let (mut before, mut still) = (specimen.ask(|n| specimen.mesh.rest(n)), 0);
    for tick in 0..ticks {
        bout.tick(&holds, gravity, TICK_S);
        if !bout.is_finite() {
            break;
        }
        let now = specimen.ask(|n| bout.state.position(n).as_dvec3());
        still =
            if (now - before).abs() < STILL * (bench.reference - specimen.ask(|n| specimen.mesh.rest(n))).abs() { still + 1 } else { 0 };
        before = now;
        if still >= STILL_TICKS {
            break;
        }
        if tick == 1 && bout.ticks_s[1] * f64::from(ticks) > patience_s {
            return None;
        }
    }
    let cost = bout.cost();
    let finite = bout.is_finite();
    let answer = if finite { specimen.ask(|n| bout.state.position(n).as_dvec3()) } else { f64::NAN };
    // Of a stretch the part beyond one is what the load did.
    let base = if bench.case == Case::Uniaxial { 1.0 } else { 0.0 };
    let relative = |to: f64| (answer - base) / (to - base) - 1.0;
    let own = bench.way.as_ref().map(|_| way_of(specimen, contender));
    let way_error = bench.way.as_ref().zip(own.as_ref()).map(|(truth, own)| {
        let off = |own: &Vec<f64>| own.iter().zip(truth).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / bench.reference.abs();
        own.as_ref().map_or(f64::INFINITY, off)
    });
    let turn = own.flatten().and_then(|own| first_turn(&own, f64::from(TICK_S)));
    let swing_error = bench.swing_s.zip(turn).map(|(truth, own)| own / truth - 1.0);
    Some(TradeRun {
        bench: index,
        contender: *contender,
        cost,
        answer,
        error: relative(bench.reference),
        total_error: relative(bench.truth),
        shape_error: if finite { specimen.distance(|n| bout.state.position(n), x) } else { f64::NAN },
        way_error,
        swing_error,
    })
}

/// Time of the first extreme of samples at `dt`, by the parabola through it and its neighbours.
fn first_turn(samples: &[f64], dt: f64) -> Option<f64> {
    let at = (1..samples.len().checked_sub(1)?)
        .find(|i| samples[*i].abs() >= samples[i - 1].abs() && samples[*i].abs() > samples[i + 1].abs())?;
    let (a, b, c) = (samples[at - 1], samples[at], samples[at + 1]);
    Some(((at + 1) as f64 + (a - c) / (2.0 * (a - 2.0 * b + c))) * dt)
}

/// Nothing when it leaves the finite numbers.
fn way_of(specimen: &Specimen, contender: &Contender) -> Option<Vec<f64>> {
    let mut bout = Bout::new(contender, &specimen.mesh, &specimen.materials, 0.0).ok()?;
    let holds = specimen.holds();
    let mut samples = Vec::new();
    for _ in 0..(WATCHED_S / f64::from(TICK_S)).round() as u32 {
        bout.tick(&holds, specimen.gravity.as_vec3(), TICK_S);
        if !bout.is_finite() {
            return None;
        }
        samples.push(specimen.ask(|n| bout.state.position(n).as_dvec3()));
    }
    Some(samples)
}

/// Its answer tick by tick, and the time of its first turn. With steps of an eighth of a tick: of a swing of eight ticks that is right to about a thousandth. It has the
/// default's viscosity, for that is of the tissue, and no drag.
fn way_of_reference(specimen: &Specimen) -> Result<(Vec<f64>, Option<f64>), ReferenceError> {
    const STEPS: usize = 8;
    let (problem, _) = specimen.problem()?;
    let start = problem.rest.clone();
    let mut body = Dynamics::new(problem, start)?;
    (body.tolerance, body.viscosity_s) = (1e-6, f64::from(TissueSettings::default().viscosity_s));
    let h = f64::from(TICK_S) / STEPS as f64;
    let mut samples = Vec::new();
    for _ in 0..(WATCHED_S / h).round() as u32 {
        body.step(h, specimen.gravity, |_| None)?;
        samples.push(specimen.ask(|n| body.positions[n.index()]));
    }
    let turn = first_turn(&samples, h);
    Ok((samples.into_iter().skip(STEPS - 1).step_by(STEPS).collect(), turn))
}

impl Trade {
    /// The runs that no other of the same mesh beats in both cost and error.
    #[must_use]
    pub fn front(&self, bench: usize) -> Vec<&TradeRun> {
        let mut runs: Vec<&TradeRun> = self.runs.iter().filter(|r| r.bench == bench && r.error.is_finite()).collect();
        runs.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        let mut best = f64::INFINITY;
        runs.retain(|r| {
            let better = r.error.abs() < best;
            best = best.min(r.error.abs());
            better
        });
        runs
    }

    /// Largest error of a contender at rest over all meshes; infinite where it did not finish.
    #[must_use]
    pub fn worst(&self, contender: &Contender) -> f64 {
        let own: Vec<&TradeRun> = self.runs.iter().filter(|r| r.contender == *contender).collect();
        if own.len() < self.benches.len() {
            return f64::INFINITY;
        }
        own.iter().map(|r| if r.error.is_finite() { r.error.abs() } else { f64::INFINITY }).fold(0.0, f64::max)
    }

    /// Largest distance of a contender from the reference's way.
    #[must_use]
    pub fn worst_way(&self, contender: &Contender) -> f64 {
        self.runs.iter().filter(|r| r.contender == *contender).filter_map(|r| r.way_error).fold(0.0, f64::max)
    }

    /// Geometric mean of a contender's cost over all meshes, s a simulated second.
    #[must_use]
    pub fn mean_cost(&self, contender: &Contender) -> f64 {
        let costs: Vec<f64> = self.runs.iter().filter(|r| r.contender == *contender).map(|r| r.cost.ln()).collect();
        (costs.iter().sum::<f64>() / costs.len().max(1) as f64).exp()
    }

    /// All who were compared, in order.
    #[must_use]
    pub fn contenders(&self) -> Vec<Contender> {
        let mut all: Vec<Contender> = Vec::new();
        for run in &self.runs {
            if !all.contains(&run.contender) {
                all.push(run.contender);
            }
        }
        all
    }

    /// The cheapest contender that is within `error` at rest everywhere, and on its way within `way`.
    #[must_use]
    pub fn cheapest(&self, error: f64, way: f64) -> Option<Contender> {
        let fit = |c: &Contender| self.worst(c) <= error && self.worst_way(c) <= way;
        self.contenders().into_iter().filter(fit).min_by(|a, b| self.mean_cost(a).total_cmp(&self.mean_cost(b)))
    }
}
