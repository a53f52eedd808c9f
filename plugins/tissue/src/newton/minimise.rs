//! From where the bodies are to the minimum.

use super::{Astray, Care, Newton, Part, Tangent, Weights};
use crate::gradients::{Equation, Stop, size};
use crate::relax::relax;
use crate::touches::Touches;
use bevy_math::{DMat3, DVec3};
use smallvec::SmallVec;

/// How often a step of Newton's method is halved before it is given up.
const HALVINGS: u32 = 10;

/// A stage that leads to where more than one in so many of the elements is inverted is done carefully.
const TANGLED: usize = 400;

/// Most steps of Newton's method of a stage that goes as usual. Nearly always one does.
const USUAL_STEPS: u32 = 4;

/// Most steps of Newton's method of a stage that has to be done carefully.
const CAREFUL_STEPS: u32 = 6;

/// Share of the square of the residual that a stage may leave.
const ENOUGH: f64 = 0.04;

/// Share of the residual at which conjugate gradients stop where contacts push and it is not small: the step after it is about other contacts.
const HASTY: f32 = 0.4;

/// Share of the square of the residual without contacts below which nothing is worth doing.
const NOTHING: f64 = 1e-11;

/// Share of the square of the residual without contacts that a stage with contacts may leave: what is left of it is momentum.
const TOUCHING_ENOUGH: f64 = 0.004;

/// The same that is too much after all steps. Below it momentum is balanced, and the shape is left for the next tick.
const TOUCHING_WILD: f64 = 4.0;

/// The same of a stage that leads away, if it is more than there was before the step: where that leads no further step brings it back from.
const LOST: f64 = 1e6;

/// So many times the iterations that a stage may take goes one with contacts on with, all its steps together. What is left then is left for the next tick:
/// an organ of ten thousand elements that is pushed, folded and pulled at once would take ten ticks' time to balance.
const BUDGET: u32 = 1;

/// Further steps where there are contacts, and after how many the tangent of the tissue is assembled anew there.
const TOUCHING_STEPS: u32 = 8;
pub(crate) const FRESH: u32 = 4;

/// Multiple of the size of residual at which conjugate gradients stop that a stage may leave: there is hardly more than rounding in it.
const ROUNDING: f64 = 16.0;

/// Share of the square of the residual that is too much after all of them.
const WILD: f64 = 0.5;

/// Takes `x` of all bodies to the minimum. The first step is with the tangent that there is, when `tangent` says so.
pub(crate) fn minimise(
    parts: &mut [Part<'_>],
    touches: &mut Touches,
    weights: Weights,
    care: Care,
    tangent: Tangent,
    stop: Stop,
) -> Result<(), Astray> {
    let most = match care {
        Care::Usual => USUAL_STEPS,
        Care::Downhill => CAREFUL_STEPS,
    };
    let most = if touches.is_empty() { most } else { most + TOUCHING_STEPS };
    let mut before = 0.0;
    let mut energy = None;
    let mut convex = care == Care::Downhill;
    let elements: usize = parts.iter().map(|p| p.tissue.body.elements.len()).sum();
    match care {
        Care::Usual => touches.look_ahead(parts),
        Care::Downhill => {
            touches.look(parts);
            start_lower(parts, touches, weights);
        }
    }
    let mut stale = true;
    let mut recapped = false;
    // Whether the residuals are those where the bodies are.
    let mut looked = false;
    let (all, mut spent) = (stop.iterations * BUDGET, 0);
    for round in 1..=most {
        parts.iter_mut().for_each(|p| p.newton.rounds = round);
        looked = false;
        if round == 1 && tangent == Tangent::Kept {
            look(parts, touches, weights);
        } else if stale || touches.is_empty() || round % FRESH == 0 {
            let inverted: usize = parts.iter_mut().map(|p| p.newton.assemble(p.tissue.membrane, convex)).sum();
            if inverted * TANGLED > elements && care == Care::Usual {
                return Err(Astray::Tangled);
            }
            parts.iter_mut().for_each(|p| p.newton.prepare(convex));
            balance(parts, touches, weights);
            stale = false;
        }
        if round == 1 && care == Care::Usual && touches.push() {
            // By what the bodies would do without contacts it is measured what is enough: the contacts may say anything where it is begun.
            touches.add_forces(parts, -1.0);
            before = with_equations(parts, size);
            touches.add_forces(parts, 1.0);
        }
        touches.hold(parts);
        let stop = if before > 0.0 && touches.push() {
            Stop {
                hasty: (stop.tolerance.max(HASTY), before * TOUCHING_ENOUGH),
                least: stop.least.max(before * NOTHING),
                iterations: all - spent,
                ..stop
            }
        } else {
            stop
        };
        let solved = with_equations(parts, |equations| touches.solve(equations, stop));
        if before <= 0.0 {
            before = solved.before;
        }
        parts.iter_mut().for_each(|p| p.newton.iterations += solved.iterations);
        spent = (spent + solved.iterations).min(all);
        let last = round == most || touches.push() && spent >= all;
        settle_momentum(parts, touches, weights);
        if solved.iterations == 0 && !solved.negative {
            break;
        }
        match care {
            Care::Usual => {
                if solved.negative {
                    if last {
                        return Err(Astray::Wild);
                    }
                    (convex, stale) = (true, true);
                    continue;
                }
                let part = if touches.is_empty() { 1.0 } else { touches.part_of(parts, solved.gain) };
                parts.iter_mut().for_each(|p| p.newton.go(part));
                touches.look(parts);
                look(parts, touches, weights);
                looked = true;
                let size = with_equations(parts, |equations| touches.size(equations));
                let left = size / before;
                if !touches.is_empty() && (left.is_nan() || left > LOST.max(solved.before / before)) {
                    return Err(Astray::Wild);
                }
                // A tangent that did not lead nearer is no good any more.
                stale |= size > solved.before;
                let enough = if touches.push() { TOUCHING_ENOUGH } else { ENOUGH };
                if left <= enough || size <= ROUNDING * stop.least {
                    if recapped || !touches.recap() {
                        break;
                    }
                    // Friction with the forces that there are now.
                    recapped = true;
                    touches.look(parts);
                    look(parts, touches, weights);
                }
                let wild = if touches.push() { TOUCHING_WILD } else { WILD };
                if last && (left > wild || left.is_nan()) {
                    return Err(Astray::Wild);
                }
                if last {
                    break;
                }
            }
            Care::Downhill => {
                let now = energy.unwrap_or_else(|| total_energy(parts, touches, weights));
                let first = if touches.is_empty() { 1.0 } else { touches.part_of(parts, solved.gain) };
                energy = go_downhill(parts, touches, weights, first, now);
                if energy.is_none() {
                    break;
                }
                if last {
                    break;
                }
                if !touches.is_empty() {
                    // Friction is capped by another force from here on.
                    touches.look(parts);
                    energy = None;
                }
            }
        }
    }
    touches.look(parts);
    if touches.bear() && !parts.iter().any(|p| p.newton.is_fixed(p.tissue.body)) {
        if !looked {
            look(parts, touches, weights);
        }
        let (mut left, mut mass) = (DVec3::ZERO, 0.0);
        for Part { tissue, newton } in parts.iter() {
            left += newton.gradients.residual.iter().map(|r| r.as_dvec3()).sum::<DVec3>();
            mass += tissue.body.masses.iter().map(|m| f64::from(*m)).sum::<f64>();
        }
        let shift = touches.balance(parts, left, mass * f64::from(weights.inertia));
        looked = false;
        for newton in parts.iter_mut().map(|p| &mut *p.newton) {
            for (x, _) in newton.x.iter_mut().zip(&newton.free).filter(|(_, free)| **free) {
                *x += shift;
            }
        }
        touches.look(parts);
    }
    if !touches.is_empty() {
        if !looked {
            look(parts, touches, weights);
        }
        relax(parts, touches, weights.inertia);
    }
    Ok(())
}

/// Begins where the bodies' velocities lead, `target`, instead of where they are, if that is lower.
fn start_lower(parts: &mut [Part<'_>], touches: &mut Touches, weights: Weights) {
    if touches.is_empty() {
        return;
    }
    let here = total_energy(parts, touches, weights);
    let swap = |parts: &mut [Part<'_>]| {
        for Part { newton, .. } in parts {
            for (i, start) in newton.gradients.solution.iter_mut().enumerate().filter(|(i, _)| newton.free[*i]) {
                std::mem::swap(start, &mut newton.x[i]);
            }
        }
    };
    for Part { newton, .. } in parts.iter_mut() {
        let Newton { gradients, ahead, .. } = &mut **newton;
        gradients.solution.copy_from_slice(ahead);
    }
    swap(parts);
    touches.look(parts);
    let there = total_energy(parts, touches, weights);
    if there.is_nan() || there >= here {
        swap(parts);
        touches.look(parts);
    }
}

/// Does something with the systems of all bodies.
fn with_equations<T>(parts: &mut [Part<'_>], then: impl FnOnce(&mut [Equation<'_>]) -> T) -> T {
    let mut equations: SmallVec<[Equation<'_>; 4]> = parts.iter_mut().map(|p| p.newton.equation()).collect();
    then(&mut equations)
}

/// Takes the residuals to where the bodies now are.
fn look(parts: &mut [Part<'_>], touches: &Touches, weights: Weights) {
    parts.iter_mut().for_each(|p| p.newton.look(p.tissue));
    balance(parts, touches, weights);
}

/// Adds everything that is not elastic to the elastic forces that are in the residuals.
fn balance(parts: &mut [Part<'_>], touches: &Touches, weights: Weights) {
    parts.iter_mut().for_each(|p| p.newton.balance(p.tissue, weights.inertia));
    touches.add_forces(parts, 1.0);
}

/// Moves bodies that no node is fixed of all together by what truncation left of the balance of their linear momentum.
fn settle_momentum(parts: &mut [Part<'_>], touches: &Touches, weights: Weights) {
    if parts.iter().any(|p| p.newton.is_fixed(p.tissue.body)) {
        return;
    }
    let Weights { inertia, drag, reach } = weights;
    let mut left = DVec3::ZERO;
    let mut against = 0.0_f64;
    for Part { tissue, newton } in parts.iter() {
        if let Some((from, drift)) = newton.drift {
            // Drag takes nothing of the mean velocity, which is not what it was thought to be.
            let (mut sum, mut mass) = (DVec3::ZERO, 0.0);
            for (m, (x, d)) in tissue.body.masses.iter().zip(newton.x.iter().zip(&newton.gradients.solution)).filter(|(m, _)| **m > 0.0) {
                sum += (*x + *d).as_dvec3() * f64::from(*m);
                mass += f64::from(*m);
            }
            left += ((sum - from * mass) / f64::from(reach) - drift.as_dvec3() * mass) * f64::from(drag);
        }
        left += newton.gradients.residual.iter().map(|r| r.as_dvec3()).sum::<DVec3>();
        against += tissue.body.masses.iter().map(|m| f64::from(m * inertia)).sum::<f64>();
        for spring in &newton.springs {
            against += f64::from(spring.stiffness * spring.point.iter().map(|(_, w)| w).sum::<f32>().powi(2));
        }
    }
    if against <= 0.0 {
        return;
    }
    let shift = if touches.push() {
        let all = DMat3::from_diagonal(DVec3::splat(against)) + DMat3::from_cols_array(&touches.against().to_cols_array().map(f64::from));
        (all.inverse() * left).as_vec3a()
    } else {
        (left / against).as_vec3a()
    };
    for Part { newton, .. } in parts {
        for (d, _) in newton.gradients.solution.iter_mut().zip(&newton.free).filter(|(_, free)| **free) {
            *d += shift;
        }
    }
}

/// Goes along the solution, `first` of it and less and less until the energy is lower than `before`; the energy there, if it got anywhere.
fn go_downhill(parts: &mut [Part<'_>], touches: &Touches, weights: Weights, first: f32, before: f64) -> Option<f64> {
    let go = |parts: &mut [Part<'_>], part: f32| parts.iter_mut().for_each(|p| p.newton.go(part));
    let mut part = first;
    go(parts, part);
    for _ in 0..HALVINGS {
        let energy = total_energy(parts, touches, weights);
        if energy < before {
            return Some(energy);
        }
        go(parts, -part / 2.0);
        part /= 2.0;
    }
    go(parts, -part);
    None
}

/// What a stage makes least, J.
fn total_energy(parts: &[Part<'_>], touches: &Touches, weights: Weights) -> f64 {
    parts.iter().map(|p| p.newton.energy(p.tissue, weights.inertia)).sum::<f64>() + touches.energy(parts)
}
