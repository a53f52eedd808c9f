//! Equilibrium under dead loads, by Newton's method with a line search and as many load steps as it takes.

use super::sparse::System;
use super::{Problem, ReferenceError, norm};
use bevy_math::DVec3;

/// How the equilibrium is sought.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Statics {
    /// Steps in which the load is applied. Default 4.
    pub load_steps: u32,
    /// Most iterations of Newton's method in one step. Default 60.
    pub iterations: u32,
    /// Norm of the residual over that of load and reactions at which an iteration ends. Default 1e-9.
    pub tolerance: f64,
}

impl Default for Statics {
    fn default() -> Self {
        Self { load_steps: 4, iterations: 60, tolerance: 1e-9 }
    }
}

/// A step that lowers the energy by less than this part of what the slope promises is too long (Armijo 1966).
const ARMIJO: f64 = 1e-4;

/// Where a body rests under forces on its nodes (N), its fixed nodes where `start` has them. `start` are positions by node slot, m.
///
/// # Errors
/// When the tangent is singular, or the last load step does not converge.
pub fn equilibrium(problem: &Problem, start: &[DVec3], loads: &[DVec3], settings: Statics) -> Result<Vec<DVec3>, ReferenceError> {
    let system = System::new(problem)?;
    equilibrium_in(&system, problem, start, loads, settings)
}

/// The same with the pattern at hand.
///
/// # Errors
/// As [`equilibrium`].
pub fn equilibrium_in(
    system: &System,
    problem: &Problem,
    start: &[DVec3],
    loads: &[DVec3],
    settings: Statics,
) -> Result<Vec<DVec3>, ReferenceError> {
    let mut x = start.to_vec();
    let steps = settings.load_steps.max(1);
    for step in 1..=steps {
        let share = f64::from(step) / f64::from(steps);
        let scaled: Vec<DVec3> = loads.iter().map(|f| *f * share).collect();
        let outcome = newton(system, problem, &mut x, &scaled, settings);
        if step == steps {
            outcome?;
        }
    }
    Ok(x)
}

fn newton(system: &System, problem: &Problem, x: &mut Vec<DVec3>, loads: &[DVec3], settings: Statics) -> Result<(), ReferenceError> {
    let potential = |x: &[DVec3]| problem.energy(x) - x.iter().zip(loads).map(|(x, f)| x.dot(*f)).sum::<f64>();
    let mut residual = f64::INFINITY;
    for _ in 0..settings.iterations {
        let forces = problem.forces(x);
        // Compared with the load and with what holds the fixed nodes, so that a body that is only pulled at by them has a scale as well.
        let reactions = forces.iter().zip(&problem.fixed).filter(|(_, f)| **f).map(|(r, _)| r.length_squared()).sum::<f64>().sqrt();
        let scale = norm(loads, &problem.fixed) + reactions;
        let out: Vec<DVec3> = forces.iter().zip(loads).map(|(a, b)| *a + *b).collect();
        residual = norm(&out, &problem.fixed) / scale.max(f64::MIN_POSITIVE);
        if residual <= settings.tolerance || scale <= 0.0 {
            return Ok(());
        }
        let factor = system.factorise(problem, x, 1.0, 0.0)?;
        let step = system.solve(&factor, &out);
        let slope: f64 = step.iter().zip(&out).map(|(d, f)| d.dot(*f)).sum();
        let before = potential(x);
        let mut length = 1.0;
        loop {
            let tried: Vec<DVec3> = x.iter().zip(&step).map(|(x, d)| *x + *d * length).collect();
            // Close to the minimum the energy no longer tells: rounding is larger than the difference.
            let told = slope.abs() > 1e-12 * (before.abs() + slope.abs());
            if !told || potential(&tried) <= before - ARMIJO * length * slope || length < 1e-6 {
                *x = tried;
                break;
            }
            length *= 0.5;
        }
    }
    Err(ReferenceError::NotConverged { iterations: settings.iterations, residual, expected: settings.tolerance })
}
