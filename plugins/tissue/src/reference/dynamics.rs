//! Motion by the second order backward differentiation formula (Curtiss, Hirschfelder 1952), second order and stable for stiff motions at any
//! step; the first step is two half steps of backward Euler, whose error is of second order in one step.
//!
//! With `v' = f(x + b v) / m + g - d v`, `b` the time of viscosity and `d` the drag, the positions at the end of a step are the only unknowns.

use super::sparse::System;
use super::{Problem, ReferenceError, norm};
use bevy_math::DVec3;

/// A body in motion.
pub struct Dynamics {
    problem: Problem,
    system: System,
    /// Positions, m.
    pub positions: Vec<DVec3>,
    /// Velocities, m/s.
    pub velocities: Vec<DVec3>,
    before: Option<(Vec<DVec3>, Vec<DVec3>, f64)>,
    /// Rate at which velocities decay, 1/s.
    pub drag_1_s: f64,
    /// Viscosity as a time, s: a mode of angular frequency w has damping ratio `viscosity w / 2` from it.
    pub viscosity_s: f64,
    /// Norm of the residual over that of inertia and forces at which an iteration ends. Default 1e-9.
    pub tolerance: f64,
}

/// Most iterations of one step.
const ITERATIONS: u32 = 50;

impl Dynamics {
    /// A body at these positions (m), at rest, without damping.
    ///
    /// # Errors
    /// When the library refuses the pattern.
    pub fn new(problem: Problem, positions: Vec<DVec3>) -> Result<Self, ReferenceError> {
        let system = System::new(&problem)?;
        let velocities = vec![DVec3::ZERO; positions.len()];
        Ok(Self { problem, system, positions, velocities, before: None, drag_1_s: 0.0, viscosity_s: 0.0, tolerance: 1e-9 })
    }

    /// The body.
    #[must_use]
    pub fn problem(&self) -> &Problem {
        &self.problem
    }

    /// One step of `h` s under gravity (m/s2); fixed nodes go to where `anchor` puts them, m.
    ///
    /// # Errors
    /// When Newton's method does not converge: the step is too long.
    pub fn step(&mut self, h: f64, gravity: DVec3, anchor: impl Fn(usize) -> Option<DVec3>) -> Result<(), ReferenceError> {
        let (x, v) = (self.positions.clone(), self.velocities.clone());
        match &self.before {
            // Backward differences of second order need equal steps.
            Some((xb, vb, last)) if (last - h).abs() <= 1e-9 * h => {
                let back = |now: &[DVec3], then: &[DVec3]| now.iter().zip(then).map(|(n, t)| (*n * 4.0 - *t) / 3.0).collect::<Vec<_>>();
                let (xt, vt) = (back(&x, xb), back(&v, vb));
                self.implicit(&xt, &vt, 2.0 * h / 3.0, gravity, &anchor)?;
            }
            _ => {
                let middle = |i: usize| anchor(i).map(|to| (x[i] + to) / 2.0);
                self.implicit(&x, &v, h / 2.0, gravity, &middle)?;
                let (xm, vm) = (self.positions.clone(), self.velocities.clone());
                self.implicit(&xm, &vm, h / 2.0, gravity, &anchor)?;
            }
        }
        self.before = Some((x, v, h));
        Ok(())
    }

    /// Solves `x = xt + k v`, `v = vt + k a(x, v)`.
    fn implicit(
        &mut self,
        xt: &[DVec3],
        vt: &[DVec3],
        k: f64,
        gravity: DVec3,
        anchor: &dyn Fn(usize) -> Option<DVec3>,
    ) -> Result<(), ReferenceError> {
        let problem = &self.problem;
        let look = 1.0 + self.viscosity_s / k;
        let inertia = (1.0 + self.drag_1_s * k) / (k * k);
        let mut x = self.positions.clone();
        for i in 0..x.len() {
            if problem.fixed[i] {
                x[i] = anchor(i).unwrap_or(x[i]);
            } else {
                x[i] = xt[i] + vt[i] * k;
            }
        }
        let mut residual = f64::INFINITY;
        for _ in 0..ITERATIONS {
            let z: Vec<DVec3> = x.iter().zip(xt).map(|(x, t)| *x * look - *t * (look - 1.0)).collect();
            let elastic = problem.forces(&z);
            let mut out = vec![DVec3::ZERO; x.len()];
            let mut scale = 0.0;
            for i in (0..x.len()).filter(|i| !problem.fixed[*i]) {
                let v = (x[i] - xt[i]) / k;
                let momentum = ((v - vt[i]) / k + v * self.drag_1_s - gravity) * problem.masses[i];
                out[i] = elastic[i] - momentum;
                scale += elastic[i].length_squared() + momentum.length_squared() + (gravity * problem.masses[i]).length_squared();
            }
            residual = norm(&out, &problem.fixed) / scale.sqrt().max(f64::MIN_POSITIVE);
            if residual <= self.tolerance {
                break;
            }
            let factor = self.system.factorise(problem, &z, look, inertia)?;
            for (x, d) in x.iter_mut().zip(self.system.solve(&factor, &out)) {
                *x += d;
            }
        }
        if residual > self.tolerance {
            return Err(ReferenceError::NotConverged { iterations: ITERATIONS, residual, expected: self.tolerance });
        }
        self.velocities = x.iter().zip(xt).map(|(x, t)| (*x - *t) / k).collect();
        self.positions = x;
        Ok(())
    }

    /// Kinetic and elastic energy, J.
    #[must_use]
    pub fn energies(&self) -> (f64, f64) {
        let kinetic = self.problem.masses.iter().zip(&self.velocities).map(|(m, v)| m * v.length_squared() / 2.0).sum();
        (kinetic, self.problem.energy(&self.positions))
    }
}
