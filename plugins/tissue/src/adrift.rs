//! What nothing holds: pieces, and scraps that a stroke has cut out before the tool has left.
//!
//! What conjugate gradients leave of the balance is small beside all that the bodies of a system do. Beside what a scrap of some micrograms does it is not: a thousandth of
//! the weight of an organ throws it across the theatre. So in each stage every part that hangs together is moved as a whole to where inertia, contacts
//! and springs balance on it ([`settle`]). And how fast it may be after a tick is known ([`Adrift`]): what touches nothing falls freely; and, restitution being
//! zero, what is touched leaves no faster than what touches it goes, than it comes out of where it lies inside, than its weight is borne and than it springs back.

use crate::body::Body;
use crate::connected::Connected;
use crate::newton::{Newton, Part};
use crate::touch::{Arm, SLOW_S};
use crate::touches::Touches;
use bevy_math::{DVec3, Vec3, Vec3A};
use keyhole_whiteboard::TissueState;

/// Part of the mean edge of a body that one of its parts must be off by to be moved.
const OFF: f64 = 0.01;

/// Moves every part of the bodies that no node is fixed of to its own balance of linear momentum in a stage of `inertia` (1/s2), if it is off by much. The residuals and the
/// contacts are those where the bodies are; the residuals are not kept. Returns how many were moved.
pub(crate) fn settle(parts: &mut [Part<'_>], touches: &mut Touches, inertia: f32) -> usize {
    let mut moved = 0;
    for at in 0..parts.len() {
        let connected = std::mem::take(&mut parts[at].newton.connected);
        let off: Vec<Option<(DVec3, f64)>> =
            (0..connected.parts().len()).map(|part| unbalanced(&parts[at], &connected, part, inertia)).collect();
        let far = OFF * f64::from(parts[at].tissue.body.usual_edge());
        // What one has too much of another of the same body lacks.
        if off.iter().flatten().any(|(left, against)| left.length() > against * far) {
            for (part, off) in off.iter().enumerate() {
                let Some((left, against)) = *off else { continue };
                let shift = touches.balance(parts, |a| a.part as usize == at && connected.of(a.node) == Some(part), left, against);
                for n in &connected.parts()[part] {
                    parts[at].newton.x[*n as usize] += shift;
                }
                moved += 1;
            }
        }
        parts[at].newton.connected = connected;
    }
    if moved > 0 {
        touches.look(parts);
    }
    moved
}

/// What is not balanced at a part of a body that no node is fixed of (N), and what resists its motion (N/m).
fn unbalanced(of: &Part<'_>, connected: &Connected, part: usize, inertia: f32) -> Option<(DVec3, f64)> {
    let (nodes, newton) = (&connected.parts()[part], &*of.newton);
    if nodes.iter().any(|n| !newton.free[*n as usize]) {
        return None;
    }
    let left: DVec3 = nodes.iter().map(|n| newton.gradients.residual[*n as usize].as_dvec3()).sum();
    let mut against: f64 = nodes.iter().map(|n| f64::from(of.tissue.body.masses[*n as usize] * inertia)).sum();
    for spring in &newton.springs {
        let weight: f32 = spring.point.iter().filter(|(n, _)| connected.of(n.0) == Some(part)).map(|(_, w)| w).sum();
        against += f64::from(spring.stiffness * weight * weight);
    }
    Some((left, against))
}

/// A part that nothing holds, when a tick begins.
#[derive(Clone, Debug)]
pub(crate) struct Adrift {
    /// Which of the bodies that are solved together.
    pub body: usize,
    /// Which of its parts.
    part: usize,
    /// Velocity of its middle, m/s.
    velocity: DVec3,
    /// By how much its velocity may change in the tick besides by gravity, m/s.
    most: f32,
}

/// What a tick does to what is adrift, whatever touches it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fall {
    /// Gravity, m/s2.
    pub gravity: Vec3,
    /// Length of the tick, s.
    pub dt: f32,
    /// Drag, 1/s.
    pub drag_1_s: f32,
}

impl Adrift {
    /// Sees how the parts of body number `at` begin a tick, but for those that are `held`; `velocity` is that of a node of any of the bodies (m/s).
    pub(crate) fn see(
        at: usize,
        (body, newton, state): (&Body, &Newton, &TissueState),
        held: impl Fn(usize) -> bool,
        touches: &Touches,
        velocity: impl Fn(&Arm) -> Vec3A,
        fall: Fall,
    ) -> Vec<Self> {
        let connected = &newton.connected;
        let mut index = vec![None; connected.parts().len()];
        let (mut all, mut mass) = (Vec::new(), Vec::new());
        for (part, nodes) in connected.parts().iter().enumerate().filter(|(part, _)| !held(*part)) {
            let (velocity, own) = middle(body, nodes, |n| state.velocities[n as usize].as_dvec3());
            index[part] = Some(all.len());
            all.push(Self { body: at, part, velocity, most: 0.0 });
            mass.push(own);
        }
        if all.is_empty() {
            return all;
        }
        let of = |node: u32| connected.of(node).and_then(|part| index[part]);
        for touch in touches.iter() {
            let way: Vec3A = touch.arms.iter().map(|a| velocity(a) * a.weight).sum();
            let most = (way - touch.velocity).length() + (-touch.gap).max(0.0) / SLOW_S + fall.gravity.length() * fall.dt;
            for own in touch.arms.iter().filter(|a| a.part as usize == at).filter_map(|a| of(a.node)) {
                all[own].most = all[own].most.max(most);
            }
        }
        let mut strained = vec![0.0; all.len()];
        for e in body.elements.iter().filter(|e| !e.is_empty()) {
            if let Some(own) = of(e.nodes[0]).filter(|own| all[*own].most > 0.0) {
                strained[own] += e.energy(e.indices().map(|n| state.positions[n]));
            }
        }
        for (own, (energy, mass)) in all.iter_mut().zip(strained.into_iter().zip(mass)) {
            let sprung = (2.0 * f64::max(energy, 0.0) / mass).sqrt() as f32;
            own.most += sprung + fall.drag_1_s * fall.dt * own.velocity.length() as f32;
        }
        all
    }

    /// Takes back what a tick gave it beyond what it may. The rest of the body has lost that, and gets it again.
    pub(crate) fn hold_back(&self, body: &Body, newton: &Newton, state: &mut TissueState, fall: Fall) {
        let nodes = &newton.connected.parts()[self.part];
        let (now, own) = middle(body, nodes, |n| state.velocities[n as usize].as_dvec3());
        let change = now - self.velocity - (fall.gravity * fall.dt).as_dvec3();
        let size = change.length();
        if size.is_nan() || size <= f64::from(self.most) {
            return;
        }
        let back = change * (f64::from(self.most) / size - 1.0);
        let rest = body.masses.iter().map(|m| f64::from(*m)).sum::<f64>() - own;
        let forth = if newton.connected.parts().len() > 1 { (back * (-own / rest)).as_vec3() } else { Vec3::ZERO };
        for (n, _) in newton.free.iter().enumerate().filter(|(_, free)| **free) {
            let change = if newton.connected.of(n as u32) == Some(self.part) { back.as_vec3() } else { forth };
            state.velocities[n] += change;
            state.positions[n] += change * fall.dt;
        }
    }
}

/// The mean over the mass of some nodes, and that mass, kg.
fn middle(body: &Body, nodes: &[u32], of: impl Fn(u32) -> DVec3) -> (DVec3, f64) {
    let mass = |n: &u32| f64::from(body.masses[*n as usize]);
    let all: f64 = nodes.iter().map(mass).sum();
    (nodes.iter().map(|n| of(*n) * mass(n)).sum::<DVec3>() / all, all)
}
