//! Conjugate gradients on the rows of a body, or of several that touch, with the preconditioner of several levels; every sum is taken in an order
//! of its own, whatever the number of threads.

use crate::clusters::Clusters;
use crate::delassus::Delassus;
use crate::multilevel::{GRAIN, Multilevel};
use crate::rows::{CHUNK, Rows};
use crate::touches::Touches;
use bevy_math::{Mat3A, Vec3A};
use keyhole_whiteboard::TissuePoint;
use rayon::prelude::*;

/// A stiffness of one point of several nodes: `k` times the square of the distance of `sum weight x` from where it belongs.
#[derive(Clone, Debug, Default)]
pub(crate) struct Spring {
    /// Nodes and weights.
    pub point: TissuePoint,
    /// N/m.
    pub stiffness: f32,
    /// Where the point belongs, m.
    pub anchor: Vec3A,
}

impl Spring {
    /// From where the point belongs to where it is, m.
    pub(crate) fn gap(&self, x: &[Vec3A]) -> Vec3A {
        self.point.iter().map(|(n, w)| x[n.index()] * *w).sum::<Vec3A>() - self.anchor
    }
}

/// The system of one step of Newton's method.
#[derive(Clone, Copy)]
pub(crate) struct System<'a> {
    /// The tangent.
    pub rows: &'a Rows,
    /// The springs; their diagonal is in the rows.
    pub springs: &'a [Spring],
    /// The clusters of the preconditioner.
    pub clusters: &'a Clusters,
    /// Whether a node moves freely.
    pub free: &'a [bool],
}

/// When to stop.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stop {
    /// Share of the residual.
    pub tolerance: f32,
    /// The same for one of more than this size, J: the step after it is about another system.
    pub hasty: (f32, f64),
    /// Size of the residual below which nothing is worth doing, J.
    pub least: f64,
    /// Most iterations.
    pub iterations: u32,
}

/// What a solution cost and whether it can be trusted.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Solved {
    /// Iterations.
    pub iterations: u32,
    /// Whether a direction of negative curvature was met: the solution is what had been reached before it.
    pub negative: bool,
    /// Size of the residual before, J.
    pub before: f64,
    /// Right-hand side times solution, J.
    pub gain: f64,
}

/// The vectors of the solver.
#[derive(Clone, Debug, Default)]
pub struct Gradients {
    /// The residual: right-hand side before, what is left of it after.
    pub(crate) residual: Vec<Vec3A>,
    /// The solution.
    pub(crate) solution: Vec<Vec3A>,
    pub(crate) direction: Vec<Vec3A>,
    pub(crate) image: Vec<Vec3A>,
    pub(crate) scaled: Vec<Vec3A>,
    partial: Vec<f32>,
}

impl Gradients {
    /// Makes every vector this long.
    pub(crate) fn resize(&mut self, nodes: usize) {
        for v in [&mut self.residual, &mut self.solution, &mut self.direction, &mut self.image, &mut self.scaled] {
            v.resize(nodes, Vec3A::ZERO);
        }
        self.partial.resize(nodes.div_ceil(CHUNK), 0.0);
    }

    /// Bytes of all arrays.
    #[must_use]
    pub fn bytes(&self) -> usize {
        size_of::<Vec3A>() * 5 * self.residual.capacity() + 4 * self.partial.capacity()
    }
}

/// What one body has in a system of one or several.
pub(crate) struct Equation<'a> {
    /// Its own part of the system.
    pub system: System<'a>,
    /// Its vectors.
    pub gradients: &'a mut Gradients,
    /// Its preconditioner.
    pub levels: &'a mut Multilevel,
}

impl Equation<'_> {
    /// The coarse levels' part of the preconditioner.
    fn solve_coarse(&mut self) {
        self.levels.restrict(self.system.clusters, &self.gradients.residual);
        self.levels.solve(self.system.clusters);
    }

    /// The nodes' part of it; the product of the residual with what was made of it.
    fn precondition(&mut self) -> f64 {
        let Gradients { residual, scaled, partial, .. } = &mut *self.gradients;
        self.levels.prolong(self.system.clusters, self.system.rows, residual, scaled, partial)
    }

    fn inverse(&self, node: usize) -> Mat3A {
        self.system.rows.chunks[node / CHUNK].inverses()[node % CHUNK]
    }

    /// What the preconditioner makes of the residual of a node that moves freely, once the coarse levels are solved.
    pub(crate) fn at(&self, node: usize) -> Vec3A {
        self.levels.at(self.system.clusters, node, self.inverse(node), self.gradients.residual[node])
    }

    /// Takes a force off the residual of such a node; the residual as it was.
    pub(crate) fn take(&mut self, node: usize, force: Vec3A) -> Vec3A {
        let residual = &mut self.gradients.residual[node];
        let before = *residual;
        *residual -= force;
        self.levels.pull(self.system.clusters, node, -force);
        before
    }

    fn multiply(&mut self) -> f64 {
        let Gradients { direction, image, partial, .. } = &mut *self.gradients;
        multiply(self.system, direction, image, partial)
    }

    fn descend(&mut self, length: f32) {
        let Gradients { residual, image, .. } = &mut *self.gradients;
        residual.par_chunks_mut(CHUNK).zip(image.par_chunks(CHUNK)).with_min_len(4 * GRAIN).for_each(|(r, q)| {
            for (r, q) in r.iter_mut().zip(q) {
                *r -= *q * length;
            }
        });
    }

    fn advance(&mut self, length: f32, keep: f32) {
        let Gradients { solution, direction, scaled, .. } = &mut *self.gradients;
        let both = solution.par_chunks_mut(CHUNK).zip(direction.par_chunks_mut(CHUNK)).zip(scaled.par_chunks(CHUNK));
        both.with_min_len(4 * GRAIN).for_each(|((x, p), z)| {
            for ((x, p), z) in x.iter_mut().zip(p).zip(z) {
                *x += *p * length;
                *p = *z + *p * keep;
            }
        });
    }
}

/// Solves `A solution = residual` from zero, for all bodies and what joins them together.
pub(crate) fn solve(equations: &mut [Equation<'_>], touches: &Touches, held: &mut Delassus, stop: Stop) -> Solved {
    for e in equations.iter_mut() {
        e.gradients.solution.fill(Vec3A::ZERO);
    }
    let mut size = size_by(equations, held);
    let tolerance = if size > stop.hasty.1 { stop.hasty.0 } else { stop.tolerance };
    let enough = (size * f64::from(tolerance).powi(2)).max(stop.least);
    for e in equations.iter_mut() {
        e.gradients.direction.copy_from_slice(&e.gradients.scaled);
    }
    let mut solved = Solved { iterations: 0, negative: !size.is_finite(), before: size, gain: 0.0 };
    while solved.iterations < stop.iterations && size > enough {
        let curvature = equations.iter_mut().map(Equation::multiply).sum::<f64>() + touches.multiply(equations);
        if !(curvature > 0.0 && curvature.is_finite()) {
            solved.negative = true;
            if solved.iterations == 0 {
                for e in equations.iter_mut() {
                    e.gradients.solution.copy_from_slice(&e.gradients.direction);
                }
            }
            break;
        }
        let length = (size / curvature) as f32;
        solved.gain += size * size / curvature;
        equations.iter_mut().for_each(|e| e.descend(length));
        let next = size_by(equations, held);
        let keep = (next / size) as f32;
        size = next;
        solved.iterations += 1;
        equations.iter_mut().for_each(|e| e.advance(length, keep));
    }
    solved
}

/// Applies the preconditioner of the tissue and of the contacts to the residuals; the size of the residuals in its norm, J.
pub(crate) fn size_by(equations: &mut [Equation<'_>], held: &mut Delassus) -> f64 {
    equations.iter_mut().for_each(Equation::solve_coarse);
    if held.is_empty() {
        return equations.iter_mut().map(Equation::precondition).sum();
    }
    let own = held.hold(equations);
    let size = own + equations.iter_mut().map(Equation::precondition).sum::<f64>();
    held.let_go(equations);
    size
}

/// The size of the residuals in the norm of the preconditioner of the tissue alone, J.
pub(crate) fn size(equations: &mut [Equation<'_>]) -> f64 {
    equations.iter_mut().for_each(Equation::solve_coarse);
    equations.iter_mut().map(Equation::precondition).sum()
}

/// `out = A v`, zero where a node is not free; and the product of both.
fn multiply(system: System<'_>, v: &[Vec3A], out: &mut [Vec3A], partial: &mut [f32]) -> f64 {
    out.par_chunks_mut(CHUNK).zip(&system.rows.chunks).zip(partial.par_iter_mut()).enumerate().with_min_len(GRAIN).for_each(
        |(c, ((out, chunk), partial))| {
            *partial = chunk.multiply(c * CHUNK, v, system.free, out);
        },
    );
    let mut product: f64 = partial.iter().map(|p| f64::from(*p)).sum();
    for spring in system.springs {
        let mean: Vec3A = spring.point.iter().map(|(n, w)| v[n.index()] * *w).sum();
        for (n, w) in spring.point.iter().filter(|(n, _)| system.free[n.index()]) {
            let own = v[n.index()];
            let pull = (mean - own * *w) * (spring.stiffness * w);
            out[n.index()] += pull;
            product += f64::from(pull.dot(own));
        }
    }
    product
}
