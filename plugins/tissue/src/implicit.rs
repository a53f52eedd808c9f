//! Two stages of an implicit Runge-Kutta method a substep, each by Newton's method and conjugate gradients.
//!
//! The method is the one of second order whose stages are all as implicit as each other and that damps what is too fast for the substep entirely (Alexander
//! 1977, doi 10.1137/0714068): with `h` the substep, `c = 1 - 1/sqrt 2`, `f` the elastic force, `M` the masses and `b` the time of viscosity,
//!
//! `V = v' + c h A`, `M A = f(x' + (c h + b) V) + M g`,
//!
//! first from `x' = x`, `v' = v`, then, with the `V1` and `A1` that this gave, from `x' = x + (1 - c) h V1`, `v' = v + (1 - c) h A1`. The substep ends at
//! `x' + c h V` with `V`. A stage is the minimum of `M |X - y|^2 / 2 c h (c h + b) + E(X)` with `y = x' + (c h + b) (v' + c h g)`, to which one
//! step of [`crate::newton`] goes nearly all the way. What follows:
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
use crate::newton::{Astray, Care, Newton, TANGLED};
use crate::rescue;
use crate::settings::TissueSettings;
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
    /// `V1` of the substep, m/s.
    first: Vec<Vec3A>,
    /// `V` of the stage, m/s.
    velocity: Vec<Vec3A>,
    /// Fixed nodes and where they were when the tick began, m.
    starts: Vec<(usize, Vec3)>,
    /// Substeps of the last tick that had to be done carefully.
    pub(crate) careful: u32,
    /// For how long it has needed care, s.
    astray_s: f32,
    /// Positions and velocities to go back to.
    kept: (Vec<Vec3>, Vec<Vec3>),
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
    /// `c h`, s.
    length: f32,
    /// `c h + b`, s.
    reach: f32,
    /// `(1 - c) h` when a stage went before, else zero, s.
    before: f32,
}

impl Stage {
    /// `x'` and `v'` of a node that was at `x` with `v`, where the stage before had `first`.
    fn base(&self, x: Vec3A, v: Vec3A, first: Vec3A) -> (Vec3A, Vec3A) {
        if self.before > 0.0 { (x + first * self.before, v + (first - v) * (self.before / self.length)) } else { (x, v) }
    }
}

impl Implicit {
    /// Bytes of all arrays.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.newton.bytes() + 16 * (self.first.capacity() + self.velocity.capacity())
    }
}

/// Steps a body over one tick of `dt` s under gravity (m/s2).
pub fn step(body: &mut Body, state: &mut TissueState, holds: &[Hold], gravity: Vec3, dt: f32, settings: &TissueSettings) {
    let mut solver = std::mem::take(&mut body.implicit);
    let nodes = state.positions.len();
    solver.newton.resize(nodes);
    solver.first.resize(nodes, Vec3A::ZERO);
    solver.velocity.resize(nodes, Vec3A::ZERO);
    (solver.newton.iterations, solver.careful) = (0, 0);
    let n = settings.substeps.max(1);
    solver.starts.clear();
    solver.starts.extend(holds.iter().filter_map(|d| d.fixes().map(|i| (i, state.positions[i]))));
    if solver.astray_s > ASTRAY_S {
        rescue::step(body, state, holds, gravity, dt, settings.drag_1_s);
        (solver.careful, solver.astray_s) = (1, 0.0);
        body.implicit = solver;
        return;
    }
    // One job for the pool: every loop within is split among its threads.
    rayon::scope(|_| {
        for substep in 0..n {
            let step = Step { h: dt / n as f32, gravity, end: (substep + 1) as f32 / n as f32, share: 1.0 / n as f32 };
            match solver.substep(body, state, holds, step, settings) {
                Ok(()) => {}
                // Where it would go may be tangled where it is not: then it goes carefully.
                Err(Astray::Tangled) if substep == 0 && rescue::is_tangled(body, state, TANGLED) => {
                    solver.careful += 1;
                    rescue::step(body, state, holds, gravity, dt, settings.drag_1_s);
                    break;
                }
                Err(_) => {
                    solver.careful += 1;
                    solver.careful_substep(body, state, holds, step, settings);
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
        body: &Body,
        state: &mut TissueState,
        holds: &[Hold],
        step: Step,
        settings: &TissueSettings,
    ) -> Result<(), Astray> {
        let length = STAGE * step.h;
        self.newton.rounds = 0;
        let first = Stage { length, reach: length + settings.viscosity_s, before: 0.0 };
        self.stage(body, state, holds, step, first, settings, Care::Usual)?;
        std::mem::swap(&mut self.first, &mut self.velocity);
        let second = Stage { before: step.h - length, ..first };
        self.stage(body, state, holds, step, second, settings, Care::Usual)?;
        // What took one step of Newton's method each is as it should be.
        let doubtful = self.newton.rounds > 1 && holds.iter().all(|hold| hold.from == hold.to);
        if doubtful {
            self.kept.0.clone_from(&state.positions);
            self.kept.1.clone_from(&state.velocities);
        }
        self.finish(body, state, holds, step, second, settings);
        if doubtful && self.has_gained(body, state, step) {
            state.positions.clone_from(&self.kept.0);
            state.velocities.clone_from(&self.kept.1);
            return Err(Astray::Wild);
        }
        Ok(())
    }

    /// Whether the body has more energy than it had, and than its weight has given it by falling: nothing that stands still gives it any.
    fn has_gained(&self, body: &Body, state: &TissueState, step: Step) -> bool {
        let (positions, velocities) = &self.kept;
        let before = TissueState { positions: positions.clone(), velocities: velocities.clone() };
        let energy = |state: &TissueState| body.kinetic_energy(state) + body.elastic_energy(state);
        let fallen = |(m, (x, b)): (&f32, (&Vec3, &Vec3))| f64::from(*m) * f64::from((*x - *b).dot(step.gravity));
        let work: f64 = body.masses.iter().zip(state.positions.iter().zip(positions)).filter(|(m, _)| **m > 0.0).map(fallen).sum();
        let had = energy(&before);
        energy(state) > had + work + GAIN * (had + work.abs())
    }

    /// Backward Euler, downhill.
    fn careful_substep(&mut self, body: &Body, state: &mut TissueState, holds: &[Hold], step: Step, settings: &TissueSettings) {
        let whole = Stage { length: step.h, reach: step.h, before: 0.0 };
        // Going downhill finds no fault.
        let _ = self.stage(body, state, holds, step, whole, settings, Care::Downhill);
        self.finish(body, state, holds, step, whole, settings);
    }

    /// Finds the velocities of a stage.
    fn stage(
        &mut self,
        body: &Body,
        state: &TissueState,
        holds: &[Hold],
        step: Step,
        stage: Stage,
        settings: &TissueSettings,
        care: Care,
    ) -> Result<(), Astray> {
        let inertia = 1.0 / (stage.length * stage.reach);
        let fall = Vec3A::from(step.gravity) * stage.length;
        let newton = &mut self.newton;
        for i in 0..newton.x.len() {
            let (x, v) = (Vec3A::from(state.positions[i]), Vec3A::from(state.velocities[i]));
            let (from, with) = stage.base(x, v, self.first[i]);
            newton.free[i] = body.masses[i] > 0.0;
            newton.added[i] = body.masses[i] * inertia;
            newton.target[i] = from + (with + fall) * stage.reach;
            newton.x[i] = match care {
                Care::Usual if stage.before > 0.0 => from + self.first[i] * stage.reach,
                Care::Usual => from + v * stage.reach,
                Care::Downhill => from,
            };
        }
        for (i, velocity) in driven(holds, &self.starts, state, step) {
            newton.free[i] = false;
            newton.x[i] = Vec3A::from(state.positions[i] + velocity * (stage.before + stage.reach));
        }
        attach(newton, holds, step, stage);

        let mass: f64 = body.masses.iter().map(|m| f64::from(*m)).sum();
        let least = mass * f64::from(inertia) * (FINE * body.size(mass)).powi(2);
        newton.solve(body, inertia, care, Stop { tolerance: settings.tolerance, least, iterations: settings.iterations })?;

        for (i, velocity) in self.velocity.iter_mut().enumerate() {
            let (from, _) = stage.base(state.positions[i].into(), state.velocities[i].into(), self.first[i]);
            *velocity = (self.newton.x[i] - from) / stage.reach;
        }
        if holds.is_empty() {
            // A body that nothing holds falls freely: what rounding makes of its momentum is taken off.
            let start = |i: usize| Vec3::from(stage.base(state.positions[i].into(), state.velocities[i].into(), self.first[i]).1);
            let expected = mean(body, (0..self.velocity.len()).map(start)) + step.gravity * stage.length;
            let off = Vec3A::from(expected - mean(body, self.velocity.iter().map(|v| Vec3::from(*v))));
            for v in &mut self.velocity {
                *v += off;
            }
        }
        Ok(())
    }

    /// Ends a substep with the velocities of its last stage.
    fn finish(&mut self, body: &Body, state: &mut TissueState, holds: &[Hold], step: Step, last: Stage, settings: &TissueSettings) {
        let decay = (-settings.drag_1_s * step.h).exp();
        // Drag takes nothing of the mean velocity of a body that nothing holds.
        let drift = if holds.is_empty() { mean(body, self.velocity.iter().map(|v| Vec3::from(*v))) } else { Vec3::ZERO };
        for (i, velocity) in driven(holds, &self.starts, state, step) {
            self.velocity[i] = Vec3A::from(velocity);
        }
        for (i, (x, v)) in state.positions.iter_mut().zip(&mut state.velocities).enumerate().filter(|(i, _)| self.newton.free[*i]) {
            let (from, _) = last.base((*x).into(), (*v).into(), self.first[i]);
            *x = Vec3::from(from + self.velocity[i] * last.length);
            *v = drift + (Vec3::from(self.velocity[i]) - drift) * decay;
        }
        for (hold, (i, start)) in holds.iter().filter(|d| d.fixes().is_some()).zip(&self.starts) {
            state.velocities[*i] = self.velocity[*i].into();
            state.positions[*i] = start.lerp(hold.to, step.end);
        }
    }
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
fn attach(newton: &mut Newton, holds: &[Hold], step: Step, stage: Stage) {
    newton.springs.clear();
    for hold in holds.iter().filter(|d| d.fixes().is_none()) {
        let point: TissuePoint = hold.point.clone();
        let around: f32 = point.iter().map(|(n, w)| w.abs() * (newton.rows.stiffness(n.index()) + newton.added[n.index()])).sum();
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

/// Velocity of the centre of mass where the nodes have these velocities, m/s.
fn mean(body: &Body, velocities: impl Iterator<Item = Vec3>) -> Vec3 {
    let (mut momentum, mut mass) = (DVec3::ZERO, 0.0);
    for (m, v) in body.masses.iter().zip(velocities).filter(|(m, _)| **m > 0.0) {
        momentum += v.as_dvec3() * f64::from(*m);
        mass += f64::from(*m);
    }
    if mass > 0.0 { (momentum / mass).as_vec3() } else { Vec3::ZERO }
}
