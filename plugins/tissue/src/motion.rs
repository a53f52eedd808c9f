//! What the models that move nodes have in common: nodes that are driven, free fall and drag, velocities from positions, holds that pull.
//!
//! [`Nodes`] keeps positions where several threads can get at them, with rows of nodes that one thread at a time works on; no order of threads
//! changes a bit, for sums are taken row by row.

use crate::hold::Hold;
use bevy_math::{DVec3, Vec3};
use keyhole_whiteboard::TissueState;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Nodes of a row.
pub(crate) const ROW: usize = 256;

/// Four numbers a node that threads share: a position (m) and what goes with it.
#[derive(Debug, Default)]
pub(crate) struct Shared(Vec<[AtomicU64; 2]>);

impl Clone for Shared {
    /// Nothing is kept there between ticks.
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl Shared {
    pub(crate) fn resize(&mut self, nodes: usize) {
        self.0.resize_with(nodes, Default::default);
    }

    #[inline(always)]
    pub(crate) fn get(&self, node: usize) -> [f32; 4] {
        get(&self.0[node])
    }

    #[inline(always)]
    pub(crate) fn set(&self, node: usize, value: [f32; 4]) {
        set(&self.0[node], value);
    }

    /// The first three numbers.
    #[inline(always)]
    pub(crate) fn point(&self, node: usize) -> Vec3 {
        let [x, y, z, _] = self.get(node);
        Vec3::new(x, y, z)
    }

    /// Changes the first three numbers.
    #[inline(always)]
    pub(crate) fn place(&self, node: usize, point: Vec3) {
        let [.., w] = self.get(node);
        self.set(node, [point.x, point.y, point.z, w]);
    }
}

#[inline(always)]
fn get([a, b]: &[AtomicU64; 2]) -> [f32; 4] {
    let (a, b) = (a.load(Ordering::Relaxed), b.load(Ordering::Relaxed));
    [a as u32, (a >> 32) as u32, b as u32, (b >> 32) as u32].map(f32::from_bits)
}

#[inline(always)]
fn set([a, b]: &[AtomicU64; 2], value: [f32; 4]) {
    let [x, y, z, w] = value.map(|v| u64::from(v.to_bits()));
    a.store(x | y << 32, Ordering::Relaxed);
    b.store(z | w << 32, Ordering::Relaxed);
}

/// What a step keeps of some nodes beside their positions.
#[derive(Clone, Debug, Default)]
pub(crate) struct Row {
    /// The first of them.
    pub(crate) first: usize,
    /// Velocities, m/s.
    pub(crate) velocity: Vec<Vec3>,
    /// Positions at the beginning of the substep, m.
    pub(crate) before: Vec<Vec3>,
    /// Nodes that are driven: which, from where and to where.
    driven: Vec<(usize, Vec3, Vec3)>,
    /// Sum over the nodes of mass times what is asked for, and of the masses.
    pub(crate) sum: (DVec3, f64),
    /// More vectors a node, for those that want them.
    pub(crate) extra: [Vec<Vec3>; 3],
}

/// The nodes of an organ during a tick.
#[derive(Debug, Default)]
pub(crate) struct Nodes {
    /// Positions, and inverse masses (1/kg): 0 for what is driven and for slots that nothing uses.
    pub(crate) at: Shared,
    rows: Vec<Mutex<Row>>,
    /// Where positions are counted from, m: far from the world's origin a difference of positions has too few digits for a velocity.
    origin: Vec3,
    /// What [`Nodes::average`] found last.
    mean: Mutex<Vec3>,
    /// Whether nothing holds it: then drag takes nothing of its mean velocity.
    pub(crate) free: bool,
}

impl Clone for Nodes {
    /// Nothing is kept there between ticks.
    fn clone(&self) -> Self {
        Self::default()
    }
}

/// What moves nodes in a substep.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fall {
    /// Length of the substep, s.
    pub(crate) h: f32,
    /// m/s2.
    pub(crate) gravity: Vec3,
    /// What drag leaves of a velocity.
    pub(crate) decay: f32,
}

impl Nodes {
    /// Takes a state over.
    pub(crate) fn load(&mut self, masses: &[f32], state: &TissueState, holds: &[Hold]) {
        let count = state.positions.len();
        self.free = holds.is_empty();
        self.at.resize(count);
        self.origin = origin(&state.positions);
        self.rows.resize_with(count.div_ceil(ROW), Mutex::default);
        for (i, x) in state.positions.iter().enumerate() {
            let mass = masses.get(i).copied().unwrap_or(0.0);
            let x = *x - self.origin;
            self.at.set(i, [x.x, x.y, x.z, if mass > 0.0 { 1.0 / mass } else { 0.0 }]);
        }
        for (r, row) in self.rows.iter_mut().enumerate() {
            let row = row.get_mut().unwrap_or_else(PoisonError::into_inner);
            let nodes = r * ROW..count.min((r + 1) * ROW);
            row.first = nodes.start;
            row.velocity.clear();
            row.velocity.extend_from_slice(&state.velocities[nodes.clone()]);
            row.before.clear();
            row.before.resize(nodes.len(), Vec3::ZERO);
            row.driven.clear();
        }
        for hold in holds {
            if let Some(i) = hold.fixes() {
                let x = state.positions[i] - self.origin;
                self.at.set(i, [x.x, x.y, x.z, 0.0]);
                self.row(i / ROW).driven.push((i % ROW, x, hold.to - self.origin));
            }
        }
    }

    /// Hands the state back.
    pub(crate) fn store(&mut self, state: &mut TissueState) {
        for (i, x) in state.positions.iter_mut().enumerate() {
            *x = self.at.point(i) + self.origin;
        }
        for row in &mut self.rows {
            let row = row.get_mut().unwrap_or_else(PoisonError::into_inner);
            state.velocities[row.first..row.first + row.velocity.len()].copy_from_slice(&row.velocity);
        }
    }

    /// Number of rows.
    pub(crate) fn rows(&self) -> usize {
        self.rows.len()
    }

    /// A row; one thread at a time has it.
    pub(crate) fn row(&self, r: usize) -> MutexGuard<'_, Row> {
        self.rows[r].lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Finds the mean of what every row summed up.
    pub(crate) fn average(&self) {
        let (sum, mass) = (0..self.rows()).map(|r| self.row(r).sum).fold((DVec3::ZERO, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
        *self.mean.lock().unwrap_or_else(PoisonError::into_inner) = if mass > 0.0 { (sum / mass).as_vec3() } else { Vec3::ZERO };
    }

    /// What [`Nodes::average`] found; zero for what is held.
    pub(crate) fn mean(&self) -> Vec3 {
        if self.free { *self.mean.lock().unwrap_or_else(PoisonError::into_inner) } else { Vec3::ZERO }
    }

    /// Velocities of a row from the way since its substep began, over `h` s.
    pub(crate) fn finish(&self, row: &mut Row, h: f32) {
        let rate = 1.0 / h;
        for ((v, b), at) in row.velocity.iter_mut().zip(&row.before).zip(&self.at.0[row.first..]) {
            let [x, y, z, _] = get(at);
            *v = (Vec3::new(x, y, z) - *b) * rate;
        }
    }

    /// Begins a substep: where inertia and gravity take the nodes of a row, and where those that are driven are at the part `s` of the tick.
    pub(crate) fn begin(&self, row: &mut Row, drift: Vec3, fall: Fall, s: f32) {
        let Fall { h, gravity, decay } = fall;
        let fallen = (drift - drift * decay + gravity * h) * h;
        for ((v, b), at) in row.velocity.iter().zip(&mut row.before).zip(&self.at.0[row.first..]) {
            let [x, y, z, w] = get(at);
            *b = Vec3::new(x, y, z);
            // Written whether it moves or not: a branch costs more.
            let moved = *b + if w > 0.0 { *v * (decay * h) + fallen } else { Vec3::ZERO };
            set(at, [moved.x, moved.y, moved.z, w]);
        }
        self.drive(row, s);
    }

    /// Puts the driven nodes of a row where they are at the part `s` of the tick.
    pub(crate) fn drive(&self, row: &Row, s: f32) {
        for (i, from, to) in &row.driven {
            self.at.place(row.first + i, from.lerp(*to, s));
        }
    }

    /// Sums a quantity of the nodes of a row, weighted by their masses (kg).
    pub(crate) fn sum(row: &mut Row, masses: &[f32], of: impl Fn(&Row, usize) -> Vec3) {
        let (mut sum, mut mass) = (DVec3::ZERO, 0.0);
        for i in 0..row.velocity.len() {
            if let Some(m) = masses.get(row.first + i).filter(|m| **m > 0.0) {
                sum += of(row, i).as_dvec3() * f64::from(*m);
                mass += f64::from(*m);
            }
        }
        row.sum = (sum, mass);
    }

    /// From the anchor of a hold to its point, m.
    pub(crate) fn gap(&self, hold: &Hold, s: f32) -> Vec3 {
        hold.gap(s, self.origin, |i| self.at.point(i))
    }

    /// A hold as a constraint of three dimensions: its point less its anchor.
    pub(crate) fn pull(&self, hold: &Hold, s: f32, h: f32) {
        let moved = hold.step(self.gap(hold, s), h, |i| self.at.get(i)[3]);
        for (node, weight) in &hold.point {
            let i = node.index();
            self.at.place(i, self.at.point(i) + moved * (self.at.get(i)[3] * weight));
        }
    }
}

/// A point near an organ: the world's origin, unless the organ is many times its size away from it; a multiple of a power of two, so that what is counted
/// from there loses no digit.
fn origin(positions: &[Vec3]) -> Vec3 {
    let (low, high) = positions.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), x| (l.min(*x), h.max(*x)));
    let step = (4.0 * (high - low).max_element()).log2().ceil().exp2();
    let near = ((low + high) * (0.5 / step)).round() * step;
    if near.is_finite() { near } else { Vec3::ZERO }
}

/// Single nodes held without compliance: their slots, where they are and where they go in this tick.
pub(crate) fn driven(holds: &[Hold], positions: &[Vec3]) -> Vec<(usize, Vec3, Vec3)> {
    holds.iter().filter_map(|hold| hold.fixes().map(|i| (i, positions[i], hold.to))).collect()
}

/// Inverse masses, 1/kg; 0 for what is driven and for slots that nothing uses.
pub(crate) fn inverse_masses(masses: &[f32], driven: &[(usize, Vec3, Vec3)]) -> Vec<f32> {
    let mut inverse: Vec<f32> = masses.iter().map(|m| if *m > 0.0 { 1.0 / m } else { 0.0 }).collect();
    for (i, ..) in driven {
        inverse[*i] = 0.0;
    }
    inverse
}

/// What drag takes nothing of: the mean velocity of a body that nothing holds, m/s.
pub(crate) fn drift(masses: &[f32], velocities: &[Vec3], holds: &[Hold]) -> Vec3 {
    if holds.is_empty() { mean(masses, velocities.iter().copied()) } else { Vec3::ZERO }
}

/// The mean of a quantity of the nodes, weighted by their masses.
pub(crate) fn mean(masses: &[f32], values: impl Iterator<Item = Vec3>) -> Vec3 {
    let (mut sum, mut mass) = (DVec3::ZERO, 0.0);
    for (m, v) in masses.iter().zip(values).filter(|(m, _)| **m > 0.0) {
        sum += v.as_dvec3() * f64::from(*m);
        mass += f64::from(*m);
    }
    if mass > 0.0 { (sum / mass).as_vec3() } else { Vec3::ZERO }
}

impl Hold {
    /// From the anchor at the part `s` of the tick to the point, m; positions are counted from `origin`. The weights sum to one, or to zero: then the anchor
    /// is a way from one point to another, wherever the origin is.
    pub(crate) fn gap(&self, s: f32, origin: Vec3, position: impl Fn(usize) -> Vec3) -> Vec3 {
        let sum: f32 = self.point.iter().map(|(_, weight)| weight).sum();
        let point: Vec3 = self.point.iter().map(|(node, weight)| position(node.index()) * *weight).sum();
        point - (self.from.lerp(self.to, s) - origin * sum.round())
    }

    /// What closes the gap in a substep of `h` s: every node moves by this times its inverse mass and its weight.
    pub(crate) fn step(&self, gap: Vec3, h: f32, inverse_mass: impl Fn(usize) -> f32) -> Vec3 {
        let w: f32 = self.point.iter().map(|(node, weight)| inverse_mass(node.index()) * weight * weight).sum();
        if w > 0.0 { -gap / (w + self.compliance_m_n.max(0.0) / (h * h)) } else { Vec3::ZERO }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Taking a state over and handing it back changes no bit, near the origin and far from it.
    #[test]
    fn an_origin_loses_no_digit() {
        for offset in [Vec3::ZERO, Vec3::new(0.1, -0.2, 0.05), Vec3::new(5.1, -700.3, 0.4)] {
            let positions: Vec<Vec3> = (0..500).map(|i| offset + Vec3::new(0.06, 0.03, 0.01) * (i as f32 * 0.37).sin()).collect();
            let mut state = TissueState { velocities: vec![Vec3::X; positions.len()], positions };
            let before = state.positions.clone();
            let mut nodes = Nodes::default();
            nodes.load(&vec![1.0; before.len()], &state, &[]);
            nodes.store(&mut state);
            assert_eq!(state.positions, before);
            assert!(nodes.origin.distance(offset) <= 0.5, "{offset}: {}", nodes.origin);
        }
    }
}
