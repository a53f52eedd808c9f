//! `keyhole study stability`: what each soft-tissue model survives, how far from its rest shape it is left, and how long it takes to come back.
//!
//! *Survived* is: no number left the finite ones, with nothing that puts broken states back, and the kinetic and elastic energy at the end is not above what there was at
//! the beginning, what a tool did and what the weight gave by falling, by more than half. *Back* is apart from it: whether the body came to its rest shape, and when. A
//! run that would take longer than is borne is stopped: it has not survived, and says how far it came.
//!
//! The explicit model's largest step is predicted as `2 / omega_max`, of its own springs and of the continuum ([`crate::study::stable_step`]), and measured by halving.

use crate::study::carving::Carving;
use crate::study::contender::{Bout, Contender};
use crate::study::hardship::Hardship;
use crate::study::stable_step::{Elastic, Resonance};
use bevy_math::Vec3;
use keyhole_tetmesh::{TetId, TetMesh};
use keyhole_tissue::{Body, ModelState, TeschnerSettings, TissueModel, TissueSettings};
use keyhole_whiteboard::{OrganMaterials, TissueState};
use std::time::Instant;

/// Length of the beam, m: what distances are compared with.
const LENGTH: f64 = 0.06;
/// Within this part of the length a body has come back.
pub const BACK: f64 = 0.01;
/// Energy at the end by what it may be at most: springs store another energy than the one that is measured here.
const ALLOWANCE: f64 = 1.5;
/// Drag, 1/s.
const DRAG_1_S: f32 = 6.0;

/// How a run went.
#[derive(Clone, Debug)]
pub struct Ordeal {
    /// What was done.
    pub hardship: Hardship,
    /// To whom.
    pub contender: Contender,
    /// Whether it survived.
    pub survived: bool,
    /// Whether it came to its end in the time that is borne, or broke before.
    pub finished: bool,
    /// First simulated time with a number that is not finite, s.
    pub broke_s: Option<f32>,
    /// Largest kinetic and elastic energy at the end by what it may have; below 1 is bounded.
    pub energy: f64,
    /// Largest distance of a node from its place in the rest shape at the end, as a part of the length; `None` where it is not to come back.
    pub off: Option<f64>,
    /// When it was within [`BACK`] for good, s.
    pub back_s: Option<f32>,
    /// Simulated time, s, less than wanted where it would have taken too long.
    pub simulated_s: f32,
    /// Time of the run by the clock, s.
    pub wall_s: f64,
    /// The mesh and the positions at the end.
    pub end: (TetMesh, Vec<Vec3>),
}

/// The explicit limit of a mesh.
#[derive(Clone, Debug, PartialEq)]
pub struct StepLimit {
    /// Which mesh.
    pub name: String,
    /// `2 / omega_max` of the model's springs and volumes, s.
    pub predicted_s: f64,
    /// `2 / omega_max` of the continuum on the same mesh, s.
    pub continuum_s: f64,
    /// The largest step that did not add energy, s.
    pub measured_s: f64,
}

/// Runs one; longer than `patience_s` by the clock, times what the hardship is given more, it is stopped.
#[must_use]
pub fn endure(hardship: Hardship, contender: &Contender, patience_s: f64) -> Option<Ordeal> {
    let (mesh, materials) = hardship.body();
    let mut bout = Bout::new(contender, &mesh, &materials, DRAG_1_S).ok()?;
    hardship.disturb(&mesh, &mut bout.state);
    let dt = hardship.tick_s();
    let gravity = hardship.gravity();
    let start = bout.body.elastic_energy(&bout.state);
    let mut carving = (hardship == Hardship::Cuts).then(|| Carving::new(&mesh));
    let ticks = (hardship.seconds() / dt).round() as u32;
    let begin = Instant::now();
    let (mut broke_s, mut last_away, mut simulated_s, mut done_work) = (None, -1.0_f32, 0.0, 0.0_f64);
    let mut now = mesh.clone();
    for tick in 0..ticks {
        let t = (tick + 1) as f32 * dt;
        if let Some(carving) = &mut carving {
            carving.advance(&mut bout, contender, &materials, DRAG_1_S);
            now = carving.mesh().clone();
        }
        let holds = hardship.holds(&now, &bout.state, t);
        bout.tick(&holds, gravity, dt);
        simulated_s = t;
        let pieces_are_finite = carving.as_mut().is_none_or(|c| c.step_pieces(gravity, dt));
        if !(bout.is_finite() && pieces_are_finite) {
            broke_s = Some(t);
            break;
        }
        // What holds it by more than its clamp does work on it.
        if holds.len() > keyhole_tissue::beam::clamp(&now).len() {
            done_work = done_work.max(energy(&bout.body, &bout.state));
        }
        if off(&now, &bout.state) > BACK {
            last_away = t;
        }
        if begin.elapsed().as_secs_f64() > patience_s * hardship.patience() {
            break;
        }
    }
    let fallen = now.nodes().map(|n| {
        let way = bout.state.position(n).as_dvec3() - now.rest(n);
        f64::from(bout.body.masses()[n.index()]) * way.dot(gravity.as_dvec3())
    });
    let allowed = ALLOWANCE * (start.abs() + done_work + fallen.sum::<f64>().max(0.0));
    // A body at rest without anything done to it has nothing to compare with but its stiffness.
    let floor = f64::from(materials.0[0].young_modulus_pa) * now.total_volume() * 1e-6;
    let energy = if broke_s.is_some() { f64::INFINITY } else { energy(&bout.body, &bout.state) / allowed.max(floor) };
    let away = if broke_s.is_some() { f64::INFINITY } else { off(&now, &bout.state) };
    let finished = simulated_s > hardship.seconds() - 1.5 * dt;
    Some(Ordeal {
        hardship,
        contender: *contender,
        survived: broke_s.is_none() && energy <= 1.0 && finished,
        finished: finished || broke_s.is_some(),
        broke_s,
        energy,
        off: hardship.has_rest_shape().then_some(away),
        back_s: (hardship.has_rest_shape() && away <= BACK).then_some(last_away.max(0.0)),
        simulated_s,
        wall_s: begin.elapsed().as_secs_f64(),
        end: (now, bout.state.positions),
    })
}

fn energy(body: &Body, state: &TissueState) -> f64 {
    body.kinetic_energy(state) + body.elastic_energy(state)
}

/// Largest distance of a node from its place in the rest shape, as a part of the length.
fn off(mesh: &TetMesh, state: &TissueState) -> f64 {
    mesh.nodes().map(|n| state.position(n).as_dvec3().distance(mesh.rest(n))).fold(0.0, f64::max) / LENGTH
}

/// Predicted and measured largest step of the explicit model on some meshes.
#[must_use]
pub fn step_limits() -> Vec<StepLimit> {
    let mut limits = Vec::new();
    for (name, hardship) in [
        ("beam of 270 tets", Hardship::LongRest),
        ("nu 0.3", Hardship::Poisson(0.3)),
        ("nu 0.49", Hardship::Poisson(0.49)),
        ("E 1 MPa", Hardship::Young(1e6)),
        ("slivers of 10 degrees", Hardship::Sliver(10.0)),
        ("slivers of 1 degree", Hardship::Sliver(1.0)),
    ] {
        let (mesh, materials) = hardship.body();
        let Some(predicted_s) = explicit(&mesh, &materials, TeschnerSettings::default()).and_then(|(_, m)| m.step_limit_s()) else {
            continue;
        };
        let all: Vec<TetId> = mesh.iter().map(|(t, _)| t).collect();
        let continuum = Resonance::new(Elastic::from(&materials.0[0]), 1).stable_step_s(&mesh, &all);
        // No bisection of this bracket is the prediction itself.
        let (mut low, mut high) = (0.3 * predicted_s, 4.7 * predicted_s);
        for _ in 0..10 {
            let middle = (low * high).sqrt();
            if explodes(&mesh, &materials, middle) { high = middle } else { low = middle }
        }
        limits.push(StepLimit {
            name: name.into(),
            predicted_s: f64::from(predicted_s),
            continuum_s: continuum.unwrap_or(f64::NAN),
            measured_s: f64::from((low * high).sqrt()),
        });
    }
    limits
}

fn explicit(mesh: &TetMesh, materials: &OrganMaterials, settings: TeschnerSettings) -> Option<(Body, ModelState)> {
    let body = Body::new(mesh, materials).ok()?;
    let model = ModelState::new(TissueModel::Teschner(settings), None, &body, mesh, materials).ok()?;
    Some((body, model))
}

/// Whether small noise grows a thousandfold in two thousand steps of this length (s), undamped.
fn explodes(mesh: &TetMesh, materials: &OrganMaterials, step_s: f32) -> bool {
    let settings = TeschnerSettings { damping: 0.0, step_s: Some(step_s), ..Default::default() };
    let Some((mut body, mut model)) = explicit(mesh, materials, settings) else { return true };
    let mut state = TissueState::at_rest(mesh);
    let mut s = 1_u32;
    let mut random = || {
        s = s.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (s >> 8) as f32 / (1 << 24) as f32 - 0.5
    };
    // A thousandth of the smallest altitude, so that the motion is a small one.
    let size = mesh.iter().map(|(t, _)| keyhole_tetmesh::quality::min_altitude(mesh.points(t))).fold(f64::INFINITY, f64::min) as f32 * 1e-3;
    for x in &mut state.positions {
        *x += Vec3::new(random(), random(), random()) * size;
    }
    let settings = TissueSettings { drag_1_s: 0.0, ..Default::default() };
    let far = |state: &TissueState| mesh.nodes().map(|n| state.position(n).distance(mesh.rest(n).as_vec3())).fold(0.0, f32::max);
    let start = far(&state);
    for _ in 0..20 {
        model.step(&mut body, &mut state, &[], Vec3::ZERO, step_s * 100.0, &settings);
        let now = far(&state);
        // A free body may drift by what the noise gave it; what explodes is away in no time.
        if state.positions.iter().any(|x| !x.is_finite()) || now > 1e3 * start {
            return true;
        }
    }
    false
}

/// The whole study.
#[derive(Clone, Debug)]
pub struct Stability {
    /// All runs.
    pub ordeals: Vec<Ordeal>,
    /// The explicit limits.
    pub limits: Vec<StepLimit>,
}

/// Runs everything. `done` hears of each run.
#[must_use]
pub fn conduct(hardships: &[Hardship], contenders: &[Contender], patience_s: f64, mut done: impl FnMut(&str)) -> Stability {
    let mut ordeals = Vec::new();
    for hardship in hardships {
        for contender in contenders {
            done(&format!("{}, {}", hardship.name(), contender.name()));
            ordeals.extend(endure(*hardship, contender, patience_s));
        }
    }
    done("largest explicit steps");
    Stability { ordeals, limits: step_limits() }
}
