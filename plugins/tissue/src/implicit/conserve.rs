//! What a substep must keep: momentum, angular momentum, energy.

use super::{Implicit, Mover, Stage, Step};
use crate::body::Body;
use crate::gradients::Spring;
use crate::membrane::Membrane;
use crate::touches::Touches;
use bevy_math::{DMat3, DVec3, Vec3, Vec3A};
use keyhole_whiteboard::TissueState;

/// Part of its energy that a body may gain in a substep of several steps of Newton's method, by the error of the method.
const GAIN: f64 = 0.05;

/// Bodies that touch nothing but each other keep the angular momentum that they have together: what truncation made of it is given back as a turn of all.
pub(super) fn turn_together(movers: &mut [Mover<'_>], stage: Stage) {
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
pub(super) fn fall_together(movers: &mut [Mover<'_>], step: Step, stage: Stage) {
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

/// Whether bodies have more energy than they had before, and than their weight, contacts and springs to points that stand still have given them: nothing
/// else gives them any.
pub(super) fn has_gained(movers: &[Mover<'_>], touches: &Touches, step: Step) -> bool {
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

/// Velocity of the centre of mass where the nodes have these velocities, m/s.
pub(super) fn mean(body: &Body, velocities: &[Vec3A]) -> Vec3A {
    let (mut momentum, mut mass) = (DVec3::ZERO, 0.0);
    for (m, v) in body.masses.iter().zip(velocities).filter(|(m, _)| **m > 0.0) {
        momentum += v.as_dvec3() * f64::from(*m);
        mass += f64::from(*m);
    }
    if mass > 0.0 { (momentum / mass).as_vec3a() } else { Vec3A::ZERO }
}
