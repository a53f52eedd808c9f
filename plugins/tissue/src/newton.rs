//! One stage of a time step as a minimum: Newton's method on `M |X - y|^2 w / 2 + E(X)`, the springs and the contacts, by conjugate gradients; of one
//! body, or of several that touch as one system.

mod minimise;

pub(crate) use minimise::{FRESH, minimise};

use crate::body::Body;
use crate::clusters::Clusters;
use crate::crumbs::Crumbs;
use crate::element::Element;
use crate::gradients::{Equation, Gradients, Spring, System};
use crate::membrane::Membrane;
use crate::multilevel::{GRAIN, Lever, Multilevel};
use crate::rows::{CHUNK, Forces, Inertia, Rows};
use crate::skin;
use bevy_math::{DVec3, Mat3A, Vec3, Vec3A};
use keyhole_tetmesh::{NodeId, TetId, TetMesh, TopologyDelta};
use rayon::prelude::*;

/// Elements whose energy is summed at once.
const PART: usize = 1024;

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
