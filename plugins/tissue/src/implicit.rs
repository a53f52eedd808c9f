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
//! A stage in which a contact pushes (`touch.rs`) is not gone on with: the impulse of what hits would be counted again, and thrown back. The first stage is a step of
//! backward Euler from the beginning to `c h`, and the rest of the substep is another one; where contacts already pushed when the substep began both
//! are half of it, with one tangent. Where nothing pushes nothing is different.
//!
//! Where the energy is not convex along the way, or the residual does not fall, the substep is done again as one of backward Euler with a convex bound of
//! the tangent and as many steps of Newton's method as the energy wants: it goes down, whatever the state. A tick that begins with a tangle is left to
//! [`crate::rescue`].

use crate::body::Body;
use crate::gradients::{Spring, Stop};
use crate::hold::Hold;
use crate::island::Member;
use crate::membrane::Membrane;
use crate::newton::{Astray, Care, FRESH, Newton, Part, Tangent, Tissue, Weights, minimise};
use crate::rescue;
use crate::settings::{TimeStepping, TissueSettings};
use crate::touches::{Grips, Touches};
use bevy_math::{DMat3, DVec3, Vec3, Vec3A};
use keyhole_whiteboard::{TissuePoint, TissueState};
use smallvec::SmallVec;
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
    /// The contacts of the bodies that this one is the first of.
    touches: Touches,
    /// What friction came to in the last tick.
    pub(crate) grips: Grips,
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
    /// The tick, s.
    dt: f32,
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
    /// Begins anew after a tick in which the body was rescued.
    pub(crate) fn begin_anew(&mut self) {
        (self.careful, self.astray_s, self.past.h) = (1, 0.0, 0.0);
    }

    /// The state is not what the last substep led to.
    pub(crate) fn forget_past(&mut self) {
        self.past.h = 0.0;
    }

    /// Whether it has needed care for too long.
    pub(crate) fn is_astray(&self) -> bool {
        self.astray_s > ASTRAY_S
    }

    /// Bytes of all arrays.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.newton.bytes() + 16 * (self.from.capacity() + self.with.capacity() + self.velocity.capacity()) + self.past.bytes()
    }
}

/// A body in its tick: what of it stays as it is, and what changes.
struct Mover<'a> {
    body: &'a Body,
    membrane: Option<&'a Membrane>,
    solver: Implicit,
    state: &'a mut TissueState,
    holds: &'a [Hold],
}

type Movers<'a> = SmallVec<[Mover<'a>; 2]>;

impl Mover<'_> {
    fn tissue(&self) -> Tissue<'_> {
        Tissue { body: self.body, membrane: self.membrane }
    }
}

/// Steps bodies that touch, or one that may, over one tick of `dt` s under gravity (m/s2). Whether it did; if not, nothing has changed, and for some of them [`is_lost`] holds,
/// or they have inverted elements and it would be harder than it need be. Of `untangled` bodies the latter is not a reason.
pub(crate) fn step(members: &mut [Member<'_>], gravity: Vec3, dt: f32, settings: &TissueSettings, untangled: bool) -> bool {
    let mut touches = members.first_mut().map(|m| std::mem::take(&mut m.body.implicit.touches)).unwrap_or_default();
    touches.gather(members);
    let solvers: SmallVec<[Implicit; 2]> = members.iter_mut().map(|m| std::mem::take(&mut m.body.implicit)).collect();
    let mut movers: Movers<'_> = SmallVec::new();
    for (member, mut solver) in members.iter_mut().zip(solvers) {
        let nodes = member.state.positions.len();
        solver.newton.resize(nodes);
        for v in [&mut solver.from, &mut solver.with, &mut solver.velocity] {
            v.resize(nodes, Vec3A::ZERO);
        }
        (solver.newton.iterations, solver.careful) = (0, 0);
        solver.starts.clear();
        solver.starts.extend(member.holds.iter().filter_map(|d| d.fixes().map(|i| (i, member.state.positions[i]))));
        movers.push(Mover { body: member.body, membrane: member.membrane, solver, state: member.state, holds: member.holds });
    }
    let all = tick(&mut movers, &mut touches, gravity, dt, settings, untangled);
    let solvers: SmallVec<[Implicit; 2]> = movers.into_iter().map(|m| m.solver).collect();
    for (member, solver) in members.iter_mut().zip(solvers) {
        member.body.implicit = solver;
    }
    if all {
        touches.write(members, dt);
    }
    if let Some(first) = members.first_mut() {
        first.body.implicit.touches = touches;
    }
    all
}

/// Whether all bodies were stepped; if not, nothing has changed.
fn tick(movers: &mut [Mover<'_>], touches: &mut Touches, gravity: Vec3, dt: f32, settings: &TissueSettings, untangled: bool) -> bool {
    if movers.iter().any(|m| m.solver.is_astray()) {
        return false;
    }
    let n = settings.substeps.max(1);
    let mut all = true;
    // One job for the pool: every loop within is split among its threads.
    rayon::scope(|_| {
        for substep in 0..n {
            let step = Step { h: dt / n as f32, gravity, end: (substep + 1) as f32 / n as f32, share: 1.0 / n as f32, dt };
            touches.keep();
            let Err(astray) = substep_of(movers, touches, step, settings) else { continue };
            for m in movers.iter_mut() {
                m.solver.careful += 1;
                m.solver.past.h = 0.0;
            }
            // Where it would go may be tangled where it is not: then it goes carefully. But a single inverted element makes a tick hard, again and again.
            let is_well = |m: &Mover<'_>| match (untangled, astray) {
                (false, _) => m.body.elements().iter().all(|e| !rescue::inverted(e, m.state)),
                (true, Astray::Tangled) => !rescue::is_tangled(m.body, m.state),
                (true, Astray::Wild) => true,
            };
            if substep == 0 && !movers.iter().all(is_well) {
                all = false;
                break;
            }
            touches.go_back();
            careful_substep(movers, touches, step, settings);
        }
    });
    // With contacts there is care without need.
    for Mover { solver, .. } in movers.iter_mut().filter(|_| all && touches.is_empty()) {
        solver.astray_s = if solver.careful > 0 { solver.astray_s + dt } else { (solver.astray_s - dt / 2.0).max(0.0) };
    }
    all
}

/// Whether a body cannot be stepped as the others, and has to be rescued.
pub(crate) fn is_lost(body: &Body, state: &TissueState) -> bool {
    body.implicit.is_astray() || rescue::is_tangled(body, state)
}

fn substep_of(movers: &mut [Mover<'_>], touches: &mut Touches, step: Step, settings: &TissueSettings) -> Result<(), Astray> {
    if settings.stepping == TimeStepping::TwoSteps && movers.iter().all(|m| m.solver.past.leads_to(m.state, step.h)) {
        let whole = Stage::new(step.h * (2.0 / 3.0), step.h / 3.0, settings);
        for Mover { solver, state, .. } in movers.iter_mut() {
            solver.begin(state);
            for (i, (from, with)) in solver.from.iter_mut().zip(&mut solver.with).enumerate() {
                *from += (*from - Vec3A::from(solver.past.before.positions[i])) / 3.0;
                *with += (*with - Vec3A::from(solver.past.before.velocities[i])) / 3.0;
            }
        }
        stage_of(movers, touches, step, whole, settings, Care::Usual, Tangent::Own)?;
        let doubtful = movers.iter().any(|m| m.solver.newton.rounds > 1);
        return finish_unless_gained(movers, touches, step, whole, settings, doubtful);
    }
    let lasting = touches.last();
    let length = if lasting { step.h / 2.0 } else { STAGE * step.h };
    let first = Stage::new(length, 0.0, settings);
    movers.iter_mut().for_each(|m| m.solver.begin(m.state));
    stage_of(movers, touches, step, first, settings, Care::Usual, Tangent::Own)?;
    // Where one step was enough the tangent hardly changes.
    let hard = movers.iter().any(|m| m.solver.newton.rounds > 1);
    if lasting || touches.push() {
        // What a contact does is no smooth force: it is not gone on with. The first stage was a step of backward Euler, and so is the rest.
        touches.finish(length);
        let rest = Stage::new(step.h - length, length, settings);
        for Mover { solver, .. } in movers.iter_mut() {
            for ((from, with), first) in solver.from.iter_mut().zip(&mut solver.with).zip(&solver.velocity) {
                *from += *first * length;
                *with = *first;
            }
        }
        let kept = if lasting && movers.iter().all(|m| m.solver.newton.rounds < FRESH) { Tangent::Kept } else { Tangent::Own };
        stage_of(movers, touches, step, rest, settings, Care::Usual, kept)?;
        let doubtful = hard || movers.iter().any(|m| m.solver.newton.rounds > 1);
        return finish_unless_gained(movers, touches, step, rest, settings, doubtful);
    }
    let kept = if hard { Tangent::Own } else { Tangent::Kept };
    let second = Stage { before: step.h - length, ..first };
    for Mover { solver, .. } in movers.iter_mut() {
        for ((from, with), first) in solver.from.iter_mut().zip(&mut solver.with).zip(&solver.velocity) {
            *from += *first * second.before;
            *with += (*first - *with) * (second.before / length);
        }
    }
    stage_of(movers, touches, step, second, settings, Care::Usual, kept)?;
    let doubtful = hard || movers.iter().any(|m| m.solver.newton.rounds > 1);
    finish_unless_gained(movers, touches, step, second, settings, doubtful)
}

/// Ends a substep; one that is in doubt is taken back when it gave the bodies energy. What took one step of Newton's method a stage is not in doubt.
fn finish_unless_gained(
    movers: &mut [Mover<'_>],
    touches: &mut Touches,
    step: Step,
    last: Stage,
    settings: &TissueSettings,
    doubtful: bool,
) -> Result<(), Astray> {
    // What is moved is given energy.
    let doubtful = doubtful && movers.iter().all(|m| m.holds.iter().all(|hold| hold.from == hold.to));
    for m in movers.iter_mut() {
        if doubtful {
            copy(&mut m.solver.kept, m.state);
        }
        m.solver.finish(m.state, m.holds, step, last, settings);
    }
    if doubtful && has_gained(movers, touches, step) {
        for m in movers.iter_mut() {
            copy(m.state, &m.solver.kept);
        }
        return Err(Astray::Wild);
    }
    touches.finish(last.length);
    Ok(())
}

/// Backward Euler, downhill.
fn careful_substep(movers: &mut [Mover<'_>], touches: &mut Touches, step: Step, settings: &TissueSettings) {
    let whole = Stage { reach: step.h, ..Stage::new(step.h, 0.0, settings) };
    for m in movers.iter_mut() {
        m.solver.begin(m.state);
        // From where it is: going downhill needs a state that is no worse.
        m.solver.velocity.fill(Vec3A::ZERO);
    }
    // Going downhill finds no fault.
    let _ = stage_of(movers, touches, step, whole, settings, Care::Downhill, Tangent::Own);
    touches.finish(whole.length);
    for m in movers.iter_mut() {
        m.solver.finish(m.state, m.holds, step, whole, settings);
        m.solver.past.h = 0.0;
    }
}

/// Finds the velocities of a stage.
fn stage_of(
    movers: &mut [Mover<'_>],
    touches: &mut Touches,
    step: Step,
    stage: Stage,
    settings: &TissueSettings,
    care: Care,
    tangent: Tangent,
) -> Result<(), Astray> {
    let inertia = (1.0 + stage.drag) / (stage.length * stage.reach);
    let mut least = 0.0;
    for m in movers.iter_mut() {
        let tissue = Tissue { body: m.body, membrane: m.membrane };
        m.solver.set_out(tissue, m.state, m.holds, step, stage, !touches.is_empty());
        let mass: f64 = m.body.masses.iter().map(|m| f64::from(*m)).sum();
        least += mass * f64::from(inertia) * (FINE * m.body.size(mass)).powi(2);
    }
    let time_s = (step.end - step.share) * step.dt + stage.before;
    touches.begin(|part| &movers[part].solver.from, time_s, stage.length, stage.reach);
    let stop = Stop { tolerance: settings.tolerance, hasty: (settings.tolerance, 0.0), least, iterations: settings.iterations };
    let weights = Weights { inertia, drag: stage.drag / stage.length, reach: stage.reach };
    let mut parts: SmallVec<[Part<'_>; 2]> = SmallVec::new();
    for m in movers.iter_mut() {
        parts.push(Part { tissue: Tissue { body: m.body, membrane: m.membrane }, newton: &mut m.solver.newton });
    }
    minimise(&mut parts, touches, weights, care, tangent, stop)?;
    drop(parts);
    for m in movers.iter_mut() {
        m.solver.take_velocities(stage);
    }
    if movers.iter().all(|m| m.holds.is_empty()) && !touches.bear() {
        fall_together(movers, step, stage);
        if touches.push() {
            turn_together(movers, stage);
        }
    }
    Ok(())
}

/// Bodies that touch nothing but each other keep the angular momentum that they have together: what truncation made of it is given back as a turn of all.
fn turn_together(movers: &mut [Mover<'_>], stage: Stage) {
    let sums = |of: &dyn Fn(&Implicit, usize) -> (DVec3, DVec3)| {
        let (mut mass, mut middle, mut spin, mut inertia) = (0.0, DVec3::ZERO, DVec3::ZERO, DMat3::ZERO);
        let mut momentum = DVec3::ZERO;
        for m in &*movers {
            for (i, own) in m.body.masses.iter().enumerate().filter(|(_, own)| **own > 0.0) {
                let ((x, v), own) = (of(&m.solver, i), f64::from(*own));
                mass += own;
                middle += x * own;
                momentum += v * own;
                spin += x.cross(v) * own;
                inertia += (DMat3::from_diagonal(DVec3::splat(x.length_squared())) - DMat3::from_cols(x * x.x, x * x.y, x * x.z)) * own;
            }
        }
        let c = middle / mass;
        let offset = DMat3::from_diagonal(DVec3::splat(c.length_squared())) - DMat3::from_cols(c * c.x, c * c.y, c * c.z);
        (c, spin - c.cross(momentum), inertia - offset * mass)
    };
    let (_, before, _) = sums(&|s, i| (s.from[i].as_dvec3(), s.with[i].as_dvec3()));
    let (middle, after, inertia) = sums(&|s, i| ((s.from[i] + s.velocity[i] * stage.length).as_dvec3(), s.velocity[i].as_dvec3()));
    let turn = inertia.inverse() * (before / f64::from(1.0 + stage.drag) - after);
    if !turn.is_finite() {
        return;
    }
    for solver in movers.iter_mut().map(|m| &mut m.solver) {
        for (v, from) in solver.velocity.iter_mut().zip(&solver.from) {
            *v += turn.cross((*from + *v * stage.length).as_dvec3() - middle).as_vec3a();
        }
    }
}

/// Bodies that nothing holds fall freely, all together: what rounding makes of their momentum is taken off.
fn fall_together(movers: &mut [Mover<'_>], step: Step, stage: Stage) {
    let fall = Vec3A::from(step.gravity) * stage.length;
    let off = match &*movers {
        [only] => {
            let drift = mean(only.body, &only.solver.with) + fall;
            drift - mean(only.body, &only.solver.velocity)
        }
        all => {
            let (mut gone, mut mass) = (DVec3::ZERO, 0.0);
            for m in all.iter() {
                let own: f64 = m.body.masses.iter().map(|m| f64::from(*m)).sum();
                let change = mean(m.body, &m.solver.with) + fall - mean(m.body, &m.solver.velocity);
                gone += change.as_dvec3() * own;
                mass += own;
            }
            if mass > 0.0 { (gone / mass).as_vec3a() } else { Vec3A::ZERO }
        }
    };
    for v in movers.iter_mut().flat_map(|m| &mut m.solver.velocity) {
        *v += off;
    }
}

impl Implicit {
    /// Sets a stage to begin where the substep does, and to be looked for where the velocities lead.
    fn begin(&mut self, state: &TissueState) {
        for (i, (x, v)) in state.positions.iter().zip(&state.velocities).enumerate() {
            self.from[i] = (*x).into();
            (self.with[i], self.velocity[i]) = ((*v).into(), (*v).into());
        }
    }

    /// Makes everything ready for a stage.
    fn set_out(&mut self, tissue: Tissue<'_>, state: &TissueState, holds: &[Hold], step: Step, stage: Stage, touched: bool) {
        let inertia = (1.0 + stage.drag) / (stage.length * stage.reach);
        let fall = Vec3A::from(step.gravity) * stage.length;
        // Drag takes nothing of the mean velocity of a body that nothing holds.
        let free = holds.is_empty();
        let drift = match (free, touched) {
            (false, _) => Vec3A::ZERO,
            (true, false) => mean(tissue.body, &self.with) + fall,
            (true, true) => mean(tissue.body, &self.with),
        };
        let newton = &mut self.newton;
        newton.drift = (free && touched).then(|| (mean(tissue.body, &self.from).as_dvec3(), drift));
        for i in 0..newton.x.len() {
            let from = self.from[i];
            newton.free[i] = tissue.body.masses[i] > 0.0 && !newton.crumbs.contains(i);
            newton.added[i] = tissue.body.masses[i] * inertia;
            newton.target[i] = from + (self.with[i] + fall + drift * stage.drag) * (stage.reach / (1.0 + stage.drag));
            newton.x[i] = from + self.velocity[i] * stage.reach;
            newton.ahead[i] = from + self.with[i] * stage.reach;
        }
        for (i, velocity) in driven(holds, &self.starts, state, step) {
            newton.free[i] = false;
            newton.x[i] = Vec3A::from(state.positions[i] + velocity * (stage.before + stage.reach));
        }
        attach(newton, tissue.membrane, holds, step, stage);
    }

    /// Takes the velocities of a stage from where it led.
    fn take_velocities(&mut self, stage: Stage) {
        for ((velocity, x), from) in self.velocity.iter_mut().zip(&self.newton.x).zip(&self.from) {
            *velocity = (*x - *from) / stage.reach;
        }
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

/// Whether bodies have more energy than they had before, and than their weight, contacts and springs to points that stand still have given them: nothing
/// else gives them any.
fn has_gained(movers: &[Mover<'_>], touches: &Touches, step: Step) -> bool {
    let (mut had, mut has, mut work) = (0.0, 0.0, 0.0);
    for m in movers {
        let before = &m.solver.kept;
        let energy = |state: &TissueState| {
            let at = |m: &Membrane| m.energy(&state.positions.iter().map(|x| x.as_dvec3()).collect::<Vec<_>>());
            m.body.kinetic_energy(state) + m.body.elastic_energy(state) + m.tissue().membrane.map_or(0.0, at)
        };
        let fallen = |(m, (x, b)): (&f32, (&Vec3, &Vec3))| f64::from(*m) * f64::from((*x - *b).dot(step.gravity));
        let moved = m.state.positions.iter().zip(&before.positions);
        let weight: f64 = m.body.masses.iter().zip(moved).filter(|(m, _)| **m > 0.0).map(fallen).sum();
        // The mean force times the way, not a difference of energies: a load may be a soft spring to a point far away.
        let pulled = |spring: &Spring| {
            let at = |state: &TissueState| {
                spring.point.iter().map(|(n, w)| state.positions[n.index()].as_dvec3() * f64::from(*w)).sum::<DVec3>()
            };
            let (from, to) = (at(before), at(m.state));
            f64::from(spring.stiffness) * (spring.anchor.as_dvec3() - (from + to) / 2.0).dot(to - from)
        };
        work += weight + m.solver.newton.springs.iter().map(pulled).sum::<f64>();
        had += energy(before);
        has += energy(m.state);
    }
    work += touches.work(step.h);
    has > had + work + GAIN * (had + work.abs())
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
