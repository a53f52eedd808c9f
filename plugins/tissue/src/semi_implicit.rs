//! Symplectic Euler whose inertia is raised against stiff motions, just enough to be stable at any step.
//!
//! With `f` the exact elastic force, `h` the substep and `b` the time of viscosity, one substep is
//!
//! `v += P^-1 h (f(x + b v) + M g)`, then `x += h v`, with `P = M + h^2 (1/4 + b / 2h) L`.
//!
//! `L` is a scalar Laplacian on the edges of the mesh that bounds the stiffness from above, `L >= K` (see [`crate::metric`]): stable is what
//! satisfies `h^2 K (1 + 2b/h) <= 4 P`, and that does. It is selective mass scaling (Olovsson, Simonsson, Unosson 2005, doi 10.1002/nme.1293) with
//! the scalar metric of quasi-Newton methods (Liu, Bouaziz, Kavan 2017, doi 10.1145/2990496). What follows from it:
//!
//! - Where nothing moves `f + M g = 0`: the equilibrium is that of the mesh, whatever the substep, the tolerance or the number of
//!   iterations. Methods that build the force up by iterations make another, softer material instead.
//! - `L` knows no translation, so linear momentum and free fall are those of `M`.
//! - The price is inertia: a motion of wave number `k` feels the mass `rho + h^2 (1/4 + b/2h) kappa k^2`. See the table of the crate.
//! - Force at `x + b v` is viscosity: a mode of angular frequency `w` has damping ratio `b w / 2`.

use crate::body::Body;
use crate::conjugate::Conjugate;
use crate::element::cofactor;
use crate::hold::Hold;
use crate::metric::Metric;
use crate::settings::TissueSettings;
use bevy_math::{Vec3, Vec3A};
use keyhole_whiteboard::TissueState;

/// A point of several nodes held without compliance is held by a spring this many times as stiff as the tissue at the point.
const RIGID: f32 = 100.0;

/// Share of the substep that is the least time of viscosity: a truncated solution leaves errors in the stiffest modes, which have to fade. With
/// none, a beam of 1 MPa blew up at 8 substeps and a tolerance of 0.1; with a quarter, beams of 10 kPa to 1 MPa with edges cut at 1 % came to
/// rest with 1 to 8 substeps.
const LEAST_VISCOSITY: f32 = 0.25;

/// Sum of the squares of the principal stretches (3 at rest) from which an element counts as torn out of shape: a stretch of 5.
const MOST_STRETCH: f32 = 25.0;

/// Steps a body over one tick of `dt` s under gravity (m/s2).
pub fn step(body: &Body, state: &mut TissueState, holds: &[Hold], gravity: Vec3, dt: f32, settings: &TissueSettings) {
    let n = settings.substeps.max(1);
    let h = dt / n as f32;
    let lookahead = settings.viscosity_s.max(LEAST_VISCOSITY * h);
    let raise = h * h * (0.25 + 0.5 * lookahead / h);
    let decay = (-settings.drag_1_s * h).exp();
    let driven: Vec<(usize, Vec3, Vec3)> = holds.iter().filter_map(|d| d.fixes().map(|i| (i, state.positions[i], d.to))).collect();
    let springs: Vec<&Hold> = holds.iter().filter(|d| d.fixes().is_none()).collect();
    let mut free: Vec<bool> = body.masses.iter().map(|m| *m > 0.0).collect();
    for (i, ..) in &driven {
        free[*i] = false;
    }

    let mut metric = Metric::default();
    let mut solver = Conjugate::new(state.positions.len());
    let mut right = vec![Vec3A::ZERO; state.positions.len()];
    for substep in 0..n {
        let s = (substep + 1) as f32 / n as f32;
        calm(body, state);
        metric.assemble(body, &state.positions, raise, &free);
        right.fill(Vec3A::ZERO);
        elastic(body, state, lookahead, &mut right);
        for hold in &springs {
            spring(hold, s, state, h, lookahead, raise, &mut metric, &mut right);
        }
        for (r, m) in right.iter_mut().zip(&body.masses) {
            *r *= h;
            if !holds.is_empty() {
                *r += Vec3A::from(gravity) * (*m * h);
            }
        }
        // What is driven changes its velocity as its anchor does, and takes the inertia of its neighbours along.
        let driver = |i: usize, from: Vec3, to: Vec3, v: Vec3| (i, Vec3A::from((from.lerp(to, s) - state.positions[i]) / h - v));
        let changes: Vec<(usize, Vec3A)> = driven.iter().map(|(i, from, to)| driver(*i, *from, *to, state.velocities[*i])).collect();
        metric.carry_along(&changes, &mut right);

        let change = solver.solve(&metric, &mut right, settings.tolerance, settings.iterations);
        // An unheld body falls freely: drag takes nothing of its mean velocity, and what truncation makes of its momentum is taken off.
        let (common, drift) = if holds.is_empty() {
            (gravity * h - mean(body, change.iter().map(|c| Vec3::from(*c))), mean(body, state.velocities.iter().copied()))
        } else {
            (Vec3::ZERO, Vec3::ZERO)
        };
        for ((v, change), free) in state.velocities.iter_mut().zip(change).zip(&free) {
            if *free {
                *v = drift + (*v - drift) * decay + Vec3::from(*change) + common;
            }
        }
        for (i, change) in &changes {
            state.velocities[*i] += Vec3::from(*change);
        }
        // Of a free fall the velocity at the end of a substep would be half a substep ahead.
        let ahead = if holds.is_empty() { gravity * (0.5 * h * h) } else { Vec3::ZERO };
        for ((x, v), free) in state.positions.iter_mut().zip(&state.velocities).zip(&free) {
            *x += *v * h - if *free { ahead } else { Vec3::ZERO };
        }
    }
}

/// Takes the relative velocity of its nodes off an element that is inverted or stretched beyond anything tissue survives: it then moves as if
/// it had no inertia, downhill. Linear momentum stays. Without it a scrambled mesh gains energy without end.
fn calm(body: &Body, state: &mut TissueState) {
    for e in body.elements.iter().filter(|e| !e.is_empty() && !e.thin) {
        let at = e.indices();
        let f = e.deformation(at.map(|i| state.positions[i]));
        let size = f.x_axis.length_squared() + f.y_axis.length_squared() + f.z_axis.length_squared();
        if f.determinant() > 0.0 && size < MOST_STRETCH {
            continue;
        }
        let mass: f32 = at.iter().map(|i| body.masses[*i]).sum();
        let mean = at.iter().map(|i| state.velocities[*i] * body.masses[*i]).sum::<Vec3>() / mass;
        for i in at {
            state.velocities[i] = mean;
        }
    }
}

/// Adds the elastic forces (N) at the positions `lookahead` s ahead.
pub(crate) fn elastic(body: &Body, state: &TissueState, lookahead: f32, forces: &mut [Vec3A]) {
    for e in body.elements.iter().filter(|e| !e.is_empty()) {
        let at = e.indices();
        let f = e.deformation(at.map(|i| state.positions[i] + state.velocities[i] * lookahead));
        let c = cofactor(f);
        let pressure = e.material.lambda * (f.x_axis.dot(c.x_axis) - e.material.a());
        let force = e.forces(f * e.material.mu + c * pressure);
        forces[at[0]] -= Vec3A::from(force.x_axis + force.y_axis + force.z_axis);
        forces[at[1]] += Vec3A::from(force.x_axis);
        forces[at[2]] += Vec3A::from(force.y_axis);
        forces[at[3]] += Vec3A::from(force.z_axis);
    }
}

/// Adds the force of a hold with compliance, and its inertia such that a rigid one reaches its anchor in one substep.
fn spring(hold: &Hold, s: f32, state: &TissueState, h: f32, lookahead: f32, raise: f32, metric: &mut Metric, forces: &mut [Vec3A]) {
    let total: f32 = hold.point.iter().map(|(_, w)| w.abs()).sum();
    let around: f32 = hold.point.iter().map(|(n, w)| w.abs() * metric.raised(n.index()) / raise).sum();
    let compliance = hold.compliance_m_n.max(0.0);
    let stiffness = if compliance * RIGID * around > 1.0 { 1.0 / compliance } else { RIGID * around };
    let mut gap = -hold.from.lerp(hold.to, s);
    for (node, weight) in &hold.point {
        gap += (state.positions[node.index()] + state.velocities[node.index()] * lookahead) * *weight;
    }
    for (node, weight) in &hold.point {
        forces[node.index()] -= Vec3A::from(gap * (stiffness * weight));
        metric.raise(node.index(), (h * h + h * lookahead) * stiffness * weight.abs() * total);
    }
}

/// Velocity of the centre of mass where the nodes have these velocities, m/s.
fn mean(body: &Body, velocities: impl Iterator<Item = Vec3>) -> Vec3 {
    let (mut momentum, mut mass) = (bevy_math::DVec3::ZERO, 0.0);
    for (m, v) in body.masses.iter().zip(velocities).filter(|(m, _)| **m > 0.0) {
        momentum += v.as_dvec3() * f64::from(*m);
        mass += f64::from(*m);
    }
    if mass > 0.0 { (momentum / mass).as_vec3() } else { Vec3::ZERO }
}
