//! Conjugate gradients on the rows of a body with the preconditioner of several levels; every sum is taken in an order of its own, whatever
//! the number of threads.

use crate::clusters::Clusters;
use crate::multilevel::{GRAIN, Multilevel};
use crate::rows::{CHUNK, Rows};
use bevy_math::Vec3A;
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
    /// Share of the residual's size.
    pub tolerance: f32,
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
}

/// The vectors of the solver.
#[derive(Clone, Debug, Default)]
pub struct Gradients {
    /// The residual: right-hand side before, what is left of it after.
    pub(crate) residual: Vec<Vec3A>,
    /// The solution.
    pub(crate) solution: Vec<Vec3A>,
    direction: Vec<Vec3A>,
    image: Vec<Vec3A>,
    scaled: Vec<Vec3A>,
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

    /// The size of the residual in the norm of the preconditioner, J.
    pub(crate) fn size(&mut self, rows: &Rows, clusters: &Clusters, levels: &mut Multilevel) -> f64 {
        levels.apply(clusters, rows, &self.residual, &mut self.scaled, &mut self.partial)
    }

    /// Solves `A solution = residual` from zero.
    pub(crate) fn solve(&mut self, system: System<'_>, levels: &mut Multilevel, stop: Stop) -> Solved {
        let System { rows, clusters, .. } = system;
        let Self { residual, solution, direction, image, scaled, partial } = self;
        solution.fill(Vec3A::ZERO);
        let mut size = levels.apply(clusters, rows, residual, scaled, partial);
        let enough = (size * f64::from(stop.tolerance).powi(2)).max(stop.least);
        direction.copy_from_slice(scaled);
        let mut solved = Solved { iterations: 0, negative: !size.is_finite(), before: size };
        while solved.iterations < stop.iterations && size > enough {
            let curvature = multiply(system, direction, image, partial);
            if !(curvature > 0.0 && curvature.is_finite()) {
                solved.negative = true;
                if solved.iterations == 0 {
                    solution.copy_from_slice(direction);
                }
                break;
            }
            let length = (size / curvature) as f32;
            residual.par_chunks_mut(CHUNK).zip(image.par_chunks(CHUNK)).with_min_len(4 * GRAIN).for_each(|(r, q)| {
                for (r, q) in r.iter_mut().zip(q) {
                    *r -= *q * length;
                }
            });
            let next = levels.apply(clusters, rows, residual, scaled, partial);
            let keep = (next / size) as f32;
            size = next;
            solved.iterations += 1;
            let both = solution.par_chunks_mut(CHUNK).zip(direction.par_chunks_mut(CHUNK)).zip(scaled.par_chunks(CHUNK));
            both.with_min_len(4 * GRAIN).for_each(|((x, p), z)| {
                for ((x, p), z) in x.iter_mut().zip(p).zip(z) {
                    *x += *p * length;
                    *p = *z + *p * keep;
                }
            });
        }
        solved
    }
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
