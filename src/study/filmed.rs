//! What the reference and the models say to the filmed beam ([`crate::study::film`]).
//!
//! The load hangs at the lower edge of the end as a weight that is moved along, so the periods under load are compared as well. Young's modulus was fitted to
//! the films by their publishers, so the sag under the beam's own weight says little; what the loads add, the periods and the damping are independent. Damping is
//! Rayleigh's: its two constants are those with which a swing under gravity alone and one under the larger load die away as filmed; under the smaller load it is foretold.
//!
//! At a Poisson's ratio of 0.499 linear tetrahedra lock. So the reference is computed with them and with ten-node elements, each on meshes of which one is twice as fine as the other.

use crate::study::contender::{Bout, Contender, TICK_S};
use crate::study::film::{FilmError, LOADS, Shown, read_all, ringing};
use bevy_math::{DVec3, Vec3};
use keyhole_tetmesh::{NodeId, TetMesh};
use keyhole_tissue::TissueModel;
use keyhole_tissue::beam::{block, clamp};
use keyhole_tissue::reference::{Problem, ReferenceError, Statics, equilibrium, slowest_mode};
use keyhole_whiteboard::{OrganMaterial, OrganMaterials};
use std::f64::consts::TAU;
use std::path::Path;

/// Local gravity, m/s2.
const GRAVITY: f64 = 9.80709;
/// Length and side, m.
const BEAM: [f64; 2] = [0.1, 0.03];
/// Elements over the height of the models' mesh.
const PLAYED: u32 = 6;

/// Whose answer it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Who {
    /// The reference with linear elements.
    Linear,
    /// The reference with ten-node elements.
    Quadratic,
    /// A model with linear elements.
    Model(Contender),
}

impl Who {
    /// Its name.
    #[must_use]
    pub fn name(&self) -> String {
        match self {
            Self::Linear => "reference, linear".into(),
            Self::Quadratic => "reference, ten nodes".into(),
            Self::Model(c) => c.full_name(),
        }
    }
}

/// An answer to one load.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FilmedRow {
    /// Who.
    pub who: Who,
    /// Number of tetrahedra.
    pub tets: usize,
    /// The load beside gravity, N.
    pub load_n: f64,
    /// Displacement of the end, mm.
    pub sag_mm: f64,
    /// Period of the first mode, s, and its damping ratio.
    pub swing: Option<(f64, f64)>,
}

/// Films and answers.
#[derive(Clone, Debug)]
pub struct Filmed {
    /// By load.
    pub films: Vec<Shown>,
    /// The answers.
    pub rows: Vec<FilmedRow>,
    /// Rayleigh's constants: drag, 1/s, and viscosity, s.
    pub rayleigh: (f64, f64),
}

impl Filmed {
    /// The films of a row's load.
    #[must_use]
    pub fn film(&self, row: &FilmedRow) -> Option<&Shown> {
        self.films.iter().find(|f| f.load_n == row.load_n)
    }

    /// Displacement against the mean of the takes, less one.
    #[must_use]
    pub fn error(&self, row: &FilmedRow) -> Option<f64> {
        Some(row.sag_mm / self.film(row)?.mean(|t| t.sag_mm) - 1.0)
    }

    /// What the load adds to the displacement under gravity against what it adds in the films, less one.
    #[must_use]
    pub fn response_error(&self, row: &FilmedRow) -> Option<f64> {
        let bare = self.rows.iter().find(|r| r.who == row.who && r.tets == row.tets && r.load_n == 0.0)?;
        let filmed = self.film(row)?.mean(|t| t.sag_mm) - self.film(bare)?.mean(|t| t.sag_mm);
        (row.load_n > 0.0).then(|| (row.sag_mm - bare.sag_mm) / filmed - 1.0)
    }

    /// Period against the mean of the takes, less one.
    #[must_use]
    pub fn period_error(&self, row: &FilmedRow) -> Option<f64> {
        Some(row.swing?.0 / self.film(row)?.mean(|t| t.period_s) - 1.0)
    }

    /// The rows of the finest mesh of somebody.
    #[must_use]
    pub fn finest(&self, who: Who) -> Vec<&FilmedRow> {
        let tets = self.rows.iter().filter(|r| r.who == who).map(|r| r.tets).max();
        self.rows.iter().filter(|r| r.who == who && Some(r.tets) == tets).collect()
    }
}

fn material() -> OrganMaterials {
    OrganMaterials(vec![OrganMaterial {
        name: "silicone".into(),
        young_modulus_pa: 263_824.0,
        poisson_ratio: 0.499,
        density_kg_m3: 1070.0,
        ..OrganMaterial::default()
    }])
}

struct Beam {
    mesh: TetMesh,
    end: Vec<NodeId>,
    edge: Vec<NodeId>,
}

impl Beam {
    fn new(m: u32) -> Self {
        let [length, side] = BEAM;
        let mesh = block([10 * m / 3, m, m], [length, side, side]);
        let end: Vec<NodeId> = mesh.nodes().filter(|n| mesh.rest(*n).x > length - 1e-9).collect();
        let edge = end.iter().copied().filter(|n| mesh.rest(*n).y == 0.0).collect();
        Self { mesh, end, edge }
    }

    fn sag_mm(&self, x: impl Fn(NodeId) -> DVec3) -> f64 {
        self.end.iter().map(|n| x(*n).distance(self.mesh.rest(*n))).sum::<f64>() / self.end.len() as f64 * 1e3
    }

    /// The weight that hangs on each node of the edge, kg: ends of the edge bear half.
    fn hung(&self, load_n: f64) -> Vec<(NodeId, f64)> {
        let share = |n: &NodeId| if [0.0, BEAM[1]].contains(&self.mesh.rest(*n).z) { 0.5 } else { 1.0 };
        let all: f64 = self.edge.iter().map(share).sum();
        self.edge.iter().map(|n| (*n, load_n / GRAVITY * share(n) / all)).collect()
    }

    fn problem(&self, who: Who, load_n: f64) -> Result<Problem, ReferenceError> {
        let is_fixed = |n| self.mesh.rest(n).x == 0.0;
        let mut problem = match who {
            Who::Quadratic => Problem::quadratic(&self.mesh, &material(), is_fixed)?,
            _ => Problem::new(&self.mesh, &material(), is_fixed)?,
        };
        for (n, mass) in self.hung(load_n) {
            problem.masses[n.index()] += mass;
        }
        Ok(problem)
    }
}

/// Films and what the reference and one of each model say to them.
///
/// # Errors
/// When a film cannot be read, or the reference has no answer.
pub fn conduct(folder: &Path, mut done: impl FnMut(&str)) -> Result<Filmed, FilmError> {
    let films = read_all(folder)?;
    let rayleigh = rayleigh(&films);
    let mut rows = Vec::new();
    for (who, sizes) in [(Who::Linear, &[3, 6, 12][..]), (Who::Quadratic, &[3, 6])] {
        for m in sizes {
            let beam = Beam::new(*m);
            // Each load begins where the one before has left the beam.
            let mut start = None;
            for (load, _) in LOADS {
                done(&format!("filmed beam, {}, {} tets, {load} N", who.name(), beam.mesh.tet_count()));
                let problem = beam.problem(who, load)?;
                let settings = Statics { load_steps: if start.is_none() { 3 } else { 1 }, ..Statics::default() };
                let x =
                    equilibrium(&problem, start.as_deref().unwrap_or(&problem.rest), &problem.weights(DVec3::NEG_Y * GRAVITY), settings)?;
                let sag_mm = beam.sag_mm(|n| x[n.index()]);
                let shape: Vec<DVec3> = problem.rest.iter().map(|p| DVec3::Y * p.x * p.x).collect();
                let omega = slowest_mode(&problem, &x, &shape)?;
                let swing = Some((TAU / omega, rayleigh.0 / (2.0 * omega) + rayleigh.1 * omega / 2.0));
                start = Some(x);
                rows.push(FilmedRow { who, tets: beam.mesh.tet_count(), load_n: load, sag_mm, swing });
            }
        }
    }
    let beam = Beam::new(PLAYED);
    for contender in Contender::one_of_each() {
        for (load_n, _) in LOADS {
            done(&format!("filmed beam, {}, {load_n} N", contender.name()));
            if let Some((sag_mm, swing)) = play(&beam, contender, load_n, rayleigh, &films) {
                rows.push(FilmedRow { who: Who::Model(contender), tets: beam.mesh.tet_count(), load_n, sag_mm, swing });
            }
        }
    }
    Ok(Filmed { films, rows, rayleigh })
}

/// Drag (1/s) and viscosity (s) with which the first and the last film's damping comes out: `ratio = drag / 2 w + viscosity w / 2`.
fn rayleigh(films: &[Shown]) -> (f64, f64) {
    let ([first, ..], [.., last]) = (films, films) else { return (0.0, 0.0) };
    let at = |f: &Shown| (TAU / f.mean(|t| t.period_s), f.mean(|t| t.damping));
    let ((w, a), (v, b)) = (at(first), at(last));
    let viscosity = 2.0 * (a * w - b * v) / (w * w - v * v);
    (2.0 * a * w - viscosity * w * w, viscosity)
}

/// Seconds of motion in which a swing under this load shows two periods and a half.
fn watched_s(load_n: f64) -> f64 {
    if load_n > 0.0 { 1.0 } else { 0.45 }
}

/// Where a model comes to rest, and how it swings; `None` when it leaves the finite numbers. Models that know drag alone get the drag that damps the film of the
/// same load.
fn play(
    beam: &Beam,
    contender: Contender,
    load_n: f64,
    (drag, viscosity): (f64, f64),
    films: &[Shown],
) -> Option<(f64, Option<(f64, f64)>)> {
    let holds = clamp(&beam.mesh);
    let run = |drag: f64, viscosity: f64, seconds: f64| {
        let mut damped = contender;
        damped.settings.viscosity_s = viscosity as f32;
        let mut bout = Bout::new(&damped, &beam.mesh, &material(), drag as f32).ok()?;
        for (n, mass) in beam.hung(load_n) {
            bout.body.hang(n, mass as f32);
        }
        let mut samples = Vec::new();
        for _ in 0..(seconds / f64::from(TICK_S)) as u32 {
            bout.tick(&holds, Vec3::NEG_Y * GRAVITY as f32, TICK_S);
            if !bout.is_finite() {
                return None;
            }
            samples.push(beam.sag_mm(|n| bout.state.position(n).as_dvec3()));
        }
        Some(samples)
    };
    let rest = *run(15.0, viscosity, 2.0)?.last()?;
    let film = films.iter().find(|f| f.load_n == load_n)?;
    let alone = 2.0 * film.mean(|t| t.damping) * TAU / film.mean(|t| t.period_s);
    let drag = if contender.settings.model == TissueModel::Implicit { drag } else { alone };
    let mut samples = run(drag, viscosity, watched_s(load_n) + 0.2)?;
    samples.iter_mut().for_each(|s| *s -= rest);
    Some((rest, ringing(&samples, f64::from(TICK_S))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::film::Take;

    #[test]
    fn rayleighs_constants_give_back_the_damping_at_both_ends() {
        let film = |load_n, period_s, damping| Shown { load_n, takes: vec![Take { sag_mm: 1.0, period_s, damping }] };
        let films = [film(0.0, 0.13, 0.05), film(0.5, 0.23, 0.06), film(1.0, 0.3, 0.065)];
        let (drag, viscosity) = rayleigh(&films);
        for f in [&films[0], &films[2]] {
            let w = TAU / f.takes[0].period_s;
            let ratio = drag / (2.0 * w) + viscosity * w / 2.0;
            assert!((ratio - f.takes[0].damping).abs() < 1e-12);
        }
    }
}
