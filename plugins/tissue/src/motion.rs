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
    /// Some nodes at the origin.
    pub(crate) fn of(nodes: usize) -> Self {
        let mut new = Self::default();
        new.resize(nodes);
        new
    }

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
        self.rows.resize_with(count.div_ceil(ROW), Mutex::default);
        for (i, x) in state.positions.iter().enumerate() {
            let mass = masses.get(i).copied().unwrap_or(0.0);
            self.at.set(i, [x.x, x.y, x.z, if mass > 0.0 { 1.0 / mass } else { 0.0 }]);
        }
        for (r, row) in self.rows.iter_mut().enumerate() {
            let row = row.get_mut().unwrap_or_else(PoisonError::into_inner);
            let nodes = r * ROW..count.min((r + 1) * ROW);
            row.first = nodes.start;
            row.velocity.clear();
            row.velocity.extend_from_slice(&state.velocities[nodes.clone()]);
            row.before.clear();
            row.before.extend_from_slice(&state.positions[nodes]);
            row.driven.clear();
        }
        for hold in holds {
            if let Some(i) = hold.fixes() {
                let x = state.positions[i];
                self.at.set(i, [x.x, x.y, x.z, 0.0]);
                self.row(i / ROW).driven.push((i % ROW, x, hold.to));
            }
        }
    }

    /// Hands the state back.
    pub(crate) fn store(&mut self, state: &mut TissueState) {
        for (i, x) in state.positions.iter_mut().enumerate() {
            *x = self.at.point(i);
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

    /// The mean of what every row summed up.
    pub(crate) fn mean(&self) -> Vec3 {
        let (sum, mass) = (0..self.rows()).map(|r| self.row(r).sum).fold((DVec3::ZERO, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
        if mass > 0.0 { (sum / mass).as_vec3() } else { Vec3::ZERO }
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

    /// A hold as a constraint of three dimensions: its point less its anchor.
    pub(crate) fn pull(&self, hold: &Hold, s: f32, h: f32) {
        let moved = step_of(hold, s, h, |i| self.at.point(i), |i| self.at.get(i)[3]);
        for (node, weight) in &hold.point {
            let i = node.index();
            self.at.place(i, self.at.point(i) + moved * (self.at.get(i)[3] * weight));
        }
    }
}

/// By how much times inverse mass and weight the nodes of a hold move.
pub(crate) fn step_of(hold: &Hold, s: f32, h: f32, position: impl Fn(usize) -> Vec3, inverse_mass: impl Fn(usize) -> f32) -> Vec3 {
    let mut gap = -hold.from.lerp(hold.to, s);
    let mut w = 0.0;
    for (node, weight) in &hold.point {
        gap += position(node.index()) * *weight;
        w += inverse_mass(node.index()) * weight * weight;
    }
    if w > 0.0 { -gap / (w + hold.compliance_m_n.max(0.0) / (h * h)) } else { Vec3::ZERO }
}
