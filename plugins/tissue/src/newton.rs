//! One stage of a time step as a minimum: Newton's method on `M |X - y|^2 w / 2 + E(X)`, the springs and the contacts, by conjugate gradients; of one
//! body, or of several that touch as one system.

use crate::body::Body;
use crate::clusters::Clusters;
use crate::crumbs::Crumbs;
use crate::element::Element;
use crate::gradients::{Equation, Gradients, Spring, Stop, System, size};
use crate::membrane::Membrane;
use crate::multilevel::{GRAIN, Lever, Multilevel};
use crate::relax::relax;
use crate::rows::{CHUNK, Forces, Inertia, Rows};
use crate::skin;
use crate::touches::Touches;
use bevy_math::{DMat3, DVec3, Mat3A, Vec3, Vec3A};
use keyhole_tetmesh::{NodeId, TetId, TetMesh, TopologyDelta};
use rayon::prelude::*;
use smallvec::SmallVec;

/// How often a step of Newton's method is halved before it is given up.
const HALVINGS: u32 = 10;

/// Elements whose energy is summed at once.
const PART: usize = 1024;

/// A stage that leads to where more than one in so many of the elements is inverted is done carefully.
const TANGLED: usize = 400;

/// Most steps of Newton's method of a stage that goes as usual. Nearly always one does.
const USUAL_STEPS: u32 = 4;

/// Most steps of Newton's method of a stage that has to be done carefully.
const CAREFUL_STEPS: u32 = 6;

/// Share of the square of the residual that a stage may leave.
const ENOUGH: f64 = 0.04;

/// Share of the residual at which conjugate gradients stop where contacts push and it is not small: the step after it is about other contacts.
const HASTY: f32 = 0.4;

/// Share of the square of the residual without contacts below which nothing is worth doing.
const NOTHING: f64 = 1e-11;

/// Share of the square of the residual without contacts that a stage with contacts may leave: what is left of it is momentum.
const TOUCHING_ENOUGH: f64 = 0.004;

/// The same that is too much after all steps. Below it momentum is balanced, and the shape is left for the next tick.
const TOUCHING_WILD: f64 = 4.0;

/// The same of a stage that leads away, if it is more than there was before the step: where that leads no further step brings it back from.
const LOST: f64 = 1e6;

/// So many times the iterations that a stage may take goes one with contacts on with, all its steps together. What is left then is left for the next tick:
/// an organ of ten thousand elements that is pushed, folded and pulled at once would take ten ticks' time to balance.
const BUDGET: u32 = 1;

/// Further steps where there are contacts, and after how many the tangent of the tissue is assembled anew there.
const TOUCHING_STEPS: u32 = 8;
pub(crate) const FRESH: u32 = 4;

/// Multiple of the size of residual at which conjugate gradients stop that a stage may leave: there is hardly more than rounding in it.
const ROUNDING: f64 = 16.0;

/// Share of the square of the residual that is too much after all of them.
const WILD: f64 = 0.5;

/// How a stage is done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Care {
    /// With the tangent as it is, nearly always in one step.
    Usual,
    /// With a convex bound of the tangent, the energy lower with every step.
    Downhill,
}

/// Which tangent the first step of a stage is taken with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Tangent {
    /// That where the stage begins.
    Own,
    /// That of the stage before, which had the same inertia, springs and free nodes.
    Kept,
}

/// Why a stage cannot be done as usual.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Astray {
    /// Too many elements are inverted.
    Tangled,
    /// The energy is not convex, or the residual does not fall.
    Wild,
}

/// A body and the capsule on it.
#[derive(Clone, Copy)]
pub(crate) struct Tissue<'a> {
    pub body: &'a Body,
    pub membrane: Option<&'a Membrane>,
}

/// A body that is solved with others.
pub(crate) struct Part<'a> {
    pub tissue: Tissue<'a>,
    pub newton: &'a mut Newton,
}

/// The numbers of a stage.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Weights {
    /// `w`, 1/s2.
    pub inertia: f32,
    /// Drag by the length of the stage, 1/s.
    pub drag: f32,
    /// How far ahead forces are taken, s.
    pub reach: f32,
}

/// The solver's view of a body, and its arrays.
#[derive(Clone, Debug, Default)]
pub struct Newton {
    pub(crate) rows: Rows,
    pub(crate) clusters: Clusters,
    /// What is too small to be solved with the rest.
    pub(crate) crumbs: Crumbs,
    pub(crate) levels: Multilevel,
    pub(crate) gradients: Gradients,
    /// Where the forces are taken: the start, then the solution, m.
    pub(crate) x: Vec<Vec3A>,
    /// `y`: where inertia alone would lead, m.
    pub(crate) target: Vec<Vec3A>,
    /// Where their velocities lead when nothing changes them, m.
    pub(crate) ahead: Vec<Vec3A>,
    /// Masses times `w`, and what springs add, N/m.
    pub(crate) added: Vec<f32>,
    /// Whether a node moves freely.
    pub(crate) free: Vec<bool>,
    forces: Vec<Forces>,
    pub(crate) springs: Vec<Spring>,
    /// Of a body that only contacts hold: the middle of its mass where the stage begins (m), and the velocity (m/s) that drag was taken about.
    pub(crate) drift: Option<(DVec3, Vec3A)>,
    /// Steps that the last stage took.
    pub(crate) rounds: u32,
    /// Iterations of conjugate gradients since this was last set to zero.
    pub(crate) iterations: u32,
}

impl Newton {
    /// Bytes of all arrays.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.rows.bytes()
            + self.clusters.bytes()
            + self.crumbs.bytes()
            + self.levels.bytes()
            + self.gradients.bytes()
            + 16 * (self.x.capacity() + self.target.capacity() + self.ahead.capacity())
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
        self.crumbs = Crumbs::new(&self.rows, mesh.node_slots(), &mesh.nodes().collect::<Vec<_>>());
    }

    /// Carries rows and clusters over a topology change: `mesh` and `elements` are those after it, `touched` the nodes around what changed, ascending.
    pub(crate) fn adopt(&mut self, mesh: &TetMesh, elements: &[Element], delta: &TopologyDelta, reshaped: &[TetId], touched: &[NodeId]) {
        for tet in reshaped.iter().copied().chain(delta.added.iter().map(|a| a.tet)) {
            self.rows.set_element(tet, &elements[tet.index()]);
        }
        self.rows.rebuild(touched, mesh, elements);
        self.clusters.adopt(mesh, &self.rows, &delta.nodes, touched);
        self.crumbs.adopt(&self.rows, mesh.node_slots(), touched);
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

    /// Makes every array as long as there are nodes.
    pub(crate) fn resize(&mut self, nodes: usize) {
        self.gradients.resize(nodes);
        for v in [&mut self.x, &mut self.target, &mut self.ahead] {
            v.resize(nodes, Vec3A::ZERO);
        }
        self.added.resize(nodes, 0.0);
        self.free.resize(nodes, false);
        self.forces.resize(nodes, Forces::default());
    }

    /// Its part of a system.
    fn equation(&mut self) -> Equation<'_> {
        let system = System { rows: &self.rows, springs: &self.springs, clusters: &self.clusters, free: &self.free };
        Equation { system, gradients: &mut self.gradients, levels: &mut self.levels }
    }

    /// Assembles the tangent at `x`; the residual becomes the elastic force. Returns the number of inverted elements.
    fn assemble(&mut self, membrane: Option<&Membrane>, convex: bool) -> usize {
        let weights = Inertia { added: &self.added, free: &self.free, convex };
        let (chunks, constants) = self.rows.split();
        let x = &self.x;
        let inverted: u32 = chunks
            .par_iter_mut()
            .zip(self.forces.par_chunks_mut(CHUNK))
            .enumerate()
            .with_min_len(GRAIN)
            .map(|(c, (chunk, forces))| {
                let inverted = chunk.assemble(c * CHUNK, constants, x, weights, forces);
                if let Some(membrane) = membrane {
                    skin::assemble(membrane, chunk, c * CHUNK, x, weights, forces);
                }
                inverted
            })
            .sum();
        for (r, f) in self.gradients.residual.iter_mut().zip(&self.forces) {
            *r = f.elastic;
        }
        inverted as usize / 4
    }

    /// Makes the preconditioner for the tangent.
    fn prepare(&mut self, convex: bool) {
        let weights = Inertia { added: &self.added, free: &self.free, convex };
        self.levels.prepare(&self.clusters, &self.rows, &self.x, weights, &self.forces);
    }

    /// What a force (N) at a node that moves freely is to its clusters.
    pub(crate) fn lever(&self, node: usize, force: Vec3A) -> Lever {
        self.levels.lever(&self.clusters, node, force)
    }

    /// The inverse of the diagonal block of a node, m/N.
    pub(crate) fn inverse(&self, node: usize) -> Mat3A {
        self.rows.chunks[node / CHUNK].inverses()[node % CHUNK]
    }

    /// Adds inertia and springs to the elastic forces that are in the residual.
    fn balance(&mut self, tissue: Tissue<'_>, inertia: f32) {
        let residual = &mut self.gradients.residual;
        for (i, r) in residual.iter_mut().enumerate() {
            *r = if self.free[i] { *r + (self.target[i] - self.x[i]) * (tissue.body.masses[i] * inertia) } else { Vec3A::ZERO };
        }
        for spring in &self.springs {
            let gap = spring.gap(&self.x) * spring.stiffness;
            for (n, w) in spring.point.iter().filter(|(n, _)| self.free[n.index()]) {
                residual[n.index()] -= gap * *w;
            }
        }
    }

    /// Whether a node of it is fixed.
    fn is_fixed(&self, body: &Body) -> bool {
        self.free.iter().zip(&body.masses).enumerate().any(|(i, (free, mass))| !free && *mass > 0.0 && !self.crumbs.contains(i))
    }

    /// Goes a part of the solution.
    fn go(&mut self, part: f32) {
        for (x, d) in self.x.iter_mut().zip(&self.gradients.solution) {
            *x += *d * part;
        }
    }

    /// Takes the elastic forces, into the residual, to where the body now is.
    fn look(&mut self, tissue: Tissue<'_>) {
        let (rows, x) = (&self.rows, &self.x);
        let constants = rows.constants();
        rows.chunks.par_iter().zip(self.gradients.residual.par_chunks_mut(CHUNK)).enumerate().with_min_len(GRAIN).for_each(
            |(c, (chunk, out))| {
                chunk.forces(c * CHUNK, constants, x, out);
                if let Some(membrane) = tissue.membrane {
                    skin::forces(membrane, c * CHUNK, x, out);
                }
            },
        );
    }

    /// What a substep makes least, J.
    fn energy(&self, tissue: Tissue<'_>, inertia: f32) -> f64 {
        let of = |e: &Element| e.energy(e.indices().map(|i| Vec3::from(self.x[i])));
        let some = |elements: &[Element]| elements.iter().filter(|e| !e.is_empty()).map(of).sum::<f64>();
        // Parts of a fixed size, summed in their order: the same bits on any number of threads.
        let parts: Vec<f64> = tissue.body.elements.par_chunks(PART).map(some).collect();
        let elastic: f64 = parts.into_iter().sum();
        let away = |(x, y): (&Vec3A, &Vec3A)| f64::from((*x - *y).length_squared());
        let kinetic: f64 = self.x.iter().zip(&self.target).map(away).zip(&tissue.body.masses).map(|(d, m)| d * f64::from(*m)).sum();
        let springs: f64 = self.springs.iter().map(|s| f64::from(s.gap(&self.x).length_squared() * s.stiffness)).sum();
        let capsule = tissue.membrane.map_or(0.0, |m| m.energy_by(|n| self.x[n].as_dvec3()));
        elastic + capsule + (kinetic * f64::from(inertia) + springs) / 2.0
    }
}

/// Takes `x` of all bodies to the minimum. The first step is with the tangent that there is, when `tangent` says so.
pub(crate) fn minimise(
    parts: &mut [Part<'_>],
    touches: &mut Touches,
    weights: Weights,
    care: Care,
    tangent: Tangent,
    stop: Stop,
) -> Result<(), Astray> {
    let most = match care {
        Care::Usual => USUAL_STEPS,
        Care::Downhill => CAREFUL_STEPS,
    };
    let most = if touches.is_empty() { most } else { most + TOUCHING_STEPS };
    let mut before = 0.0;
    let mut energy = None;
    let mut convex = care == Care::Downhill;
    let elements: usize = parts.iter().map(|p| p.tissue.body.elements.len()).sum();
    match care {
        Care::Usual => touches.look_ahead(parts),
        Care::Downhill => {
            touches.look(parts);
            start_lower(parts, touches, weights);
        }
    }
    let mut stale = true;
    let mut recapped = false;
    // Whether the residuals are those where the bodies are.
    let mut looked = false;
    let (all, mut spent) = (stop.iterations * BUDGET, 0);
    for round in 1..=most {
        parts.iter_mut().for_each(|p| p.newton.rounds = round);
        looked = false;
        if round == 1 && tangent == Tangent::Kept {
            look(parts, touches, weights);
        } else if stale || touches.is_empty() || round % FRESH == 0 {
            let inverted: usize = parts.iter_mut().map(|p| p.newton.assemble(p.tissue.membrane, convex)).sum();
            if inverted * TANGLED > elements && care == Care::Usual {
                return Err(Astray::Tangled);
            }
            parts.iter_mut().for_each(|p| p.newton.prepare(convex));
            balance(parts, touches, weights);
            stale = false;
        }
        if round == 1 && care == Care::Usual && touches.push() {
            // By what the bodies would do without contacts it is measured what is enough: the contacts may say anything where it is begun.
            touches.add_forces(parts, -1.0);
            before = with_equations(parts, size);
            touches.add_forces(parts, 1.0);
        }
        touches.hold(parts);
        let stop = if before > 0.0 && touches.push() {
            Stop {
                hasty: (stop.tolerance.max(HASTY), before * TOUCHING_ENOUGH),
                least: stop.least.max(before * NOTHING),
                iterations: all - spent,
                ..stop
            }
        } else {
            stop
        };
        let solved = with_equations(parts, |equations| touches.solve(equations, stop));
        if before <= 0.0 {
            before = solved.before;
        }
        parts.iter_mut().for_each(|p| p.newton.iterations += solved.iterations);
        spent = (spent + solved.iterations).min(all);
        let last = round == most || touches.push() && spent >= all;
        settle_momentum(parts, touches, weights);
        if solved.iterations == 0 && !solved.negative {
            break;
        }
        match care {
            Care::Usual => {
                if solved.negative {
                    if last {
                        return Err(Astray::Wild);
                    }
                    (convex, stale) = (true, true);
                    continue;
                }
                let part = if touches.is_empty() { 1.0 } else { touches.part_of(parts, solved.gain) };
                parts.iter_mut().for_each(|p| p.newton.go(part));
                touches.look(parts);
                look(parts, touches, weights);
                looked = true;
                let size = with_equations(parts, |equations| touches.size(equations));
                let left = size / before;
                if !touches.is_empty() && (left.is_nan() || left > LOST.max(solved.before / before)) {
                    return Err(Astray::Wild);
                }
                // A tangent that did not lead nearer is no good any more.
                stale |= size > solved.before;
                let enough = if touches.push() { TOUCHING_ENOUGH } else { ENOUGH };
                if left <= enough || size <= ROUNDING * stop.least {
                    if recapped || !touches.recap() {
                        break;
                    }
                    // Friction with the forces that there are now.
                    recapped = true;
                    touches.look(parts);
                    look(parts, touches, weights);
                }
                let wild = if touches.push() { TOUCHING_WILD } else { WILD };
                if last && (left > wild || left.is_nan()) {
                    return Err(Astray::Wild);
                }
                if last {
                    break;
                }
            }
            Care::Downhill => {
                let now = energy.unwrap_or_else(|| total_energy(parts, touches, weights));
                let first = if touches.is_empty() { 1.0 } else { touches.part_of(parts, solved.gain) };
                energy = go_downhill(parts, touches, weights, first, now);
                if energy.is_none() {
                    break;
                }
                if last {
                    break;
                }
                if !touches.is_empty() {
                    // Friction is capped by another force from here on.
                    touches.look(parts);
                    energy = None;
                }
            }
        }
    }
    touches.look(parts);
    if touches.bear() && !parts.iter().any(|p| p.newton.is_fixed(p.tissue.body)) {
        if !looked {
            look(parts, touches, weights);
        }
        let (mut left, mut mass) = (DVec3::ZERO, 0.0);
        for Part { tissue, newton } in parts.iter() {
            left += newton.gradients.residual.iter().map(|r| r.as_dvec3()).sum::<DVec3>();
            mass += tissue.body.masses.iter().map(|m| f64::from(*m)).sum::<f64>();
        }
        let shift = touches.balance(parts, left, mass * f64::from(weights.inertia));
        looked = false;
        for newton in parts.iter_mut().map(|p| &mut *p.newton) {
            for (x, _) in newton.x.iter_mut().zip(&newton.free).filter(|(_, free)| **free) {
                *x += shift;
            }
        }
        touches.look(parts);
    }
    if !touches.is_empty() {
        if !looked {
            look(parts, touches, weights);
        }
        relax(parts, touches, weights.inertia);
    }
    Ok(())
}

/// Begins where the bodies' velocities lead, `target`, instead of where they are, if that is lower.
fn start_lower(parts: &mut [Part<'_>], touches: &mut Touches, weights: Weights) {
    if touches.is_empty() {
        return;
    }
    let here = total_energy(parts, touches, weights);
    let swap = |parts: &mut [Part<'_>]| {
        for Part { newton, .. } in parts {
            for (i, start) in newton.gradients.solution.iter_mut().enumerate().filter(|(i, _)| newton.free[*i]) {
                std::mem::swap(start, &mut newton.x[i]);
            }
        }
    };
    for Part { newton, .. } in parts.iter_mut() {
        let Newton { gradients, ahead, .. } = &mut **newton;
        gradients.solution.copy_from_slice(ahead);
    }
    swap(parts);
    touches.look(parts);
    let there = total_energy(parts, touches, weights);
    if there.is_nan() || there >= here {
        swap(parts);
        touches.look(parts);
    }
}

/// Does something with the systems of all bodies.
fn with_equations<T>(parts: &mut [Part<'_>], then: impl FnOnce(&mut [Equation<'_>]) -> T) -> T {
    let mut equations: SmallVec<[Equation<'_>; 4]> = parts.iter_mut().map(|p| p.newton.equation()).collect();
    then(&mut equations)
}

/// Takes the residuals to where the bodies now are.
fn look(parts: &mut [Part<'_>], touches: &Touches, weights: Weights) {
    parts.iter_mut().for_each(|p| p.newton.look(p.tissue));
    balance(parts, touches, weights);
}

/// Adds everything that is not elastic to the elastic forces that are in the residuals.
fn balance(parts: &mut [Part<'_>], touches: &Touches, weights: Weights) {
    parts.iter_mut().for_each(|p| p.newton.balance(p.tissue, weights.inertia));
    touches.add_forces(parts, 1.0);
}

/// Moves bodies that no node is fixed of all together by what truncation left of the balance of their linear momentum.
fn settle_momentum(parts: &mut [Part<'_>], touches: &Touches, weights: Weights) {
    if parts.iter().any(|p| p.newton.is_fixed(p.tissue.body)) {
        return;
    }
    let Weights { inertia, drag, reach } = weights;
    let mut left = DVec3::ZERO;
    let mut against = 0.0_f64;
    for Part { tissue, newton } in parts.iter() {
        if let Some((from, drift)) = newton.drift {
            // Drag takes nothing of the mean velocity, which is not what it was thought to be.
            let (mut sum, mut mass) = (DVec3::ZERO, 0.0);
            for (m, (x, d)) in tissue.body.masses.iter().zip(newton.x.iter().zip(&newton.gradients.solution)).filter(|(m, _)| **m > 0.0) {
                sum += (*x + *d).as_dvec3() * f64::from(*m);
                mass += f64::from(*m);
            }
            left += ((sum - from * mass) / f64::from(reach) - drift.as_dvec3() * mass) * f64::from(drag);
        }
        left += newton.gradients.residual.iter().map(|r| r.as_dvec3()).sum::<DVec3>();
        against += tissue.body.masses.iter().map(|m| f64::from(m * inertia)).sum::<f64>();
        for spring in &newton.springs {
            against += f64::from(spring.stiffness * spring.point.iter().map(|(_, w)| w).sum::<f32>().powi(2));
        }
    }
    if against <= 0.0 {
        return;
    }
    let shift = if touches.push() {
        let all = DMat3::from_diagonal(DVec3::splat(against)) + DMat3::from_cols_array(&touches.against().to_cols_array().map(f64::from));
        (all.inverse() * left).as_vec3a()
    } else {
        (left / against).as_vec3a()
    };
    for Part { newton, .. } in parts {
        for (d, _) in newton.gradients.solution.iter_mut().zip(&newton.free).filter(|(_, free)| **free) {
            *d += shift;
        }
    }
}

/// Goes along the solution, `first` of it and less and less until the energy is lower than `before`; the energy there, if it got anywhere.
fn go_downhill(parts: &mut [Part<'_>], touches: &Touches, weights: Weights, first: f32, before: f64) -> Option<f64> {
    let go = |parts: &mut [Part<'_>], part: f32| parts.iter_mut().for_each(|p| p.newton.go(part));
    let mut part = first;
    go(parts, part);
    for _ in 0..HALVINGS {
        let energy = total_energy(parts, touches, weights);
        if energy < before {
            return Some(energy);
        }
        go(parts, -part / 2.0);
        part /= 2.0;
    }
    go(parts, -part);
    None
}

/// What a stage makes least, J.
fn total_energy(parts: &[Part<'_>], touches: &Touches, weights: Weights) -> f64 {
    parts.iter().map(|p| p.newton.energy(p.tissue, weights.inertia)).sum::<f64>() + touches.energy(parts)
}
