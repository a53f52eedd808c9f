//! What contacts add to the preconditioner: exactly what they are, however stiff.
//!
//! With `B` the preconditioner of the tissue alone and `U' U` the tangent of the contacts (`U` has a row for each direction in which a contact
//! resists), the preconditioner is that of both together by the formula of Sherman, Morrison and Woodbury,
//!
//! `(B^-1 + U' U)^-1 = B - B U' S^-1 U B`, `S = I + U B U'`,
//!
//! with `U B U'` the Delassus operator of the contacts in the preconditioner's own eyes. So conjugate gradients need about as many iterations as
//! without any contact. To add what contacts have to the diagonal alone is not enough: a coarse motion would have to overcome every one of
//! them, and could do hardly anything.

use crate::gradients::Equation;
use crate::multilevel::{Lever, RIGID, dot, solve_dense};
use crate::newton::Part;
use crate::touch::Touch;
use bevy_math::Vec3A;
use smallvec::SmallVec;
use std::ops::Range;

/// Most rows: the factor of this many costs about as much as five iterations of ten thousand elements. What there is beyond is left to the iterations.
const MOST: usize = 192;

/// A node that takes part in a row.
#[derive(Clone, Copy, Debug, Default)]
struct Arm {
    part: u32,
    node: u32,
    /// Its block of the row, N^1/2 m^-1/2.
    force: Vec3A,
    /// What it is to its clusters.
    lever: Lever,
}

/// The rows of all contacts that push, and the factor of `S`.
#[derive(Clone, Debug, Default)]
pub(crate) struct Delassus {
    arms: Vec<Arm>,
    rows: Vec<Range<usize>>,
    /// The contacts that push, the strongest first.
    order: Vec<u32>,
    /// Lower triangle of the factor by rows; the diagonal keeps its inverse.
    factor: Vec<f32>,
    solution: Vec<f32>,
    /// Room for the motion of the large clusters of each part.
    large: Vec<f32>,
    /// Residuals as they were.
    before: Vec<Vec3A>,
}

impl Delassus {
    pub(crate) fn clear(&mut self) {
        self.rows.clear();
        self.arms.clear();
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// Takes over the contacts as they were last looked at.
    pub(crate) fn build(&mut self, touches: &[Touch], parts: &[Part<'_>]) {
        self.clear();
        self.order.clear();
        self.order.extend((0..touches.len() as u32).filter(|t| touches[*t as usize].now.touches));
        let push = |t: &u32| touches[*t as usize].now.push;
        self.order.sort_unstable_by(|a, b| push(b).total_cmp(&push(a)).then(a.cmp(b)));
        let order = std::mem::take(&mut self.order);
        // What they keep apart before what they keep from sliding.
        for direction in [0..1, 1..3] {
            for touch in order.iter().map(|t| &touches[*t as usize]) {
                for row in &touch.rows()[direction.clone()] {
                    if *row != Vec3A::ZERO && self.rows.len() < MOST {
                        self.add(touch, *row, parts);
                    }
                }
            }
        }
        self.order = order;
        self.fill(parts);
        factor(&mut self.factor, self.rows.len());
    }

    fn add(&mut self, touch: &Touch, row: Vec3A, parts: &[Part<'_>]) {
        let from = self.arms.len();
        for a in &touch.arms {
            let newton = &*parts[a.part as usize].newton;
            if newton.free[a.node as usize] {
                let force = row * a.weight;
                let lever = newton.lever(a.node as usize, force);
                self.arms.push(Arm { part: a.part, node: a.node, force, lever });
            }
        }
        if self.arms.len() > from {
            self.rows.push(from..self.arms.len());
        }
    }

    /// Makes the lower triangle of `S`.
    fn fill(&mut self, parts: &[Part<'_>]) {
        let count = self.rows.len();
        self.factor.clear();
        self.factor.resize(count * count, 0.0);
        self.solution.resize(count, 0.0);
        for (i, row) in self.rows.iter().enumerate() {
            let own = &self.arms[row.clone()];
            let nodes: SmallVec<[Vec3A; 8]> =
                own.iter().map(|a| parts[a.part as usize].newton.inverse(a.node as usize) * a.force).collect();
            // How the clusters of its nodes move.
            let mut small: SmallVec<[(u32, u32, [f32; RIGID]); 8]> = SmallVec::new();
            for a in own {
                match small.iter_mut().find(|s| (s.0, s.1) == (a.part, a.lever.small)) {
                    Some(s) => s.2.iter_mut().zip(a.lever.on_small).for_each(|(s, f)| *s += f),
                    None => small.push((a.part, a.lever.small, a.lever.on_small)),
                }
            }
            for (part, cluster, motion) in &mut small {
                *motion = parts[*part as usize].newton.levels.move_small(*cluster, *motion);
            }
            let mut large: SmallVec<[(u32, Range<usize>); 4]> = SmallVec::new();
            self.large.clear();
            for a in own.iter().filter(|a| a.lever.large.is_some()) {
                let known = large.iter().find(|l| l.0 == a.part).map(|l| l.1.start);
                let start = known.unwrap_or_else(|| {
                    let start = self.large.len();
                    self.large.resize(start + parts[a.part as usize].newton.levels.order(), 0.0);
                    large.push((a.part, start..self.large.len()));
                    start
                });
                let at = start + RIGID * a.lever.large.unwrap_or(0) as usize;
                self.large[at..at + RIGID].iter_mut().zip(a.lever.on_large).for_each(|(l, f)| *l += f);
            }
            for (part, range) in &large {
                parts[*part as usize].newton.levels.move_large(&mut self.large[range.clone()]);
            }
            for (j, other) in self.rows[..=i].iter().enumerate() {
                let mut sum = if i == j { 1.0 } else { 0.0 };
                for a in &self.arms[other.clone()] {
                    for (b, image) in own.iter().zip(&nodes) {
                        if (a.part, a.node) == (b.part, b.node) {
                            sum += a.force.dot(*image);
                        }
                    }
                    if let Some(s) = small.iter().find(|s| (s.0, s.1) == (a.part, a.lever.small)) {
                        sum += six(&a.lever.on_small, &s.2);
                    }
                    if let (Some(cluster), Some(l)) = (a.lever.large, large.iter().find(|l| l.0 == a.part)) {
                        let at = l.1.start + RIGID * cluster as usize;
                        sum += six(&a.lever.on_large, &self.large[at..at + RIGID]);
                    }
                }
                self.factor[i * count + j] = sum;
            }
        }
    }

    /// Takes what contacts keep the tissue from off the residuals, between the solution of the coarse levels and its way back to the nodes. What is to be added to the product
    /// of residuals and preconditioned ones.
    pub(crate) fn hold(&mut self, equations: &mut [Equation<'_>]) -> f64 {
        for (to, row) in self.solution.iter_mut().zip(&self.rows) {
            *to = self.arms[row.clone()].iter().map(|a| a.force.dot(equations[a.part as usize].at(a.node as usize))).sum();
        }
        solve_dense(&self.factor, self.rows.len(), &mut self.solution);
        self.before.clear();
        for (w, row) in self.solution.iter().zip(&self.rows) {
            for a in &self.arms[row.clone()] {
                self.before.push(equations[a.part as usize].take(a.node as usize, a.force * *w));
            }
        }
        for e in equations {
            e.levels.solve(e.system.clusters);
        }
        self.solution.iter().map(|w| f64::from(*w).powi(2)).sum()
    }

    /// Gives the residuals back what [`Delassus::hold`] took.
    pub(crate) fn let_go(&self, equations: &mut [Equation<'_>]) {
        for (a, before) in self.arms.iter().zip(&self.before).rev() {
            equations[a.part as usize].gradients.residual[a.node as usize] = *before;
        }
    }
}

fn six(a: &[f32; RIGID], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Factors the lower triangle of a matrix that is one more than a positive one, by rows in place.
fn factor(m: &mut [f32], order: usize) {
    for q in 0..order {
        let (above, rest) = m.split_at_mut(q * order);
        let row = &mut rest[..=q];
        for p in 0..q {
            let other = &above[p * order..=p * order + p];
            row[p] = (row[p] - dot(&row[..p], &other[..p])) * other[p];
        }
        // No pivot is less than one but by rounding.
        row[q] = (row[q] - dot(&row[..q], &row[..q])).max(1.0).sqrt().recip();
    }
}
