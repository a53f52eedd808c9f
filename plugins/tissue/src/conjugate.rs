//! Conjugate gradients with the diagonal as preconditioner, for the three coordinates at once.

use crate::metric::Metric;
use bevy_math::Vec3A;

/// The vectors of a solver for systems of one size.
#[derive(Clone, Debug)]
pub struct Conjugate {
    inverse_diagonal: Vec<Vec3A>,
    solution: Vec<Vec3A>,
    direction: Vec<Vec3A>,
    image: Vec<Vec3A>,
}

impl Conjugate {
    /// A solver for `n` nodes.
    #[must_use]
    pub fn new(n: usize) -> Self {
        let zeros = || vec![Vec3A::ZERO; n];
        Self { inverse_diagonal: Vec::new(), solution: zeros(), direction: zeros(), image: zeros() }
    }

    /// Solves `P x = right` from zero, until the residual in the norm of the inverse diagonal is `tolerance` of what it was, or for
    /// `iterations`. `right` ends as the residual. Every iteration lowers the energy of the error, so a truncated solution is too short, not wild.
    pub fn solve(&mut self, metric: &Metric, right: &mut [Vec3A], tolerance: f32, iterations: u32) -> &[Vec3A] {
        metric.inverse_diagonal(&mut self.inverse_diagonal);
        self.solution.fill(Vec3A::ZERO);
        let mut size = 0.0;
        for ((r, d), p) in right.iter().zip(&self.inverse_diagonal).zip(&mut self.direction) {
            *p = *r * *d;
            size += f64::from(r.dot(*p));
        }
        let enough = size * f64::from(tolerance).powi(2);
        for _ in 0..iterations {
            if size <= enough || size <= 0.0 {
                break;
            }
            let curvature = metric.multiply(&self.direction, &mut self.image);
            let length = (size / curvature) as f32;
            let mut next = 0.0;
            for (((x, r), (p, q)), d) in
                self.solution.iter_mut().zip(right.iter_mut()).zip(self.direction.iter().zip(&self.image)).zip(&self.inverse_diagonal)
            {
                *x += *p * length;
                *r -= *q * length;
                next += f64::from(r.dot(*r * *d));
            }
            let keep = (next / size) as f32;
            size = next;
            for ((p, r), d) in self.direction.iter_mut().zip(right.iter()).zip(&self.inverse_diagonal) {
                *p = *r * *d + *p * keep;
            }
        }
        &self.solution
    }
}
