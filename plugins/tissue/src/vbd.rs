//! Vertex block descent (Chen, Liu, Yang, Yuksel 2024, arXiv:2403.06321): a step of backward Euler as the minimum of
//! `sum m |x - y|^2 / 2h^2 + E(x)`, `y` where inertia and gravity would take a node, found node by node. The energy of [`crate::NeoHookean`] is quadratic in one node,
//! for its determinant is linear in it: the 3x3 system of a node has its exact minimum, is positive definite whatever the deformation, and no
//! sweep raises the sum.
//!
//! Nodes are moved one after the other within a part of the organ, and parts that share no element at the same time; the elements around a node are
//! looked at eight at a time (`lanes_rows.rs`). After a topology change only the parts of the touched nodes are looked at. A step begins where the velocity and as much of
//! gravity as was felt in the last step lead (the paper's adaptive start). Sweeps are accelerated by Chebyshev's method where that is asked for.
//!
//! Few iterations are a softer material: a sweep spreads force by one ring of elements.

use crate::body::Body;
use crate::hold::Hold;
use crate::lanes;
use crate::lanes_crew::Crew;
use crate::lanes_rows::Rows;
use crate::membrane::Membrane;
use crate::motion::{Fall, Nodes, Row, Shared};
use crate::press::Presses;
use bevy_math::{Mat3, Vec3};
use keyhole_tetmesh::{NodeEdit, NodeId, TetId, TetMesh, TopologyDelta};
use keyhole_whiteboard::{Contact, TissueState};
use std::sync::{Mutex, PoisonError};

/// Settings of [`crate::TissueModel::Vbd`].
///
/// Limits, by `keyhole study stability` on a beam of 270 tetrahedra: nothing made it leave the finite numbers or gain energy there; but the
/// filmed beam of `keyhole study trade --data` (264 kPa, nu 0.499, 3600 tetrahedra, a load at its end) was thrown about by accelerated sweeps. At nu 0.4999 it creeps back; all nodes
/// in one point are an equilibrium that it does not leave; inside out or scrambled it stays tangled with 4 substeps, and comes back with one of 20 sweeps,
/// which takes more energy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VbdSettings {
    /// Substeps of one tick; 0 counts as 1. Default 4.
    pub substeps: u32,
    /// Sweeps of a substep; 0 counts as 1. Default 20.
    pub iterations: u32,
    /// Estimate of the factor by which a sweep lowers the error, in [0, 1): 0 does without acceleration. Default 0.9. Above 0.97 it shakes what is cut or torn.
    pub chebyshev: f32,
}

impl Default for VbdSettings {
    fn default() -> Self {
        Self { substeps: 4, iterations: 20, chebyshev: 0.9 }
    }
}

/// A hold of several nodes without compliance is a spring this many times as stiff as its nodes.
const RIGID: f32 = 100.0;

/// Nodes that are worth a second thread, and a further one each.
const WORTH: usize = 400;

/// The nodes of an organ with what is around each, and how they moved.
#[derive(Clone, Debug, Default)]
pub struct Vbd {
    rows: Rows,
    /// Corners by element slot, as they were when the element came.
    corners: Vec<[u32; 4]>,
    /// Velocities at the beginning of the last substep, m/s.
    earlier: Vec<Vec3>,
    nodes: Nodes,
    /// Where inertia and gravity take each node, m.
    goals: Shared,
    crew: Crew,
    /// Nodes that holds pull, ascending, with the hold and the weight.
    pulled: Vec<(u32, u32, f32)>,
}

impl Vbd {
    /// The model of a mesh and its body.
    #[must_use]
    pub fn new(body: &Body, mesh: &TetMesh) -> Self {
        let mut model = Self { rows: Rows::new(mesh, body.elements()), ..Self::default() };
        for (tet, corners) in mesh.iter() {
            model.note(tet, corners);
        }
        model
    }

    /// Carries it over a topology change: what is around the nodes of what came, went or changed shape, in the parts that they are in, and no more.
    pub fn adopt(&mut self, body: &Body, mesh: &TetMesh, delta: &TopologyDelta) {
        let mut nodes: Vec<NodeId> = Vec::new();
        for tet in &delta.removed {
            nodes.extend(self.corners.get(tet.index()).into_iter().flatten().map(|n| NodeId(*n)));
        }
        for added in &delta.added {
            self.note(added.tet, added.nodes);
            nodes.extend(added.nodes);
        }
        nodes.extend(delta.reshaped(mesh.topology()).iter().flat_map(|t| mesh.corners(*t)));
        nodes.sort_unstable();
        nodes.dedup();
        self.rows.adopt(&nodes, mesh, body.elements());
        // A node that is new, or whose slot is used again, has no earlier velocity.
        for edit in &delta.nodes {
            if let NodeEdit::Added { node, .. } | NodeEdit::Split { node, .. } = edit
                && let Some(v) = self.earlier.get_mut(node.index())
            {
                *v = Vec3::ZERO;
            }
        }
    }

    fn note(&mut self, tet: TetId, corners: [NodeId; 4]) {
        if self.corners.len() <= tet.index() {
            self.corners.resize(tet.index() + 1, [0; 4]);
        }
        self.corners[tet.index()] = corners.map(|n| n.0);
    }

    /// Steps a body over one tick of `dt` s under gravity (m/s2) with this drag (1/s), and writes the forces at its contacts down.
    pub fn step(
        &mut self,
        settings: &VbdSettings,
        body: &Body,
        membrane: Option<&Membrane>,
        state: &mut TissueState,
        holds: &[Hold],
        gravity: Vec3,
        dt: f32,
        drag_1_s: f32,
        contacts: &mut [Contact],
    ) {
        let Self { rows, earlier, nodes, goals, crew, pulled, .. } = self;
        nodes.load(body.masses(), state, holds);
        nodes.free &= contacts.is_empty();
        let presses = Mutex::new(Presses::new(body, contacts, |i| nodes.at.point(i)));
        earlier.resize(state.positions.len(), Vec3::ZERO);
        goals.resize(state.positions.len());
        pulled.clear();
        for (i, hold) in holds.iter().enumerate().filter(|(_, hold)| hold.fixes().is_none()) {
            pulled.extend(hold.point.iter().map(|(node, weight)| (node.0, i as u32, *weight)));
        }
        pulled.sort_unstable_by_key(|(node, hold, _)| (*node, *hold));
        let touched = !contacts.is_empty();
        let count = nodes.rows();
        for r in 0..count {
            let row = &mut *nodes.row(r);
            let own = &earlier[row.first..row.first + row.velocity.len()];
            row.extra[EARLIER].clear();
            row.extra[EARLIER].extend_from_slice(own);
        }
        let (n, sweeps) = (settings.substeps.max(1) as usize, settings.iterations.max(1) as usize);
        let h = dt / n as f32;
        let tick =
            Tick { nodes, goals, fall: Fall { h, gravity, decay: (-drag_1_s * h).exp() }, masses: body.masses(), membrane, holds, pulled };
        // A substep: the mean velocity, the beginning; sweeps of the colours of parts, the nodes that are pulled, the acceleration; the mean error, the end.
        let colours = rows.colours();
        let sweep = colours + 2;
        let period = sweeps * sweep + 4;
        let free = nodes.free;
        let tasks = |step: usize| match step % period {
            0 => usize::from(free),
            1 => count,
            k if k == period - 1 => count,
            k if k == period - 2 => usize::from(free || touched),
            k => match (k - 2) % sweep {
                c if c < colours => rows.parts(c),
                c if c == colours => usize::from(!pulled.is_empty()),
                _ if settings.chebyshev > 0.0 => count,
                _ => 0,
            },
        };
        let task = |step: usize, i: usize, near: &mut lanes::Nodes| {
            let s = (step / period + 1) as f32 / n as f32;
            match step % period {
                0 => {
                    (0..count).for_each(|r| Nodes::sum(&mut nodes.row(r), tick.masses, |row, i| row.velocity[i]));
                    nodes.average();
                }
                1 => tick.begin(&mut nodes.row(i), nodes.mean(), s),
                k if k == period - 1 => tick.finish(&mut nodes.row(i), nodes.mean()),
                k if k == period - 2 => {
                    let gap = |row: &Row, i: usize| nodes.at.point(row.first + i) - goals.point(row.first + i);
                    (0..count).for_each(|r| Nodes::sum(&mut nodes.row(r), tick.masses, gap));
                    nodes.average();
                    let place = |i: usize| (nodes.at.point(i), nodes.at.get(i)[3]);
                    let shift = |i: usize, by| nodes.at.place(i, nodes.at.point(i) + by);
                    presses.lock().unwrap_or_else(PoisonError::into_inner).push_out(h, s * dt, place, shift);
                }
                k => match ((k - 2) / sweep, (k - 2) % sweep) {
                    (_, c) if c < colours => rows.sweep(c, i, &tick, near),
                    (_, c) if c == colours => {
                        for own in pulled.chunk_by(|a, b| a.0 == b.0) {
                            rows.alone(own, s, &tick, near);
                        }
                    }
                    (iteration, _) => tick.accelerate(&mut nodes.row(i), weight(settings.chebyshev, iteration)),
                },
            }
        };
        let workers = (state.positions.len() / WORTH).clamp(1, rayon::current_num_threads());
        crew.run(workers, n * period, tasks, task);
        for r in 0..count {
            let row = nodes.row(r);
            earlier[row.first..row.first + row.velocity.len()].copy_from_slice(&row.extra[EARLIER]);
        }
        nodes.store(state);
        presses.into_inner().unwrap_or_else(PoisonError::into_inner).write(contacts, dt);
    }
}

/// Where [`Row::extra`] has the velocities a substep ago; after them are the positions one and two sweeps ago.
const EARLIER: usize = 0;

/// Chebyshev's weight of a sweep: 1 is none.
fn weight(rate: f32, iteration: usize) -> f32 {
    let square = rate * rate;
    (0..iteration).fold(1.0, |omega, i| if i == 0 { 2.0 / (2.0 - square) } else { 4.0 / (4.0 - square * omega) })
}

/// What nodes are moved by in a tick.
pub(crate) struct Tick<'a> {
    pub(crate) nodes: &'a Nodes,
    pub(crate) goals: &'a Shared,
    fall: Fall,
    pub(crate) masses: &'a [f32],
    membrane: Option<&'a Membrane>,
    holds: &'a [Hold],
    pulled: &'a [(u32, u32, f32)],
}

impl Tick<'_> {
    /// Where inertia and gravity take the nodes of a row, and where they begin.
    fn begin(&self, row: &mut Row, drift: Vec3, s: f32) {
        let Fall { h, gravity, decay } = self.fall;
        let towards = gravity.normalize_or_zero();
        for i in 0..row.velocity.len() {
            let [x, y, z, w] = self.nodes.at.get(row.first + i);
            let (before, velocity) = (Vec3::new(x, y, z), row.velocity[i]);
            row.before[i] = before;
            if w > 0.0 {
                let felt = ((velocity - row.extra[EARLIER][i]) / h).dot(towards).clamp(0.0, gravity.length());
                row.extra[EARLIER][i] = velocity;
                let v = drift + (velocity - drift) * decay;
                self.goals.place(row.first + i, before + (v + gravity * h) * h);
                self.nodes.at.place(row.first + i, before + (v + towards * (felt * h)) * h);
            }
        }
        self.nodes.drive(row, s);
        let Row { first, velocity, extra: [_, last, second_last], .. } = row;
        last.clear();
        last.extend((0..velocity.len()).map(|i| self.nodes.at.point(*first + i)));
        second_last.clone_from(last);
    }

    /// Goes on from two sweeps ago through where this one came to.
    fn accelerate(&self, row: &mut Row, omega: f32) {
        let Row { first, extra: [_, last, second_last], .. } = row;
        for (i, (last, second_last)) in last.iter_mut().zip(second_last).enumerate() {
            let [x, y, z, w] = self.nodes.at.get(*first + i);
            let mut new = Vec3::new(x, y, z);
            if w > 0.0 && omega > 1.0 {
                new = (new - *second_last) * omega + *second_last;
                self.nodes.at.set(*first + i, [new.x, new.y, new.z, w]);
            }
            (*second_last, *last) = (*last, new);
        }
    }

    /// Velocities. Inner forces move no centre of mass; sweeps that have not converged do, by `off` in the mean of a body that nothing holds. Of a free fall
    /// the place at the end of a step is half a step's fall ahead.
    fn finish(&self, row: &mut Row, off: Vec3) {
        let h = self.fall.h;
        let ahead = if self.nodes.free { self.fall.gravity * (0.5 * h * h) } else { Vec3::ZERO };
        let off = if self.nodes.free { off + ahead } else { Vec3::ZERO };
        for (i, (v, b)) in row.velocity.iter_mut().zip(&row.before).enumerate() {
            let x = self.nodes.at.point(row.first + i) - off;
            self.nodes.at.place(row.first + i, x);
            *v = (x + ahead - *b) / h;
        }
    }

    /// Whether a node moves in the sweeps of the parts.
    #[inline(always)]
    pub(crate) fn moves(&self, node: u32, inverse_mass: f32) -> bool {
        inverse_mass > 0.0 && (self.pulled.is_empty() || self.pulled.binary_search_by_key(&node, |p| p.0).is_err())
    }

    /// How a node moves whose elements push it by `force` (N) and resist by `matrix` (N/m).
    pub(crate) fn step(&self, node: u32, x: Vec3, force: Vec3, matrix: Mat3, pulled: &[(u32, u32, f32)], s: f32) -> Vec3 {
        let i = node as usize;
        let inertia = self.masses[i] / (self.fall.h * self.fall.h);
        let mut right = (self.goals.point(i) - x) * inertia + force;
        let mut matrix = matrix + Mat3::from_diagonal(Vec3::splat(inertia));
        for (triangle, corner) in self.membrane.iter().flat_map(|m| m.around(i)) {
            let (force, stiffness) = triangle.at_node(triangle.nodes.map(|n| self.nodes.at.point(n as usize).as_dvec3()), corner);
            right += force.as_vec3();
            matrix += stiffness.as_mat3();
        }
        for (_, hold, weight) in pulled {
            let hold = &self.holds[*hold as usize];
            let around = matrix.x_axis.x.max(matrix.y_axis.y).max(matrix.z_axis.z);
            let k = if hold.compliance_m_n * RIGID * around > 1.0 { 1.0 / hold.compliance_m_n } else { RIGID * around };
            let gap = self.nodes.gap(hold, s);
            right -= gap * (k * weight);
            matrix += Mat3::from_diagonal(Vec3::splat(k * weight * weight));
        }
        let step = matrix.inverse() * right;
        if step.is_finite() { step } else { Vec3::ZERO }
    }
}
