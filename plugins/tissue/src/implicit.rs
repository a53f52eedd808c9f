//! Implicit steps of second order, each stage of them by Newton's method and conjugate gradients.
//!
//! Two methods of second order, both as implicit as can be in every stage, so that what is too fast for the substep is damped entirely. With `h` the substep,
//! `f` the elastic force, `M` the masses, `b` the time of viscosity, `d` the rate of drag, a stage of length `l` finds `V` and `A` such that
//!
//! `V = v' + l A`, `M A = f(x' + (l + b) V) + M g - d M V`.
//!
//! - [`TimeStepping::TwoStages`] (Alexander 1977, doi 10.1137/0714068): `l = c h`, `c = 1 - 1/sqrt 2`, first from `x' = x`, `v' = v`, then, with the `V1` and
//!   `A1` that this gave, from `x' = x + (1 - c) h V1`, `v' = v + (1 - c) h A1`.
//! - [`TimeStepping::TwoSteps`], the backward differentiation formula (Curtiss, Hirschfelder 1952, doi 10.1073/pnas.38.3.235): `l = 2 h / 3`, once, from
//!   `x' = x + (x - x0) / 3`, `v' = v + (v - v0) / 3` where `x0`, `v0` was the state a substep before. Half the work; its error is larger, and a substep whose
//!   past is not known, as after a cut, is one of two stages.
//!
//! The substep ends at `x' + l V` with `V`. A stage is the minimum of `(1 + l d) M |X - y|^2 / 2 l (l + b) + E(X)` with
//! `y = x' + (l + b) (v' + l g) / (1 + l d)`, to which one step of [`crate::newton`] goes nearly all the way. What follows:
//!
//! - Where nothing moves `f + M g = 0`: the equilibrium is that of the mesh, whatever the substep, the tolerance and the iterations.
//! - Motion is right to the second order of `h`; linear momentum is kept and free fall is exact.
//! - Force at `x + b v` is viscosity: a mode of angular frequency `w` has damping ratio `b w / 2`.
//!
//! Where the energy is not convex along the way, or the residual does not fall, the substep is done again as one of backward Euler with a convex bound of
//! the tangent and as many steps of Newton's method as the energy wants: it goes down, whatever the state. A tick that begins with a tangle is left to
//! [`crate::rescue`].

use crate::body::Body;
use crate::gradients::{Spring, Stop};
use crate::hold::Hold;
use crate::membrane::Membrane;
use crate::newton::{Astray, Care, Newton, TANGLED, Tangent, Tissue};
use crate::rescue;
use crate::settings::{TimeStepping, TissueSettings};
use bevy_math::{DVec3, Vec3, Vec3A};
use keyhole_whiteboard::{TissuePoint, TissueState};
use std::f32::consts::FRAC_1_SQRT_2;

/// `c`: each stage is a step of backward Euler of this share of the substep.
const STAGE: f32 = 1.0 - FRAC_1_SQRT_2;

/// A point of several nodes held without compliance is held by a spring this many times as stiff as the tissue at the point.
const STIFF: f32 = 100.0;

/// Root mean square of the displacement, as a share of the body's size, that conjugate gradients do not care about.
const FINE: f64 = 3e-7;

/// Part of its energy that a body may gain in a substep of several steps of Newton's method, by the error of the method.
const GAIN: f64 = 0.05;

/// A body that has needed care for so long, s, is not coming out of it by itself: it is rescued as one that is tangled. Ticks without care count half against it.
const ASTRAY_S: f32 = 0.5;

/// Everything the implicit solver keeps between ticks.
#[derive(Clone, Debug, Default)]
pub struct Implicit {
    pub(crate) newton: Newton,
    /// `x'` and `v'` of the stage, m and m/s.
    from: Vec<Vec3A>,
    with: Vec<Vec3A>,
    /// `V` of the stage, m/s.
    velocity: Vec<Vec3A>,
    past: Past,
    /// Fixed nodes and where they were when the tick began, m.
    starts: Vec<(usize, Vec3)>,
    /// Substeps of the last tick that had to be done carefully.
    pub(crate) careful: u32,
    /// For how long it has needed care, s.
    astray_s: f32,
    /// What to go back to.
    kept: TissueState,
}

/// The state a substep ago and the one that it led to, by which it is known whether that still is the state.
#[derive(Clone, Debug, Default)]
struct Past {
    /// Length of that substep, s; zero when nothing is known.
    h: f32,
    before: TissueState,
    after: TissueState,
}

impl Past {
    /// Whether this is the state a substep of this length led to.
    fn leads_to(&self, state: &TissueState, h: f32) -> bool {
        self.h == h && self.after.positions == state.positions && self.after.velocities == state.velocities
    }

    fn bytes(&self) -> usize {
        let of = |s: &TissueState| (s.positions.capacity() + s.velocities.capacity()) * size_of::<Vec3>();
        of(&self.before) + of(&self.after)
    }
}

/// The numbers of a substep.
#[derive(Clone, Copy, Debug)]
struct Step {
    h: f32,
    gravity: Vec3,
    /// End of the substep as a share of the tick.
    end: f32,
    /// The substep as a share of the tick.
    share: f32,
}

/// The numbers of a stage.
#[derive(Clone, Copy, Debug)]
struct Stage {
    /// `l`, s.
    length: f32,
    /// `l + b`, s.
    reach: f32,
    /// From the beginning of the substep to where the stage begins, s.
    before: f32,
    /// `l d`.
    drag: f32,
}

impl Stage {
    fn new(length: f32, before: f32, settings: &TissueSettings) -> Self {
        Self { length, reach: length + settings.viscosity_s, before, drag: length * settings.drag_1_s }
    }
}

impl Implicit {
    /// Bytes of all arrays.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.newton.bytes() + 16 * (self.from.capacity() + self.with.capacity() + self.velocity.capacity()) + self.past.bytes()
    }
}

/// Steps a body over one tick of `dt` s under gravity (m/s2).
pub fn step(
    body: &mut Body,
    membrane: Option<&Membrane>,
    state: &mut TissueState,
    holds: &[Hold],
    gravity: Vec3,
    dt: f32,
    settings: &TissueSettings,
) {
    let mut solver = std::mem::take(&mut body.implicit);
    let nodes = state.positions.len();
    solver.newton.resize(nodes);
    for v in [&mut solver.from, &mut solver.with, &mut solver.velocity] {
        v.resize(nodes, Vec3A::ZERO);
    }
    (solver.newton.iterations, solver.careful) = (0, 0);
    let n = settings.substeps.max(1);
    solver.starts.clear();
    solver.starts.extend(holds.iter().filter_map(|d| d.fixes().map(|i| (i, state.positions[i]))));
    if solver.astray_s > ASTRAY_S {
        rescue::step(body, state, holds, gravity, dt, settings.drag_1_s);
        (solver.careful, solver.astray_s, solver.past.h) = (1, 0.0, 0.0);
        body.implicit = solver;
        return;
    }
    // One job for the pool: every loop within is split among its threads.
    rayon::scope(|_| {
        for substep in 0..n {
            let step = Step { h: dt / n as f32, gravity, end: (substep + 1) as f32 / n as f32, share: 1.0 / n as f32 };
            let tissue = Tissue { body, membrane };
            match solver.substep(tissue, state, holds, step, settings) {
                Ok(()) => {}
                // Where it would go may be tangled where it is not: then it goes carefully.
                Err(Astray::Tangled) if substep == 0 && rescue::is_tangled(body, state, TANGLED) => {
                    solver.careful += 1;
                    solver.past.h = 0.0;
                    rescue::step(body, state, holds, gravity, dt, settings.drag_1_s);
                    break;
                }
                Err(_) => {
                    solver.careful += 1;
                    solver.past.h = 0.0;
                    solver.careful_substep(tissue, state, holds, step, settings);
                }
            }
        }
    });
    solver.astray_s = if solver.careful > 0 { solver.astray_s + dt } else { (solver.astray_s - dt / 2.0).max(0.0) };
    body.implicit = solver;
}

impl Implicit {
    fn substep(
        &mut self,
        tissue: Tissue<'_>,
        state: &mut TissueState,
        holds: &[Hold],
        step: Step,
        settings: &TissueSettings,
    ) -> Result<(), Astray> {
        if settings.stepping == TimeStepping::TwoSteps && self.past.leads_to(state, step.h) {
            let stage = Stage::new(step.h * (2.0 / 3.0), step.h / 3.0, settings);
            self.begin(state);
            for (i, (from, with)) in self.from.iter_mut().zip(&mut self.with).enumerate() {
                *from += (*from - Vec3A::from(self.past.before.positions[i])) / 3.0;
                *with += (*with - Vec3A::from(self.past.before.velocities[i])) / 3.0;
            }
            self.stage(tissue, state, holds, step, stage, settings, Care::Usual, Tangent::Own)?;
            let doubtful = self.newton.rounds > 1;
            return self.finish_unless_gained(tissue, state, holds, step, stage, settings, doubtful);
        }
        let length = STAGE * step.h;
        let first = Stage::new(length, 0.0, settings);
        self.begin(state);
        self.stage(tissue, state, holds, step, first, settings, Care::Usual, Tangent::Own)?;
        // Where one step was enough the tangent hardly changes.
        let hard = self.newton.rounds > 1;
        let kept = if hard { Tangent::Own } else { Tangent::Kept };
        let second = Stage { before: step.h - length, ..first };
        for ((from, with), first) in self.from.iter_mut().zip(&mut self.with).zip(&self.velocity) {
            *from += *first * second.before;
            *with += (*first - *with) * (second.before / length);
        }
        self.stage(tissue, state, holds, step, second, settings, Care::Usual, kept)?;
        let doubtful = hard || self.newton.rounds > 1;
        self.finish_unless_gained(tissue, state, holds, step, second, settings, doubtful)
    }

    /// Ends a substep; one that is in doubt is taken back when it gave the body energy. What took one step of Newton's method a stage is not in doubt.
    fn finish_unless_gained(
        &mut self,
        tissue: Tissue<'_>,
        state: &mut TissueState,
        holds: &[Hold],
        step: Step,
        last: Stage,
        settings: &TissueSettings,
        doubtful: bool,
    ) -> Result<(), Astray> {
        // What is moved is given energy.
        let doubtful = doubtful && holds.iter().all(|hold| hold.from == hold.to);
        if doubtful {
            copy(&mut self.kept, state);
        }
        self.finish(state, holds, step, last, settings);
        if doubtful && has_gained(tissue, &self.newton.springs, &self.kept, state, step) {
            copy(state, &self.kept);
            return Err(Astray::Wild);
        }
        Ok(())
    }

    /// Backward Euler, downhill.
    fn careful_substep(&mut self, tissue: Tissue<'_>, state: &mut TissueState, holds: &[Hold], step: Step, settings: &TissueSettings) {
        let whole = Stage { reach: step.h, ..Stage::new(step.h, 0.0, settings) };
        self.begin(state);
        // From where it is: going downhill needs a state that is no worse.
        self.velocity.fill(Vec3A::ZERO);
        // Going downhill finds no fault.
        let _ = self.stage(tissue, state, holds, step, whole, settings, Care::Downhill, Tangent::Own);
        self.finish(state, holds, step, whole, settings);
        self.past.h = 0.0;
    }

    /// Sets a stage to begin where the substep does, and to be looked for where the velocities lead.
    fn begin(&mut self, state: &TissueState) {
        for (i, (x, v)) in state.positions.iter().zip(&state.velocities).enumerate() {
            self.from[i] = (*x).into();
            (self.with[i], self.velocity[i]) = ((*v).into(), (*v).into());
        }
    }

    /// Finds the velocities of a stage.
    fn stage(
        &mut self,
        tissue: Tissue<'_>,
        state: &TissueState,
        holds: &[Hold],
        step: Step,
        stage: Stage,
        settings: &TissueSettings,
        care: Care,
        tangent: Tangent,
    ) -> Result<(), Astray> {
        let inertia = (1.0 + stage.drag) / (stage.length * stage.reach);
        let fall = Vec3A::from(step.gravity) * stage.length;
        // Drag takes nothing of the mean velocity of a body that nothing holds.
        let drift = if holds.is_empty() { mean(tissue.body, &self.with) + fall } else { Vec3A::ZERO };
        let newton = &mut self.newton;
        for i in 0..newton.x.len() {
            let from = self.from[i];
            newton.free[i] = tissue.body.masses[i] > 0.0;
            newton.added[i] = tissue.body.masses[i] * inertia;
            newton.target[i] = from + (self.with[i] + fall + drift * stage.drag) * (stage.reach / (1.0 + stage.drag));
            newton.x[i] = from + self.velocity[i] * stage.reach;
        }
        for (i, velocity) in driven(holds, &self.starts, state, step) {
            newton.free[i] = false;
            newton.x[i] = Vec3A::from(state.positions[i] + velocity * (stage.before + stage.reach));
        }
        attach(newton, tissue.membrane, holds, step, stage);

        let mass: f64 = tissue.body.masses.iter().map(|m| f64::from(*m)).sum();
        let least = mass * f64::from(inertia) * (FINE * tissue.body.size(mass)).powi(2);
        newton.solve(tissue, inertia, care, tangent, Stop { tolerance: settings.tolerance, least, iterations: settings.iterations })?;

        for ((velocity, x), from) in self.velocity.iter_mut().zip(&newton.x).zip(&self.from) {
            *velocity = (*x - *from) / stage.reach;
        }
        if holds.is_empty() {
            // A body that nothing holds falls freely: what rounding makes of its momentum is taken off.
            let off = drift - mean(tissue.body, &self.velocity);
            for v in &mut self.velocity {
                *v += off;
            }
        }
        Ok(())
    }

    /// Ends a substep with the velocities of its last stage.
    fn finish(&mut self, state: &mut TissueState, holds: &[Hold], step: Step, last: Stage, settings: &TissueSettings) {
        for (i, velocity) in driven(holds, &self.starts, state, step) {
            self.velocity[i] = Vec3A::from(velocity);
        }
        let remember = settings.stepping == TimeStepping::TwoSteps;
        if remember {
            copy(&mut self.past.before, state);
        }
        for (i, (x, v)) in state.positions.iter_mut().zip(&mut state.velocities).enumerate().filter(|(i, _)| self.newton.free[*i]) {
            *x = Vec3::from(self.from[i] + self.velocity[i] * last.length);
            *v = self.velocity[i].into();
        }
        for (hold, (i, start)) in holds.iter().filter(|d| d.fixes().is_some()).zip(&self.starts) {
            state.velocities[*i] = self.velocity[*i].into();
            state.positions[*i] = start.lerp(hold.to, step.end);
        }
        if remember {
            copy(&mut self.past.after, state);
            self.past.h = step.h;
        }
    }
}

/// Whether a body has more energy than it had before, and than its weight and springs to points that stand still have given it: nothing else gives it any.
fn has_gained(tissue: Tissue<'_>, springs: &[Spring], before: &TissueState, state: &TissueState, step: Step) -> bool {
    let body = tissue.body;
    let energy = |state: &TissueState| {
        let at = |m: &Membrane| m.energy(&state.positions.iter().map(|x| x.as_dvec3()).collect::<Vec<_>>());
        body.kinetic_energy(state) + body.elastic_energy(state) + tissue.membrane.map_or(0.0, at)
    };
    let fallen = |(m, (x, b)): (&f32, (&Vec3, &Vec3))| f64::from(*m) * f64::from((*x - *b).dot(step.gravity));
    let moved = state.positions.iter().zip(&before.positions);
    let weight: f64 = body.masses.iter().zip(moved).filter(|(m, _)| **m > 0.0).map(fallen).sum();
    // The mean force times the way, not a difference of energies: a load may be a soft spring to a point far away.
    let pulled = |spring: &Spring| {
        let at =
            |state: &TissueState| spring.point.iter().map(|(n, w)| state.positions[n.index()].as_dvec3() * f64::from(*w)).sum::<DVec3>();
        let (from, to) = (at(before), at(state));
        f64::from(spring.stiffness) * (spring.anchor.as_dvec3() - (from + to) / 2.0).dot(to - from)
    };
    let work = weight + springs.iter().map(pulled).sum::<f64>();
    let had = energy(before);
    energy(state) > had + work + GAIN * (had + work.abs())
}

/// The nodes that holds fix, and the velocities that take them to where they belong at the end of a substep, m/s.
fn driven<'a>(
    holds: &'a [Hold],
    starts: &'a [(usize, Vec3)],
    state: &'a TissueState,
    step: Step,
) -> impl Iterator<Item = (usize, Vec3)> + 'a {
    let fixed = holds.iter().filter(|d| d.fixes().is_some());
    fixed.zip(starts).map(move |(hold, (i, start))| (*i, (start.lerp(hold.to, step.end) - state.positions[*i]) / step.h))
}

/// Turns holds with compliance or several nodes into springs.
fn attach(newton: &mut Newton, membrane: Option<&Membrane>, holds: &[Hold], step: Step, stage: Stage) {
    newton.springs.clear();
    for hold in holds.iter().filter(|d| d.fixes().is_none()) {
        let point: TissuePoint = hold.point.clone();
        let tissue = |n: usize| newton.rows.stiffness(n) + membrane.map_or(0.0, |m| m.stiffness(n));
        let around: f32 = point.iter().map(|(n, w)| w.abs() * (tissue(n.index()) + newton.added[n.index()])).sum();
        let compliance = hold.compliance_m_n.max(0.0);
        let stiffness = if compliance * STIFF * around > 1.0 { 1.0 / compliance } else { STIFF * around };
        for (n, w) in &point {
            newton.added[n.index()] += stiffness * w * w;
        }
        // Its anchor goes on to where the forces are taken, as the tissue does.
        let begin = hold.from.lerp(hold.to, step.end - step.share);
        let end = hold.from.lerp(hold.to, step.end);
        let anchor = Vec3A::from(begin + (end - begin) * ((stage.before + stage.reach) / step.h));
        newton.springs.push(Spring { point, stiffness, anchor });
    }
}

/// Takes a state over into arrays that are there: assigning a clone would allocate.
fn copy(to: &mut TissueState, from: &TissueState) {
    to.positions.clone_from(&from.positions);
    to.velocities.clone_from(&from.velocities);
}

/// Velocity of the centre of mass where the nodes have these velocities, m/s.
fn mean(body: &Body, velocities: &[Vec3A]) -> Vec3A {
    let (mut momentum, mut mass) = (DVec3::ZERO, 0.0);
    for (m, v) in body.masses.iter().zip(velocities).filter(|(m, _)| **m > 0.0) {
        momentum += v.as_dvec3() * f64::from(*m);
        mass += f64::from(*m);
    }
    if mass > 0.0 { (momentum / mass).as_vec3a() } else { Vec3A::ZERO }
}
