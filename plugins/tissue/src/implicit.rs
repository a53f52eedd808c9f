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

mod conserve;
mod substep;

use crate::body::Body;
use crate::gradients::Spring;
use crate::hold::Hold;
use crate::island::Member;
use crate::membrane::Membrane;
use crate::newton::{Astray, Newton, Tissue};
use crate::rescue;
use crate::settings::{TimeStepping, TissueSettings};
use crate::touches::{Grips, Touches};
use bevy_math::{Vec3, Vec3A};
use conserve::mean;
use keyhole_whiteboard::{TissuePoint, TissueState};
use smallvec::SmallVec;
use substep::{careful_substep, substep_of};

/// A point of several nodes held without compliance is held by a spring this many times as stiff as the tissue at the point.
const STIFF: f32 = 100.0;

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
