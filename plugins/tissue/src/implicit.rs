//! The implicit midpoint rule, a little later than the middle, by Newton's method and conjugate gradients.
//!
//! With `h` the substep, `t` slightly above a half, `b` the time of viscosity, `f` the elastic force and `M` the masses, a substep solves
//!
//! `M (u - v) / (t h) = f(X) + M g`, `X = x + (t h + b) u`,
//!
//! for the velocity `u` within it, and then `x += h u`, `v += (u - v) / t`. It is the minimum of `M |X - y|^2 / 2 t h (t h + b) + E(X)` with
//! `y = x + (t h + b) (v + t h g)`, of which one step of Newton's method goes nearly all the way: it starts where
//! the velocity leads. What follows:
//!
//! - Where nothing moves `f + M g = 0`: the equilibrium is that of the mesh, whatever the substep, the tolerance and the iterations.
//! - Motion is right to the second order of `h` but for `t - 1/2`; a mode of angular frequency `w` gets a damping ratio of `(t - 1/2) h w + b w / 2`.
//! - Linear momentum and free fall are exact, and motions too fast for the substep fade.
//!
//! Where the energy is not convex along the way, or a step overshoots, the substep is done again as backward Euler with a convex part of the tangent and as
//! many steps of Newton's method as the energy wants: it goes down, whatever the state.

use crate::body::Body;
use crate::clusters::Clusters;
use crate::element::Element;
use crate::gradients::{Gradients, Spring, Stop, System};
use crate::hold::Hold;
use crate::multilevel::{GRAIN, Multilevel};
use crate::rows::{CHUNK, Chunk, Forces, Inertia, Rows};
use crate::settings::TissueSettings;
use crate::{rescue, xpbd};
use bevy_math::{DVec3, Vec3, Vec3A};
use keyhole_tetmesh::{NodeId, TetId, TetMesh, TopologyDelta};
use keyhole_whiteboard::{TissuePoint, TissueState};
use rayon::prelude::*;

/// Where in the substep the forces are taken; at a half nothing would damp what is too fast for the substep.
const WITHIN: f32 = 0.55;

/// Share of the substep that is the least time of viscosity.
const LEAST_VISCOSITY: f32 = 0.05;

/// A point of several nodes held without compliance is held by a spring this many times as stiff as the tissue at the point.
const STIFF: f32 = 100.0;

/// Root mean square of the displacement, as a share of the body's size, that conjugate gradients do not care about.
const FINE: f64 = 1e-7;

/// How often a step of Newton's method is halved before it is given up.
const HALVINGS: u32 = 10;

/// Most steps of Newton's method of a substep that has to be done carefully.
const CAREFUL_STEPS: u32 = 6;

/// A body is tangled when more than one in so many of its elements is inverted. A few may be a bridge of tissue about to be cut through, torn out of
/// shape by the weight of what hangs on it.
const TANGLED: usize = 400;

/// Most steps of Newton's method of a substep that goes as usual. Nearly always one does.
const USUAL_STEPS: u32 = 3;

/// Share of the square of the residual that a substep may leave.
const ENOUGH: f64 = 0.04;

/// Everything the implicit solver keeps between ticks.
#[derive(Clone, Debug, Default)]
pub struct Implicit {
    pub(crate) rows: Rows,
    pub(crate) clusters: Clusters,
    levels: Multilevel,
    gradients: Gradients,
    /// Where the forces are taken, m.
    x: Vec<Vec3A>,
    /// Where inertia alone would lead, m.
    target: Vec<Vec3A>,
    added: Vec<f32>,
    free: Vec<bool>,
    forces: Vec<Forces>,
    springs: Vec<Spring>,
    /// Fixed nodes and where they were when the tick began, m.
    starts: Vec<(usize, Vec3)>,
    /// Iterations of conjugate gradients of the last tick.
    pub(crate) iterations: u32,
    /// Substeps of the last tick that had to be done carefully.
    pub(crate) careful: u32,
}

/// The numbers of a substep.
#[derive(Clone, Copy, Debug)]
struct Step {
    h: f32,
    within: f32,
    /// `X = x + reach u`, s.
    reach: f32,
    gravity: Vec3,
    /// End of the substep as a share of the tick.
    end: f32,
    /// The substep as a share of the tick.
    share: f32,
}

/// How a substep is done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Care {
    /// One step of Newton's method from where the motion leads.
    Usual,
    /// From where the body is, downhill.
    Downhill,
}

impl Step {
    /// Inertia by mass, 1/s2.
    fn inertia(&self) -> f32 {
        1.0 / (self.within * self.h * self.reach)
    }
}

impl Implicit {
    /// Bytes of all arrays.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.rows.bytes()
            + self.clusters.bytes()
            + self.levels.bytes()
            + self.gradients.bytes()
            + 16 * (self.x.capacity() + self.target.capacity())
            + 5 * self.added.capacity()
            + self.forces.capacity() * size_of::<Forces>()
    }

    /// Builds rows and clusters of a mesh with these elements.
    pub(crate) fn build(&mut self, mesh: &TetMesh, elements: &[Element]) {
        for (tet, _) in mesh.iter() {
            self.rows.set_element(tet, &elements[tet.index()]);
        }
        self.rows.rebuild(&mesh.nodes().collect::<Vec<_>>(), mesh, elements);
        self.clusters = Clusters::new(mesh, &self.rows);
    }

    /// Carries rows and clusters over a topology change: `mesh` and `elements` are those after it, `touched` the nodes around what changed, ascending.
    pub(crate) fn adopt(&mut self, mesh: &TetMesh, elements: &[Element], delta: &TopologyDelta, reshaped: &[TetId], touched: &[NodeId]) {
        for tet in reshaped.iter().copied().chain(delta.added.iter().map(|a| a.tet)) {
            self.rows.set_element(tet, &elements[tet.index()]);
        }
        self.rows.rebuild(touched, mesh, elements);
        self.clusters.adopt(mesh, &self.rows, &delta.nodes, touched);
    }

    /// Elastic forces at these positions (m), N.
    pub(crate) fn forces(&self, x: &[Vec3A]) -> Vec<Vec3A> {
        let mut forces = vec![Vec3A::ZERO; x.len()];
        let constants = self.rows.constants();
        for (c, (chunk, out)) in self.rows.chunks.iter().zip(forces.chunks_mut(CHUNK)).enumerate() {
            chunk.forces(c * CHUNK, constants, x, out);
        }
        forces
    }

    fn resize(&mut self, nodes: usize) {
        self.gradients.resize(nodes);
        for v in [&mut self.x, &mut self.target] {
            v.resize(nodes, Vec3A::ZERO);
        }
        self.added.resize(nodes, 0.0);
        self.free.resize(nodes, false);
        self.forces.resize(nodes, Forces::default());
    }
}

/// Steps a body over one tick of `dt` s under gravity (m/s2).
pub fn step(body: &mut Body, state: &mut TissueState, holds: &[Hold], gravity: Vec3, dt: f32, settings: &TissueSettings) {
    let mut solver = std::mem::take(&mut body.implicit);
    solver.resize(state.positions.len());
    (solver.iterations, solver.careful) = (0, 0);
    let n = settings.substeps.max(1);
    let h = dt / n as f32;
    let mut starts = std::mem::take(&mut solver.starts);
    starts.clear();
    starts.extend(holds.iter().filter_map(|d| d.fixes().map(|i| (i, state.positions[i]))));
    // One job for the pool: every loop within is split among its threads.
    rayon::scope(|_| {
        for substep in 0..n {
            let end = (substep + 1) as f32 / n as f32;
            let viscosity = settings.viscosity_s.max(LEAST_VISCOSITY * h);
            let step = Step { h, within: WITHIN, reach: WITHIN * h + viscosity, gravity, end, share: 1.0 / n as f32 };
            match solver.substep(body, state, holds, &starts, step, settings, Care::Usual) {
                Ok(()) => {}
                Err(Astray::Tangled) if substep == 0 => {
                    solver.careful += 1;
                    xpbd::step(body, state, holds, gravity, dt, &rescue::settings(body, settings));
                    break;
                }
                Err(_) => {
                    solver.careful += 1;
                    let step = Step { within: 1.0, reach: h, ..step };
                    let _ = solver.substep(body, state, holds, &starts, step, settings, Care::Downhill);
                }
            }
        }
    });
    solver.starts = starts;
    body.implicit = solver;
}

/// Why a substep cannot be done as usual.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Astray {
    /// Too many elements are inverted.
    Tangled,
    /// The energy is not convex, or the residual does not fall.
    Wild,
}

impl Implicit {
    fn substep(
        &mut self,
        body: &Body,
        state: &mut TissueState,
        holds: &[Hold],
        starts: &[(usize, Vec3)],
        step: Step,
        settings: &TissueSettings,
        care: Care,
    ) -> Result<(), Astray> {
        let inertia = step.inertia();
        let gravity = Vec3A::from(step.gravity);
        for i in 0..self.x.len() {
            let (x, v) = (Vec3A::from(state.positions[i]), Vec3A::from(state.velocities[i]));
            self.free[i] = body.masses[i] > 0.0;
            self.added[i] = body.masses[i] * inertia;
            self.target[i] = x + (v + gravity * (step.within * step.h)) * step.reach;
            self.x[i] = match care {
                Care::Usual => x + v * step.reach,
                Care::Downhill => x,
            };
        }
        for (hold, (i, start)) in holds.iter().filter(|d| d.fixes().is_some()).zip(starts) {
            let velocity = (start.lerp(hold.to, step.end) - state.positions[*i]) / step.h;
            self.free[*i] = false;
            self.x[*i] = Vec3A::from(state.positions[*i] + velocity * step.reach);
        }
        self.attach(holds, step);

        let mass: f64 = body.masses.iter().map(|m| f64::from(*m)).sum();
        let least = mass * f64::from(inertia) * (FINE * body.size(mass)).powi(2);
        let stop = Stop { tolerance: settings.tolerance, least, iterations: settings.iterations };
        let most = match care {
            Care::Usual => USUAL_STEPS,
            Care::Downhill => CAREFUL_STEPS,
        };
        for round in 1..=most {
            let weights = Inertia { added: &self.added, free: &self.free, convex: care == Care::Downhill };
            let (chunks, constants) = self.rows.split();
            let x = &self.x;
            let inverted: u32 = chunks
                .par_iter_mut()
                .zip(self.forces.par_chunks_mut(CHUNK))
                .enumerate()
                .with_min_len(GRAIN)
                .map(|(c, (chunk, forces))| chunk.assemble(c * CHUNK, constants, x, weights, forces))
                .sum();
            if care == Care::Usual && inverted as usize / 4 * TANGLED > body.elements.len() {
                return Err(Astray::Tangled);
            }
            self.levels.prepare(&self.clusters, &self.rows, &self.x, weights, &self.forces);
            for (r, f) in self.gradients.residual.iter_mut().zip(&self.forces) {
                *r = f.elastic;
            }
            self.balance(body, inertia);
            let before = self.imbalance();
            let system = System { rows: &self.rows, springs: &self.springs, clusters: &self.clusters, x: &self.x, free: &self.free };
            let solved = self.gradients.solve(system, &mut self.levels, stop);
            self.iterations += solved.iterations;
            self.settle_momentum(body, inertia);
            if solved.iterations == 0 && !solved.negative {
                break;
            }
            match care {
                Care::Usual => {
                    if solved.negative {
                        return Err(Astray::Wild);
                    }
                    self.go(1.0);
                    self.look(body, inertia);
                    if self.imbalance() <= ENOUGH * before {
                        break;
                    }
                    if round == most {
                        return Err(Astray::Wild);
                    }
                }
                Care::Downhill => {
                    if !self.go_downhill(body, inertia) {
                        break;
                    }
                }
            }
        }
        self.finish(body, state, holds, starts, step, settings);
        Ok(())
    }

    /// Turns holds with compliance or several nodes into springs.
    fn attach(&mut self, holds: &[Hold], step: Step) {
        self.springs.clear();
        for hold in holds.iter().filter(|d| d.fixes().is_none()) {
            let point: TissuePoint = hold.point.clone();
            let around: f32 = point.iter().map(|(n, w)| w.abs() * (self.rows.stiffness(n.index()) + self.added[n.index()])).sum();
            let compliance = hold.compliance_m_n.max(0.0);
            let stiffness = if compliance * STIFF * around > 1.0 { 1.0 / compliance } else { STIFF * around };
            for (n, w) in &point {
                self.added[n.index()] += stiffness * w * w;
            }
            // Its anchor goes on to where the forces are taken, as the tissue does.
            let begin = hold.from.lerp(hold.to, step.end - step.share);
            let end = hold.from.lerp(hold.to, step.end);
            let anchor = Vec3A::from(begin + (end - begin) * (step.reach / step.h));
            self.springs.push(Spring { point, stiffness, anchor });
        }
    }

    /// Adds inertia and springs to the elastic forces that are in the residual.
    fn balance(&mut self, body: &Body, inertia: f32) {
        let residual = &mut self.gradients.residual;
        for (i, r) in residual.iter_mut().enumerate() {
            *r = if self.free[i] { *r + (self.target[i] - self.x[i]) * (body.masses[i] * inertia) } else { Vec3A::ZERO };
        }
        for spring in &self.springs {
            let gap = spring.gap(&self.x) * spring.stiffness;
            for (n, w) in spring.point.iter().filter(|(n, _)| self.free[n.index()]) {
                residual[n.index()] -= gap * *w;
            }
        }
    }

    /// Moves a body that no node is fixed of as a whole by what truncation left of the balance of its linear momentum.
    fn settle_momentum(&mut self, body: &Body, inertia: f32) {
        if self.free.iter().zip(&body.masses).any(|(free, mass)| !free && *mass > 0.0) {
            return;
        }
        let left: DVec3 = self.gradients.residual.iter().map(|r| r.as_dvec3()).sum();
        let mut against: f64 = body.masses.iter().map(|m| f64::from(m * inertia)).sum();
        for spring in &self.springs {
            against += f64::from(spring.stiffness * spring.point.iter().map(|(_, w)| w).sum::<f32>().powi(2));
        }
        if against > 0.0 {
            let shift = (left / against).as_vec3a();
            for (d, _) in self.gradients.solution.iter_mut().zip(&self.free).filter(|(_, free)| **free) {
                *d += shift;
            }
        }
    }

    /// Goes a part of the solution.
    fn go(&mut self, part: f32) {
        for (x, d) in self.x.iter_mut().zip(&self.gradients.solution) {
            *x += *d * part;
        }
    }

    /// Takes the residual to where the body now is.
    fn look(&mut self, body: &Body, inertia: f32) {
        let (rows, x) = (&self.rows, &self.x);
        let constants = rows.constants();
        rows.chunks
            .par_iter()
            .zip(self.gradients.residual.par_chunks_mut(CHUNK))
            .enumerate()
            .with_min_len(GRAIN)
            .for_each(|(c, (chunk, out))| chunk.forces(c * CHUNK, constants, x, out));
        self.balance(body, inertia);
    }

    /// The size of the residual: what it could still do to each node on its own, J.
    fn imbalance(&self) -> f64 {
        let of = |(chunk, r): (&Chunk, &[Vec3A])| -> f64 {
            f64::from(chunk.inverses().iter().zip(r).map(|(inverse, r)| r.dot(*inverse * *r)).sum::<f32>())
        };
        self.rows.chunks.iter().zip(self.gradients.residual.chunks(CHUNK)).map(of).sum()
    }

    /// Goes along the solution, less and less of it until the energy is lower; whether it got anywhere.
    fn go_downhill(&mut self, body: &Body, inertia: f32) -> bool {
        let before = self.energy(body, inertia);
        let mut part = 1.0;
        self.go(part);
        for _ in 0..HALVINGS {
            if self.energy(body, inertia) < before {
                return true;
            }
            self.go(-part / 2.0);
            part /= 2.0;
        }
        self.go(-part);
        false
    }

    /// What a substep makes least, J.
    fn energy(&self, body: &Body, inertia: f32) -> f64 {
        let elastic: f64 = body
            .elements
            .iter()
            .filter(|e| !e.is_empty())
            .map(|e| e.energy(e.indices().map(|i| Vec3::from(self.x[i]))))
            .sum();
        let away = |(x, y): (&Vec3A, &Vec3A)| f64::from((*x - *y).length_squared());
        let kinetic: f64 = self.x.iter().zip(&self.target).map(away).zip(&body.masses).map(|(d, m)| d * f64::from(*m)).sum();
        let springs: f64 = self.springs.iter().map(|s| f64::from(s.gap(&self.x).length_squared() * s.stiffness)).sum();
        elastic + (kinetic * f64::from(inertia) + springs) / 2.0
    }

    /// Takes velocities and positions from where the forces were taken.
    fn finish(
        &mut self,
        body: &Body,
        state: &mut TissueState,
        holds: &[Hold],
        starts: &[(usize, Vec3)],
        step: Step,
        settings: &TissueSettings,
    ) {
        let decay = (-settings.drag_1_s * step.h).exp();
        let held = !holds.is_empty();
        let within = |i: usize, x: Vec3| (Vec3::from(self.x[i]) - x) / step.reach;
        // A body that nothing holds falls freely: what truncation makes of its momentum is taken off, and drag takes nothing of its mean velocity.
        let (off, drift) = if held {
            (Vec3::ZERO, Vec3::ZERO)
        } else {
            let fall = step.gravity * (step.within * step.h);
            let change = |(i, (x, v)): (usize, (&Vec3, &Vec3))| within(i, *x) - *v;
            let off = fall - mean(body, state.positions.iter().zip(&state.velocities).enumerate().map(change));
            (off, mean(body, state.velocities.iter().copied()) + step.gravity * step.h)
        };
        // Of a free fall the position would be ahead, for the forces are not taken in the middle.
        let ahead = if held { Vec3::ZERO } else { step.gravity * ((step.within - 0.5) * step.h * step.h) };
        for (i, (x, v)) in state.positions.iter_mut().zip(&mut state.velocities).enumerate() {
            if !self.free[i] {
                continue;
            }
            let u = within(i, *x) + off;
            *x += u * step.h - ahead;
            let next = *v + (u - *v) / step.within;
            *v = drift + (next - drift) * decay;
        }
        let fixed = holds.iter().filter(|d| d.fixes().is_some());
        for (hold, (i, start)) in fixed.zip(starts) {
            let to = start.lerp(hold.to, step.end);
            state.velocities[*i] = (to - state.positions[*i]) / step.h;
            state.positions[*i] = to;
        }
    }
}

/// Velocity of the centre of mass where the nodes have these velocities, m/s.
fn mean(body: &Body, velocities: impl Iterator<Item = Vec3>) -> Vec3 {
    let (mut momentum, mut mass) = (DVec3::ZERO, 0.0);
    for (m, v) in body.masses.iter().zip(velocities).filter(|(m, _)| **m > 0.0) {
        momentum += v.as_dvec3() * f64::from(*m);
        mass += f64::from(*m);
    }
    if mass > 0.0 { (momentum / mass).as_vec3() } else { Vec3::ZERO }
}
