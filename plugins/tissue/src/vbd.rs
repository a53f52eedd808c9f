//! Vertex block descent (Chen, Liu, Yang, Yuksel 2024, arXiv:2403.06321): a step of backward Euler as the minimum of
//! `sum m |x - y|^2 / 2h^2 + E(x)`, `y` where inertia and gravity would take a node, found node by node. The energy of [`crate::NeoHookean`] is quadratic in one node,
//! for its determinant is linear in it: the 3x3 system of a node has its exact minimum, is positive definite whatever the deformation, and no
//! sweep raises the sum.
//!
//! Nodes of one colour share no element. After a topology change only the touched nodes get new colours. A step begins where the velocity and as much of
//! gravity as was felt in the last step lead (the paper's adaptive start). Sweeps are accelerated by Chebyshev's method where that is asked for.
//!
//! Few iterations are a softer material: a sweep spreads force by one ring of elements.

use crate::body::Body;
use crate::element::cofactor;
use crate::hold::Hold;
use crate::membrane::Membrane;
use crate::model::{drift, driven, inverse_masses, mean};
use bevy_math::{Mat3, Vec3};
use keyhole_tetmesh::{NodeEdit, NodeId, TetId, TetMesh, TopologyDelta};
use keyhole_whiteboard::TissueState;
use rustc_hash::FxHashMap;
use smallvec::SmallVec;

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

const NONE: u16 = u16::MAX;

/// A hold of several nodes without compliance is a spring this many times as stiff as its nodes.
const RIGID: f32 = 100.0;

/// Nodes by colour, and the elements around each.
#[derive(Clone, Debug, Default)]
pub struct Vbd {
    /// Element slot and corner, by node slot.
    around: Vec<SmallVec<[(u32, u8); 24]>>,
    /// Corners by element slot, as they were when the element came.
    corners: Vec<[u32; 4]>,
    colours: Vec<Vec<u32>>,
    /// Colour of each node slot.
    of: Vec<u16>,
    /// Place of each node slot in the list of its colour.
    place: Vec<u32>,
    /// Velocities at the beginning of the last substep, m/s.
    earlier: Vec<Vec3>,
}

impl Vbd {
    /// The model of a mesh.
    #[must_use]
    pub fn new(mesh: &TetMesh) -> Self {
        let mut model = Self::default();
        for (tet, corners) in mesh.iter() {
            model.note(tet, corners);
        }
        model.refresh(mesh, &mesh.nodes().collect::<Vec<_>>());
        model
    }

    /// The nodes of each colour.
    #[must_use]
    pub fn colours(&self) -> &[Vec<u32>] {
        &self.colours
    }

    /// Carries it over a topology change: new colours for the nodes of what came or went, and for no other.
    pub fn adopt(&mut self, mesh: &TetMesh, delta: &TopologyDelta) {
        let mut nodes: Vec<NodeId> = Vec::new();
        for tet in &delta.removed {
            nodes.extend(self.corners.get(tet.index()).into_iter().flatten().map(|n| NodeId(*n)));
        }
        for added in &delta.added {
            self.note(added.tet, added.nodes);
            nodes.extend(added.nodes);
        }
        nodes.sort_unstable();
        nodes.dedup();
        self.refresh(mesh, &nodes);
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

    /// Elements and colours of some nodes, ascending, from the mesh.
    fn refresh(&mut self, mesh: &TetMesh, nodes: &[NodeId]) {
        if self.around.len() < mesh.node_slots() {
            self.around.resize(mesh.node_slots(), SmallVec::new());
            self.of.resize(mesh.node_slots(), NONE);
            self.place.resize(mesh.node_slots(), 0);
        }
        for node in nodes {
            let mut list: SmallVec<[(u32, u8); 24]> = SmallVec::new();
            for tet in mesh.topology().around_node(*node) {
                let corner = mesh.corners(*tet).iter().position(|n| n == node).unwrap_or(0);
                list.push((tet.0, corner as u8));
            }
            list.sort_unstable();
            self.around[node.index()] = list;
            self.uncolour(node.index());
        }
        for node in nodes.iter().filter(|n| !self.around[n.index()].is_empty()).collect::<Vec<_>>() {
            self.colour(mesh, *node);
        }
    }

    /// The smallest colour that no neighbour has.
    fn colour(&mut self, mesh: &TetMesh, node: NodeId) {
        let mut used = vec![false; self.colours.len() + 1];
        for tet in mesh.topology().around_node(node) {
            for n in mesh.corners(*tet) {
                if let Some(c) = self.of.get(n.index()).filter(|c| **c != NONE) {
                    used[usize::from(*c)] = true;
                }
            }
        }
        let colour = used.iter().position(|u| !u).unwrap_or(self.colours.len());
        if colour == self.colours.len() {
            self.colours.push(Vec::new());
        }
        self.of[node.index()] = colour as u16;
        self.place[node.index()] = self.colours[colour].len() as u32;
        self.colours[colour].push(node.0);
    }

    fn uncolour(&mut self, node: usize) {
        let colour = std::mem::replace(&mut self.of[node], NONE);
        if colour == NONE {
            return;
        }
        let list = &mut self.colours[usize::from(colour)];
        let place = self.place[node] as usize;
        list.swap_remove(place);
        if let Some(moved) = list.get(place) {
            self.place[*moved as usize] = place as u32;
        }
    }

    /// Steps a body over one tick of `dt` s under gravity (m/s2) with this drag (1/s).
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
    ) {
        let n = settings.substeps.max(1);
        let h = dt / n as f32;
        let driven = driven(holds, &state.positions);
        let inverse = inverse_masses(body.masses(), &driven);
        let mut pulled: FxHashMap<u32, Vec<(usize, f32)>> = FxHashMap::default();
        for (i, hold) in holds.iter().enumerate().filter(|(_, hold)| hold.fixes().is_none()) {
            for (node, weight) in &hold.point {
                pulled.entry(node.0).or_default().push((i, *weight));
            }
        }
        let decay = (-drag_1_s * h).exp();
        let count = state.positions.len();
        self.earlier.resize(count, Vec3::ZERO);
        let towards = gravity.normalize_or_zero();
        let (mut goal, mut before) = (vec![Vec3::ZERO; count], vec![Vec3::ZERO; count]);
        let (mut last, mut second_last) = (vec![Vec3::ZERO; count], vec![Vec3::ZERO; count]);
        for substep in 0..n {
            let s = (substep + 1) as f32 / n as f32;
            before.copy_from_slice(&state.positions);
            let drift = drift(body.masses(), &state.velocities, holds);
            for i in (0..count).filter(|i| inverse[*i] > 0.0) {
                let felt = ((state.velocities[i] - self.earlier[i]) / h).dot(towards).clamp(0.0, gravity.length());
                self.earlier[i] = state.velocities[i];
                let v = drift + (state.velocities[i] - drift) * decay;
                goal[i] = before[i] + (v + gravity * h) * h;
                state.positions[i] = before[i] + (v + towards * (felt * h)) * h;
            }
            for (i, from, to) in &driven {
                state.positions[*i] = from.lerp(*to, s);
            }
            let mut omega = 1.0;
            for iteration in 0..settings.iterations.max(1) {
                second_last.copy_from_slice(&last);
                last.copy_from_slice(&state.positions);
                for colour in &self.colours {
                    for &node in colour {
                        let i = node as usize;
                        if inverse[i] > 0.0 {
                            let springs = pulled.get(&node).map_or(&[][..], Vec::as_slice);
                            self.solve(body, membrane, &mut state.positions, i, goal[i], h, holds, springs, s);
                        }
                    }
                }
                // Chebyshev's weights, from the third iterate on.
                let rho2 = settings.chebyshev * settings.chebyshev;
                omega = match iteration {
                    0 => 1.0,
                    1 => 2.0 / (2.0 - rho2),
                    _ => 4.0 / (4.0 - rho2 * omega),
                };
                if settings.chebyshev > 0.0 && iteration > 0 {
                    for i in (0..count).filter(|i| inverse[*i] > 0.0) {
                        state.positions[i] = (state.positions[i] - second_last[i]) * omega + second_last[i];
                    }
                }
            }
            // Inner forces move no centre of mass; sweeps that have not converged do.
            let off = if holds.is_empty() {
                let gap = state.positions.iter().zip(&goal).map(|(x, y)| *x - *y);
                // Of a free fall the place at the end of a step is half a step's fall ahead.
                mean(body.masses(), gap) + gravity * (0.5 * h * h)
            } else {
                Vec3::ZERO
            };
            let ahead = if holds.is_empty() { gravity * (0.5 * h * h) } else { Vec3::ZERO };
            for ((x, v), b) in state.positions.iter_mut().zip(&mut state.velocities).zip(&before) {
                *x -= off;
                *v = (*x + ahead - *b) / h;
            }
        }
    }

    /// The minimum over one node.
    #[inline]
    fn solve(
        &self,
        body: &Body,
        membrane: Option<&Membrane>,
        x: &mut [Vec3],
        i: usize,
        goal: Vec3,
        h: f32,
        holds: &[Hold],
        springs: &[(usize, f32)],
        s: f32,
    ) {
        let inertia = body.masses()[i] / (h * h);
        let mut right = (goal - x[i]) * inertia;
        let mut matrix = Mat3::from_diagonal(Vec3::splat(inertia));
        for (slot, corner) in &self.around[i] {
            let e = &body.elements()[*slot as usize];
            let f = e.deformation(e.indices().map(|n| x[n]));
            let c = cofactor(f);
            let rows = e.inverse_rest.transpose();
            let g = match corner {
                0 => -(rows.x_axis + rows.y_axis + rows.z_axis),
                1 => rows.x_axis,
                2 => rows.y_axis,
                _ => rows.z_axis,
            };
            let (mu, lambda) = (e.material.mu * e.volume, e.material.lambda * e.volume);
            let by_node = c * g;
            let pressure = lambda * (f.x_axis.dot(c.x_axis) - 1.0) - mu;
            right -= f * g * mu + by_node * pressure;
            let stiff = by_node * lambda;
            let diagonal = mu * g.length_squared();
            matrix.x_axis += stiff * by_node.x + Vec3::X * diagonal;
            matrix.y_axis += stiff * by_node.y + Vec3::Y * diagonal;
            matrix.z_axis += stiff * by_node.z + Vec3::Z * diagonal;
        }
        for (triangle, corner) in membrane.iter().flat_map(|m| m.around(i)) {
            let (force, stiffness) = triangle.at_node(triangle.nodes.map(|n| x[n as usize].as_dvec3()), corner);
            right += force.as_vec3();
            matrix += stiffness.as_mat3();
        }
        for (hold, weight) in springs {
            let hold = &holds[*hold];
            let around = matrix.x_axis.x.max(matrix.y_axis.y).max(matrix.z_axis.z);
            let k = if hold.compliance_m_n * RIGID * around > 1.0 { 1.0 / hold.compliance_m_n } else { RIGID * around };
            let gap = hold.point.iter().map(|(n, w)| x[n.index()] * *w).sum::<Vec3>() - hold.from.lerp(hold.to, s);
            right -= gap * (k * weight);
            matrix += Mat3::from_diagonal(Vec3::splat(k * weight * weight));
        }
        let step = matrix.inverse() * right;
        if step.is_finite() {
            x[i] += step;
        }
    }
}
