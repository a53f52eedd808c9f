//! A substep: its stages, and what is done where they lead astray.

use super::conserve::{fall_together, has_gained, turn_together};
use super::{Mover, Stage, Step, copy};
use crate::gradients::Stop;
use crate::newton::{Astray, Care, FRESH, Part, Tangent, Tissue, Weights, minimise};
use crate::settings::{TimeStepping, TissueSettings};
use crate::touches::Touches;
use bevy_math::Vec3A;
use smallvec::SmallVec;
use std::f32::consts::FRAC_1_SQRT_2;

/// `c`: each stage is a step of backward Euler of this share of the substep.
const STAGE: f32 = 1.0 - FRAC_1_SQRT_2;

/// Root mean square of the displacement, as a share of the body's size, that conjugate gradients do not care about.
const FINE: f64 = 3e-7;

pub(super) fn substep_of(movers: &mut [Mover<'_>], touches: &mut Touches, step: Step, settings: &TissueSettings) -> Result<(), Astray> {
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
pub(super) fn careful_substep(movers: &mut [Mover<'_>], touches: &mut Touches, step: Step, settings: &TissueSettings) {
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
