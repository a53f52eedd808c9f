//! The sparse symmetric matrix of a body's free nodes: assembled, factorised, solved.

use super::{Problem, ReferenceError};
use bevy_math::{DMat3, DVec3};
use faer::Side;
use faer::linalg::solvers::Solve;
use faer::sparse::linalg::solvers::{Llt, SymbolicLlt};
use faer::sparse::{Argsort, Pair, SparseColMat, SymbolicSparseColMat};

/// Which unknowns meet in which entries, and the order of elimination: the same for every matrix of a body.
pub struct System {
    /// First unknown of each node slot; `None` for fixed ones.
    first: Vec<Option<usize>>,
    unknowns: usize,
    pattern: SymbolicSparseColMat<usize>,
    order: Argsort<usize>,
    symbolic: SymbolicLlt<usize>,
}

/// A factorised matrix.
pub struct Factor {
    llt: Llt<usize, f64>,
}

/// Whether an entry of the block of nodes with these first unknowns lies in the lower triangle.
fn is_lower(row: usize, column: usize, r: usize, c: usize) -> bool {
    row + r >= column + c
}

impl System {
    /// The pattern of a body.
    ///
    /// # Errors
    /// When nothing is free, or the library refuses the pattern.
    pub fn new(problem: &Problem) -> Result<Self, ReferenceError> {
        let mut unknowns = 0;
        let first: Vec<Option<usize>> = problem
            .fixed
            .iter()
            .map(|f| {
                (!f).then(|| {
                    unknowns += 3;
                    unknowns - 3
                })
            })
            .collect();
        let fails = |reason: String| ReferenceError::Factorisation { unknowns, reason };
        let mut places: Vec<Pair<usize, usize>> = (0..unknowns).map(|i| Pair::new(i, i)).collect();
        let mut note = |nodes: &[u32]| {
            for a in nodes {
                for b in nodes {
                    let (Some(i), Some(j)) = (first[*a as usize], first[*b as usize]) else { continue };
                    for (r, c) in (0..9).map(|n| (n / 3, n % 3)).filter(|(r, c)| is_lower(i, j, *r, *c)) {
                        places.push(Pair::new(i + r, j + c));
                    }
                }
            }
        };
        for tet in &problem.tets {
            note(&tet.nodes);
        }
        for element in &problem.quadratic {
            note(&element.nodes);
        }
        for triangle in problem.membrane.iter().flat_map(|m| m.triangles()) {
            note(&triangle.nodes);
        }
        let (pattern, order) =
            SymbolicSparseColMat::try_new_from_indices(unknowns, unknowns, &places).map_err(|e| fails(format!("{e:?}")))?;
        let symbolic = SymbolicLlt::try_new(pattern.as_ref(), Side::Lower).map_err(|e| fails(format!("{e:?}")))?;
        Ok(Self { first, unknowns, pattern, order, symbolic })
    }

    /// Factorises `scale K + diag(inertia m)`, with as much of the geometric stiffness as leaves it positive definite: all, half or nothing.
    ///
    /// # Errors
    /// When it is not positive definite even without.
    pub fn factorise(&self, problem: &Problem, positions: &[DVec3], scale: f64, inertia: f64) -> Result<Factor, ReferenceError> {
        let mut refused = String::new();
        for geometric in [1.0, 0.5, 0.0] {
            match self.try_factorise(&self.values(problem, positions, scale, inertia, geometric)) {
                Ok(factor) => return Ok(factor),
                Err(reason) => refused = reason,
            }
        }
        Err(ReferenceError::Factorisation { unknowns: self.unknowns, reason: refused })
    }

    fn values(&self, problem: &Problem, positions: &[DVec3], scale: f64, inertia: f64, geometric: f64) -> Vec<f64> {
        let mut values = vec![0.0; self.unknowns];
        for (first, mass) in self.first.iter().zip(&problem.masses) {
            if let Some(i) = first {
                values[*i..i + 3].fill(inertia * mass);
            }
        }
        let mut add = |nodes: &[u32], block: &dyn Fn(usize, usize) -> DMat3| {
            for (m, a) in nodes.iter().enumerate() {
                for (n, b) in nodes.iter().enumerate() {
                    let (Some(i), Some(j)) = (self.first[*a as usize], self.first[*b as usize]) else { continue };
                    if i + 2 < j {
                        continue;
                    }
                    let k = block(m, n);
                    for (r, c) in (0..9).map(|n| (n / 3, n % 3)).filter(|(r, c)| is_lower(i, j, *r, *c)) {
                        values.push(scale * k.col(c)[r]);
                    }
                }
            }
        };
        for tet in &problem.tets {
            let k = tet.stiffness(tet.at(positions), geometric);
            add(&tet.nodes, &|i, j| k[i][j]);
        }
        for element in &problem.quadratic {
            let k = element.stiffness(element.at(positions), geometric);
            add(&element.nodes, &|i, j| k[i][j]);
        }
        if let Some(membrane) = &problem.membrane {
            for triangle in membrane.triangles() {
                let k = triangle.stiffness(triangle.nodes.map(|n| positions[n as usize]), geometric);
                add(&triangle.nodes, &|i, j| k[i][j]);
            }
        }
        values
    }

    fn try_factorise(&self, values: &[f64]) -> Result<Factor, String> {
        let matrix = SparseColMat::new_from_argsort(self.pattern.clone(), &self.order, values).map_err(|e| format!("{e:?}"))?;
        let llt = Llt::try_new_with_symbolic(self.symbolic.clone(), matrix.as_ref(), Side::Lower).map_err(|e| format!("{e:?}"))?;
        Ok(Factor { llt })
    }

    /// Solves for the free nodes; fixed ones get zero.
    #[must_use]
    pub fn solve(&self, factor: &Factor, right: &[DVec3]) -> Vec<DVec3> {
        let mut column = faer::Mat::<f64>::zeros(self.unknowns, 1);
        for (first, r) in self.first.iter().zip(right) {
            if let Some(i) = first {
                for (axis, value) in r.to_array().into_iter().enumerate() {
                    column[(i + axis, 0)] = value;
                }
            }
        }
        factor.llt.solve_in_place(&mut column);
        let read = |i: usize| DVec3::new(column[(i, 0)], column[(i + 1, 0)], column[(i + 2, 0)]);
        self.first.iter().map(|first| first.map_or(DVec3::ZERO, read)).collect()
    }
}
