//! One stage of a time step as a minimum: Newton's method on `M |X - y|^2 w / 2 + E(X)` and the springs, by conjugate gradients.

use crate::body::Body;
use crate::clusters::Clusters;
use crate::element::Element;
use crate::gradients::{Gradients, Spring, Stop, System};
use crate::membrane::Membrane;
use crate::multilevel::{GRAIN, Multilevel};
use crate::rows::{CHUNK, Forces, Inertia, Rows};
use crate::skin;
use bevy_math::{DVec3, Vec3, Vec3A};
use keyhole_tetmesh::{NodeId, TetId, TetMesh, TopologyDelta};
use rayon::prelude::*;

/// How often a step of Newton's method is halved before it is given up.
const HALVINGS: u32 = 10;

/// Elements whose energy is summed at once.
const PART: usize = 1024;

/// A body is tangled when more than one in so many of its elements is inverted. A few may be a bridge of tissue about to be cut through, torn out of
/// shape by the weight of what hangs on it.
pub(crate) const TANGLED: usize = 400;

/// Most steps of Newton's method of a stage that goes as usual. Nearly always one does.
const USUAL_STEPS: u32 = 4;

/// Most steps of Newton's method of a stage that has to be done carefully.
const CAREFUL_STEPS: u32 = 6;

/// Share of the square of the residual that a stage may leave.
const ENOUGH: f64 = 0.04;

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

/// The solver's view of a body, and its arrays.
#[derive(Clone, Debug, Default)]
pub struct Newton {
    pub(crate) rows: Rows,
    pub(crate) clusters: Clusters,
    levels: Multilevel,
    gradients: Gradients,
    /// Where the forces are taken: the start, then the solution, m.
    pub(crate) x: Vec<Vec3A>,
    /// `y`: where inertia alone would lead, m.
    pub(crate) target: Vec<Vec3A>,
    /// Masses times `w`, and what springs add, N/m.
    pub(crate) added: Vec<f32>,
    /// Whether a node moves freely.
    pub(crate) free: Vec<bool>,
    forces: Vec<Forces>,
    pub(crate) springs: Vec<Spring>,
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

    /// Makes every array as long as there are nodes.
    pub(crate) fn resize(&mut self, nodes: usize) {
        self.gradients.resize(nodes);
        for v in [&mut self.x, &mut self.target] {
            v.resize(nodes, Vec3A::ZERO);
        }
        self.added.resize(nodes, 0.0);
        self.free.resize(nodes, false);
        self.forces.resize(nodes, Forces::default());
    }

    /// Takes `x` to the minimum: `inertia` is `w` in 1/s2. The first step is with the tangent that there is, when `tangent` says so.
    pub(crate) fn solve(&mut self, tissue: Tissue<'_>, inertia: f32, care: Care, tangent: Tangent, stop: Stop) -> Result<(), Astray> {
        let most = match care {
            Care::Usual => USUAL_STEPS,
            Care::Downhill => CAREFUL_STEPS,
        };
        let mut before = 0.0;
        let mut energy = None;
        let mut convex = care == Care::Downhill;
        for round in 1..=most {
            self.rounds = round;
            if round == 1 && tangent == Tangent::Kept {
                self.look(tissue, inertia);
            } else {
                if self.assemble(tissue.membrane, convex) * TANGLED > tissue.body.elements.len() && care == Care::Usual {
                    return Err(Astray::Tangled);
                }
                self.balance(tissue, inertia);
            }
            let system = System { rows: &self.rows, springs: &self.springs, clusters: &self.clusters, free: &self.free };
            let solved = self.gradients.solve(system, &mut self.levels, stop);
            if before <= 0.0 {
                before = solved.before;
            }
            self.iterations += solved.iterations;
            self.settle_momentum(tissue, inertia);
            if solved.iterations == 0 && !solved.negative {
                break;
            }
            match care {
                Care::Usual => {
                    if solved.negative {
                        if round == most {
                            return Err(Astray::Wild);
                        }
                        convex = true;
                        continue;
                    }
                    self.go(1.0);
                    self.look(tissue, inertia);
                    let size = self.gradients.size(&self.rows, &self.clusters, &mut self.levels);
                    let left = size / before;
                    if left <= ENOUGH || size <= ROUNDING * stop.least {
                        break;
                    }
                    if round == most && (left > WILD || left.is_nan()) {
                        return Err(Astray::Wild);
                    }
                }
                Care::Downhill => {
                    let now = energy.unwrap_or_else(|| self.energy(tissue, inertia));
                    energy = self.go_downhill(tissue, inertia, now);
                    if energy.is_none() {
                        break;
                    }
                }
            }
        }
        Ok(())
    }

    /// Assembles the tangent and the preconditioner at `x`; the residual becomes the elastic force. Returns the number of inverted elements.
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
        self.levels.prepare(&self.clusters, &self.rows, &self.x, weights, &self.forces);
        for (r, f) in self.gradients.residual.iter_mut().zip(&self.forces) {
            *r = f.elastic;
        }
        inverted as usize / 4
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

    /// Moves a body that no node is fixed of as a whole by what truncation left of the balance of its linear momentum.
    fn settle_momentum(&mut self, tissue: Tissue<'_>, inertia: f32) {
        if self.free.iter().zip(&tissue.body.masses).any(|(free, mass)| !free && *mass > 0.0) {
            return;
        }
        let left: DVec3 = self.gradients.residual.iter().map(|r| r.as_dvec3()).sum();
        let mut against: f64 = tissue.body.masses.iter().map(|m| f64::from(m * inertia)).sum();
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
    fn look(&mut self, tissue: Tissue<'_>, inertia: f32) {
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
        self.balance(tissue, inertia);
    }

    /// Goes along the solution, less and less of it until the energy is lower than `before`; the energy there, if it got anywhere.
    fn go_downhill(&mut self, tissue: Tissue<'_>, inertia: f32, before: f64) -> Option<f64> {
        let mut part = 1.0;
        self.go(part);
        for _ in 0..HALVINGS {
            let energy = self.energy(tissue, inertia);
            if energy < before {
                return Some(energy);
            }
            self.go(-part / 2.0);
            part /= 2.0;
        }
        self.go(-part);
        None
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
