//! The filmed beam: silicone, 100 x 30 x 30 mm, clamped at one face and released from straight, followed by motion capture at 100 Hz (Dubied et al. 2022,
//! arXiv:2201.12560; converted to tables of seconds and metres).
//!
//! Young's modulus was fitted to it by its publishers, so the sag under its own weight says little; the response to the two loads, the period and the damping
//! are independent. The reference has drag fitted to the filmed damping, and none of its other constants.

use crate::study::StudyError;
use crate::study::contender::{Bout, Contender, TICK_S};
use crate::study::markup::{cell, table};
use bevy_math::{DVec3, Vec3};
use keyhole_tetmesh::{NodeId, TetMesh};
use keyhole_tissue::Hold;
use keyhole_tissue::beam::{block, fix};
use keyhole_tissue::reference::{Dynamics, Problem, ReferenceError, Statics, equilibrium};
use keyhole_whiteboard::{OrganMaterial, OrganMaterials};
use maud::{Markup, html};
use smallvec::smallvec;
use std::path::{Path, PathBuf};

/// The loads at the end edge beside gravity, N, and their files.
const LOADS: [(f64, [&str; 2]); 3] = [
    (0.0, ["gravity_a.csv", "gravity_b.csv"]),
    (0.510, ["load_0.510N_a.csv", "load_0.510N_b.csv"]),
    (1.001, ["load_1.001N_a.csv", "load_1.001N_b.csv"]),
];
/// Local gravity, m/s2.
const GRAVITY: f64 = 9.80709;
/// Length and side, m.
const BEAM: [f64; 2] = [0.1, 0.03];
/// Compliance of an attachment that is a force, m/N.
const COMPLIANCE: f32 = 1e3;

/// Why the films cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum FilmError {
    /// A file that is not there or is not a table.
    #[error("{}: {reason}; expected the columns time_s and m0_x_m to m5_z_m with a row for each 0.01 s", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// The reference.
    #[error("the filmed beam: {0}")]
    Reference(#[from] ReferenceError),
}

/// What one film shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Take {
    /// Mean over the three markers of the way from release to the mean of the last second, mm.
    pub sag_mm: f64,
    /// Period of the first mode, s.
    pub period_s: f64,
    /// Its damping ratio.
    pub damping: f64,
}

/// A model's answer to one load.
#[derive(Clone, Debug, PartialEq)]
pub struct FilmedRow {
    /// Who.
    pub who: String,
    /// Number of tetrahedra.
    pub tets: usize,
    /// The load beside gravity, N.
    pub load_n: f64,
    /// Displacement of the end, mm.
    pub sag_mm: f64,
    /// Against the mean of both takes, less one.
    pub error: f64,
    /// Period of the first mode, under gravity alone, s.
    pub period_s: Option<f64>,
}

/// Films and answers.
#[derive(Clone, Debug)]
pub struct Filmed {
    /// By load.
    pub takes: Vec<(f64, Vec<Take>)>,
    /// The answers.
    pub rows: Vec<FilmedRow>,
}

/// Reads a film.
///
/// # Errors
/// When it is not there, or is not a table of numbers.
pub fn read(path: &Path) -> Result<Take, FilmError> {
    let fails = |reason: String| FilmError::File { path: path.into(), reason };
    let mut reader = csv::Reader::from_path(path).map_err(|e| fails(e.to_string()))?;
    let mut rows: Vec<Vec<f64>> = Vec::new();
    for record in reader.records() {
        let record = record.map_err(|e| fails(e.to_string()))?;
        let row: Result<Vec<f64>, _> = record.iter().map(str::parse).collect();
        let row = row.map_err(|e| fails(format!("row {}: {e}", rows.len() + 2)))?;
        if row.len() != 19 || row.iter().any(|x| !x.is_finite()) {
            return Err(fails(format!("row {} has {} numbers, not 19", rows.len() + 2, row.len())));
        }
        rows.push(row);
    }
    if rows.len() < 200 {
        return Err(fails(format!("{} rows are less than two seconds", rows.len())));
    }
    let marker = |row: &[f64], m: usize| DVec3::new(row[1 + 3 * m], row[2 + 3 * m], row[3 + 3 * m]);
    let last = &rows[rows.len() - 100..];
    let rest = |m: usize| last.iter().map(|r| marker(r, m)).sum::<DVec3>() / last.len() as f64;
    let sag_mm = (0..3).map(|m| rest(m).distance(marker(&rows[0], m))).sum::<f64>() / 3.0 * 1e3;
    // The motion along the way to rest, of the first marker.
    let along = (rest(0) - marker(&rows[0], 0)).normalize_or_zero();
    let motion: Vec<f64> = rows.iter().map(|r| (marker(r, 0) - rest(0)).dot(along)).collect();
    let (period_s, damping) = ringing(&motion, 0.01).ok_or_else(|| fails("no free swing is seen in it".into()))?;
    Ok(Take { sag_mm, period_s, damping })
}

/// Period and damping ratio of a motion about zero, from its extremes after it first crossed zero: half periods between them, the logarithm of their decrease. Only those above a twentieth of
/// the first count: the rest is noise.
#[must_use]
pub fn ringing(motion: &[f64], dt: f64) -> Option<(f64, f64)> {
    // Before the first crossing of zero it may have been held for any time.
    let motion = &motion[motion.windows(2).position(|w| w[0] * w[1] < 0.0)?..];
    let floor = motion.iter().fold(0.0_f64, |a, x| a.max(x.abs())) / 20.0;
    let mut extremes: Vec<(f64, f64)> = Vec::new();
    for i in 1..motion.len().checked_sub(1)? {
        let (a, b, c) = (motion[i - 1], motion[i], motion[i + 1]);
        let is_peak = (b > a && b >= c && b > floor) || (b < a && b <= c && b < -floor);
        // One extreme between two crossings of zero: the largest.
        if is_peak {
            let shift = (a - c) / (2.0 * (a - 2.0 * b + c));
            let peak = ((i as f64 + shift) * dt, b);
            match extremes.last_mut() {
                Some(last) if last.1.signum() == b.signum() => {
                    if b.abs() > last.1.abs() {
                        *last = peak;
                    }
                }
                _ => extremes.push(peak),
            }
        }
    }
    let ([first, ..], [.., last]) = (extremes.as_slice(), extremes.as_slice()) else { return None };
    let halves = extremes.len() as f64 - 1.0;
    if halves < 2.0 {
        return None;
    }
    let period = 2.0 * (last.0 - first.0) / halves;
    let decrement = (first.1.abs() / last.1.abs()).ln() / halves;
    Some((period, decrement / (std::f64::consts::PI.powi(2) + decrement * decrement).sqrt()))
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

struct Model {
    mesh: TetMesh,
    end: Vec<NodeId>,
    edge: Vec<NodeId>,
}

impl Model {
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

    fn problem(&self) -> Result<Problem, ReferenceError> {
        Ok(Problem::new(&self.mesh, &material(), |n| self.mesh.rest(n).x == 0.0)?)
    }

    fn reference(&self, load_n: f64) -> Result<f64, ReferenceError> {
        let problem = self.problem()?;
        let mut loads = problem.weights(DVec3::NEG_Y * GRAVITY);
        for n in &self.edge {
            loads[n.index()] += DVec3::NEG_Y * (load_n / self.edge.len() as f64);
        }
        let x = equilibrium(&problem, &problem.rest, &loads, Statics { load_steps: 3, ..Statics::default() })?;
        Ok(self.sag_mm(|n| x[n.index()]))
    }

    fn holds(&self, load_n: f64) -> Vec<Hold> {
        let clamp = self.mesh.nodes().filter(|n| self.mesh.rest(*n).x == 0.0).map(|n| fix(n, self.mesh.rest(n).as_vec3()));
        let each = (load_n / self.edge.len() as f64) as f32;
        let pull = self.edge.iter().filter(|_| load_n > 0.0).map(|n| {
            let far = self.mesh.rest(*n).as_vec3() + Vec3::NEG_Y * (each * COMPLIANCE);
            Hold { point: smallvec![(*n, 1.0)], from: far, to: far, compliance_m_n: COMPLIANCE }
        });
        clamp.chain(pull).collect()
    }
}

/// Films and what the reference and one of each model say to them.
///
/// # Errors
/// When a film cannot be read, or the reference has no answer.
pub fn conduct(folder: &Path, mut done: impl FnMut(&str)) -> Result<Filmed, FilmError> {
    let mut takes = Vec::new();
    for (load, files) in LOADS {
        takes.push((load, files.iter().map(|f| read(&folder.join(f))).collect::<Result<Vec<_>, _>>()?));
    }
    let filmed = |load: f64| {
        let of = takes.iter().find(|(l, _)| *l == load).map_or(&[][..], |(_, t)| t.as_slice());
        of.iter().map(|t| t.sag_mm).sum::<f64>() / of.len() as f64
    };
    let damping = takes[0].1.iter().map(|t| t.damping).sum::<f64>() / takes[0].1.len() as f64;
    let filmed_period = takes[0].1.iter().map(|t| t.period_s).sum::<f64>() / takes[0].1.len() as f64;
    let drag = 2.0 * damping * std::f64::consts::TAU / filmed_period;
    let mut rows = Vec::new();
    for m in [3, 6, 12] {
        let model = Model::new(m);
        let tets = model.mesh.tet_count();
        for (load, _) in LOADS {
            done(&format!("filmed beam, reference, {tets} tets, {load} N"));
            let sag_mm = model.reference(load)?;
            let period_s = if load == 0.0 && m < 12 { period_of_reference(&model, drag)? } else { None };
            rows.push(FilmedRow { who: "reference".into(), tets, load_n: load, sag_mm, error: sag_mm / filmed(load) - 1.0, period_s });
        }
    }
    let model = Model::new(6);
    let tets = model.mesh.tet_count();
    for contender in Contender::one_of_each() {
        for (load, _) in LOADS {
            done(&format!("filmed beam, {}, {load} N", contender.name()));
            let who = format!("{} {}", contender.name(), contender.setting());
            let Some((sag_mm, period_s)) = play(&model, &contender, load, drag as f32) else { continue };
            rows.push(FilmedRow { who, tets, load_n: load, sag_mm, error: sag_mm / filmed(load) - 1.0, period_s });
        }
    }
    Ok(Filmed { takes, rows })
}

fn period_of_reference(model: &Model, drag: f64) -> Result<Option<f64>, ReferenceError> {
    let problem = model.problem()?;
    let start = problem.rest.clone();
    let mut body = Dynamics::new(problem, start)?;
    (body.drag_1_s, body.tolerance) = (drag, 1e-6);
    let h = 1.0 / 240.0;
    let mut samples = Vec::new();
    for _ in 0..160 {
        body.step(h, DVec3::NEG_Y * GRAVITY, |_| None)?;
        samples.push(model.sag_mm(|n| body.positions[n.index()]));
    }
    let rest = model.reference(0.0)?;
    samples.iter_mut().for_each(|s| *s -= rest);
    Ok(ringing(&samples, h).map(|(period, _)| period))
}

/// Where a model comes to rest, and its period under gravity alone; `None` when it leaves the finite numbers.
fn play(model: &Model, contender: &Contender, load: f64, drag: f32) -> Option<(f64, Option<f64>)> {
    let holds = model.holds(load);
    let gravity = Vec3::NEG_Y * GRAVITY as f32;
    let run = |drag: f32, seconds: f32| {
        let mut bout = Bout::new(contender, &model.mesh, &material(), drag).ok()?;
        let mut samples = Vec::new();
        for _ in 0..(seconds / TICK_S) as u32 {
            bout.tick(&holds, gravity, TICK_S);
            if !bout.is_finite() {
                return None;
            }
            samples.push(model.sag_mm(|n| bout.state.position(n).as_dvec3()));
        }
        Some(samples)
    };
    let rest = *run(15.0, 2.0)?.last()?;
    let period = if load == 0.0 {
        let mut samples = run(drag, 0.7)?;
        samples.iter_mut().for_each(|s| *s -= rest);
        ringing(&samples, f64::from(TICK_S)).map(|(period, _)| period)
    } else {
        None
    };
    Some((rest, period))
}

impl Filmed {
    /// Writes the table.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), StudyError> {
        let named = |source| StudyError::Table { path: path.into(), source };
        let mut writer = csv::Writer::from_path(path).map_err(named)?;
        writer.write_record(["who", "tets", "load_n", "displacement_mm", "error", "period_s", "damping_ratio"]).map_err(named)?;
        for (load, takes) in &self.takes {
            for (take, t) in takes.iter().enumerate() {
                let name = format!("film {}", ["a", "b"].get(take).copied().unwrap_or("?"));
                let number = |x: f64| format!("{x:.4}");
                writer
                    .write_record([
                        name,
                        String::new(),
                        load.to_string(),
                        number(t.sag_mm),
                        String::new(),
                        number(t.period_s),
                        number(t.damping),
                    ])
                    .map_err(named)?;
            }
        }
        for r in &self.rows {
            let period = r.period_s.map(|p| format!("{p:.4}")).unwrap_or_default();
            let record = [
                r.who.clone(),
                r.tets.to_string(),
                r.load_n.to_string(),
                format!("{:.4}", r.sag_mm),
                format!("{:.4}", r.error),
                period,
                String::new(),
            ];
            writer.write_record(record).map_err(named)?;
        }
        writer.flush().map_err(|e| named(e.into()))
    }

    /// For the page.
    #[must_use]
    pub fn markup(&self) -> Markup {
        let films: Vec<Vec<Markup>> = self
            .takes
            .iter()
            .map(|(load, takes)| {
                let each = |f: fn(&Take) -> String| takes.iter().map(f).collect::<Vec<_>>().join(" / ");
                vec![
                    cell(load),
                    cell(each(|t| format!("{:.2}", t.sag_mm))),
                    cell(each(|t| format!("{:.3}", t.period_s))),
                    cell(each(|t| format!("{:.3}", t.damping))),
                ]
            })
            .collect();
        let rows: Vec<Vec<Markup>> = self
            .rows
            .iter()
            .map(|r| {
                let period = r.period_s.map(|p| format!("{p:.3}")).unwrap_or_default();
                vec![
                    cell(&r.who),
                    cell(r.tets),
                    cell(r.load_n),
                    cell(format!("{:.2}", r.sag_mm)),
                    cell(format!("{:+.1} %", r.error * 100.0)),
                    cell(period),
                ]
            })
            .collect();
        html! {
            p {
                "Silicone, E 263 824 Pa as its publishers fitted it, nu 0.499, 1070 kg/m3. The markers stand about 6 mm off the surface and two takes differ by up to 5 %: no claim of accuracy "
                "below that can be made. At nu 0.499 linear tetrahedra lock: see how the reference's answer goes with the mesh."
            }
            (table(&["load beside gravity, N", "filmed displacement, mm", "period, s", "damping ratio"], &films))
            (table(&["who", "tets", "load, N", "displacement, mm", "against the film", "period, s"], &rows))
            p { "Drag is fitted to the filmed damping under gravity. The loads hung as weights that swing along, which these models do not have: their periods are not compared." }
        }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;

    #[test]
    fn ringing_of_a_damped_oscillation() {
        let (period, ratio) = (0.23, 0.06);
        let omega = std::f64::consts::TAU / period;
        let decay = ratio / (1.0_f64 - ratio * ratio).sqrt() * omega;
        let motion: Vec<f64> = (0..300).map(|i| f64::from(i) * 0.01).map(|t| (-decay * t).exp() * (omega * t).cos()).collect();
        let (p, d) = ringing(&motion, 0.01).unwrap();
        assert!((p / period - 1.0).abs() < 0.01 && (d / ratio - 1.0).abs() < 0.05, "{p} {d}");
        assert_eq!(ringing(&[0.0; 50], 0.01), None);
    }

    #[test]
    fn a_film_that_is_none_is_refused_with_its_row() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("film.csv");
        std::fs::write(&path, "time_s,m0_x_m\n0.0,x\n").unwrap();
        let message = read(&path).unwrap_err().to_string();
        assert!(message.contains("film.csv") && message.contains("row 2"), "{message}");
    }
}
