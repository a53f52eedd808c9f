//! The inertia of [`crate::semi_implicit`]: `P = M + c B`, where `B` bounds the stiffness from above.
//!
//! The tangent of the energy is `mu |dF|^2 + lambda (cof F : dF)^2 + p d2J[dF, dF]` with `p = lambda (J - a)`. `B` keeps the second term, which is
//! by far the stiffest, as it is: one vector an element. The rest is bounded by a scalar `kappa |dF|^2`, the largest eigenvalue, for every `dF` and whatever
//! the deformation: a Laplacian `kappa V grad N_i . grad N_j` with one number for each edge of the mesh, the same for all three coordinates. At
//! rest `kappa = 2 mu`. A scalar bound of everything would be 15 times that at nu 0.45, and would make every rotation as heavy.

use crate::body::Body;
use crate::element::cofactor;
use bevy_math::{Mat3, Vec3, Vec3A};
use keyhole_tetmesh::EDGES;

/// `P` by rows.
#[derive(Clone, Debug, Default)]
pub struct Metric {
    /// Where each row begins in `columns` and `entries`, and the end.
    starts: Vec<u32>,
    columns: Vec<u32>,
    /// Minus the off-diagonal entries, kg.
    entries: Vec<f32>,
    /// Volumetric terms.
    volumetric: Vec<Volumetric>,
    /// Diagonal of `M` and the Laplacian, kg.
    scalar: Vec<f32>,
    /// Diagonal of the volumetric terms, kg.
    diagonal: Vec<Vec3A>,
    masses: Vec<f32>,
    free: Vec<bool>,
    /// By edge slot of the graph, N/m.
    edges: Vec<f32>,
}

/// The term `(sum_i g_i . x_i)^2` of an element, with `g_0` minus the sum of the others; `g` in the square root of kg.
#[derive(Clone, Copy, Debug)]
struct Volumetric {
    nodes: [u32; 4],
    gradients: [Vec3A; 3],
}

impl Metric {
    /// Assembles `M + raise L` (`raise` in s2) for a body at these positions (m). Rows of nodes that are not free are empty.
    pub fn assemble(&mut self, body: &Body, positions: &[Vec3], raise: f32, free: &[bool]) {
        let count = positions.len();
        self.diagonal.clear();
        self.diagonal.resize(count, Vec3A::ZERO);
        self.stiffness(body, positions, raise);
        self.free.clear();
        self.free.extend_from_slice(free);
        self.masses.clear();
        self.masses.extend_from_slice(&body.masses);
        self.scalar.clear();
        self.scalar.extend_from_slice(&body.masses);
        let ends = body.graph.ends();
        self.starts.clear();
        self.starts.resize(count + 2, 0);
        for [i, j] in ends.iter().filter(|[i, j]| i != j) {
            self.starts[*i as usize + 2] += 1;
            self.starts[*j as usize + 2] += 1;
        }
        for i in 2..self.starts.len() {
            self.starts[i] += self.starts[i - 1];
        }
        let total = self.starts[count + 1] as usize;
        self.columns.resize(total, 0);
        self.entries.resize(total, 0.0);
        // Filling moves each start one row ahead, to where it belongs.
        for ([i, j], stiffness) in ends.iter().zip(&self.edges).filter(|([i, j], _)| i != j) {
            let entry = stiffness * raise;
            for (row, column) in [(*i as usize, *j), (*j as usize, *i)] {
                let place = self.starts[row + 1] as usize;
                self.starts[row + 1] += 1;
                self.columns[place] = column;
                self.entries[place] = entry;
                self.scalar[row] += entry;
            }
        }
    }

    /// What the diagonal of a node has beyond its mass, kg.
    #[must_use]
    pub fn raised(&self, node: usize) -> f32 {
        self.scalar[node] - self.masses[node] + self.diagonal[node].max_element()
    }

    /// Adds inertia to a node, kg.
    pub fn raise(&mut self, node: usize, by: f32) {
        self.scalar[node] += by;
    }

    /// Number of nodes.
    #[must_use]
    pub fn len(&self) -> usize {
        self.scalar.len()
    }

    /// Whether there is no node.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.scalar.is_empty()
    }

    /// Inverse of the diagonal for free nodes, zero for the others, 1/kg.
    pub fn inverse_diagonal(&self, out: &mut Vec<Vec3A>) {
        let inverse =
            |((v, s), free): ((&Vec3A, &f32), &bool)| if *free && *s > 0.0 { (*v + Vec3A::splat(*s)).recip() } else { Vec3A::ZERO };
        out.clear();
        out.extend(self.diagonal.iter().zip(&self.scalar).zip(&self.free).map(inverse));
    }

    /// Adds to the right-hand side what the given changes of velocity (m/s) of nodes that are not free mean for their neighbours.
    pub fn carry_along(&self, changes: &[(usize, Vec3A)], right: &mut [Vec3A]) {
        if changes.iter().all(|(_, c)| *c == Vec3A::ZERO) {
            return;
        }
        let mut x = vec![Vec3A::ZERO; right.len()];
        for (i, change) in changes {
            x[*i] = *change;
            for k in self.starts[*i] as usize..self.starts[i + 1] as usize {
                right[self.columns[k] as usize] += *change * self.entries[k];
            }
        }
        let mut drag = vec![Vec3A::ZERO; right.len()];
        self.add_volumetric(&x, &mut drag);
        for (r, d) in right.iter_mut().zip(&drag) {
            *r -= *d;
        }
    }

    /// `P x`, with zeros at nodes that are not free, where `x` must be zero; and the product of `x` with it.
    pub fn multiply(&self, x: &[Vec3A], out: &mut [Vec3A]) -> f64 {
        for (i, out) in out.iter_mut().enumerate() {
            let mut sum = x[i] * self.scalar[i];
            let row = self.starts[i] as usize..self.starts[i + 1] as usize;
            for (column, entry) in self.columns[row.clone()].iter().zip(&self.entries[row]) {
                sum -= x[*column as usize] * *entry;
            }
            *out = sum;
        }
        self.add_volumetric(x, out);
        let mut product = 0.0;
        for ((x, out), free) in x.iter().zip(out.iter_mut()).zip(&self.free) {
            if *free {
                product += f64::from(x.dot(*out));
            } else {
                *out = Vec3A::ZERO;
            }
        }
        product
    }

    fn add_volumetric(&self, x: &[Vec3A], out: &mut [Vec3A]) {
        for Volumetric { nodes, gradients: [b, c, d] } in &self.volumetric {
            let at = nodes.map(|n| n as usize);
            let first = x[at[0]];
            let rate = (*b * (x[at[1]] - first) + *c * (x[at[2]] - first) + *d * (x[at[3]] - first)).element_sum();
            let (b, c, d) = (*b * rate, *c * rate, *d * rate);
            out[at[1]] += b;
            out[at[2]] += c;
            out[at[3]] += d;
            out[at[0]] -= b + c + d;
        }
    }

    /// Volumetric terms, their diagonal, and the stiffness of the edges.
    fn stiffness(&mut self, body: &Body, positions: &[Vec3], raise: f32) {
        self.volumetric.clear();
        self.edges.clear();
        self.edges.resize(body.graph.ends().len(), 0.0);
        let squares = |m: &Mat3| m.x_axis.length_squared() + m.y_axis.length_squared() + m.z_axis.length_squared();
        for (e, edges) in body.elements.iter().zip(body.graph.of_element()).filter(|(e, _)| !e.is_empty()) {
            let f = e.deformation(e.indices().map(|i| positions[i]));
            let c = cofactor(f);
            let pressure = e.material.lambda * (f.x_axis.dot(c.x_axis) - e.material.a());
            let kappa = bound(e.material.mu, pressure, squares(&f), f.x_axis.dot(c.x_axis));
            let b = e.inverse_rest.transpose();
            let g = c * b * (raise * e.material.lambda * e.volume).sqrt();
            let at = e.indices();
            let first = g.x_axis + g.y_axis + g.z_axis;
            for (i, g) in at.into_iter().zip([first, g.x_axis, g.y_axis, g.z_axis]) {
                self.diagonal[i] += Vec3A::from(g * g);
            }
            self.volumetric.push(Volumetric { nodes: e.nodes, gradients: [g.x_axis, g.y_axis, g.z_axis].map(Vec3A::from) });
            let gradients = [-(b.x_axis + b.y_axis + b.z_axis), b.x_axis, b.y_axis, b.z_axis];
            for ([i, j], edge) in EDGES.into_iter().zip(edges) {
                self.edges[*edge as usize] -= kappa * e.volume * gradients[i].dot(gradients[j]);
            }
        }
    }
}

/// Largest eigenvalue of `mu |dF|^2 + p d2J[dF, dF]` for `|F|^2 = squares` and `det F = j`, Pa.
///
/// The eigenvalues of `d2J` are plus and minus the singular values of `F`, and the roots of `e^3 - |F|^2 e - 2 J = 0` (Smith, de Goes, Kim 2018,
/// section 4.3). At `e = -s`, `s` a singular value, the cubic is `s` times the square of the difference of the other two: so its outer roots enclose
/// all of them.
fn bound(mu: f32, pressure: f32, squares: f32, j: f32) -> f32 {
    let third = squares / 3.0;
    let size = third.sqrt();
    if size <= 0.0 {
        return mu;
    }
    let angle = (j / (third * size)).clamp(-1.0, 1.0).acos() / 3.0;
    // The largest root, and the smallest.
    let turn = if pressure > 0.0 { angle } else { angle + std::f32::consts::TAU / 3.0 };
    mu + pressure * 2.0 * size * turn.cos()
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy_math::DMat3;
    use proptest::prelude::*;

    fn matrix() -> impl Strategy<Value = DMat3> {
        prop::array::uniform9(-2.0_f64..2.0).prop_map(|m| DMat3::from_cols_array(&m))
    }

    fn squares(m: DMat3) -> f64 {
        m.x_axis.length_squared() + m.y_axis.length_squared() + m.z_axis.length_squared()
    }

    proptest! {
        /// The bound holds along every direction. `det` is cubic along a line, so its second difference is its second derivative.
        #[test]
        fn bounds_the_tangent(f in matrix(), d in matrix(), pressure in -20.0_f64..20.0) {
            let second = (f + d).determinant() + (f - d).determinant() - 2.0 * f.determinant();
            let kappa = bound(1.0, pressure as f32, squares(f) as f32, f.determinant() as f32);
            let (tangent, most) = (squares(d) + pressure * second, f64::from(kappa) * squares(d));
            // f32, and the arc cosine near its ends.
            let rounding = 1e-3 * (1.0 + pressure.abs() * squares(f).sqrt()) * squares(d);
            prop_assert!(tangent <= most + rounding, "{} > {}", tangent, most);
        }

        /// It is no looser than the norm of F, and not below what a stretch of one axis at the cost of another meets.
        #[test]
        fn is_not_loose(s in 0.1_f64..2.0, t in 0.1_f64..2.0, pressure in -20.0_f64..0.0) {
            let f = DMat3::from_diagonal(bevy_math::DVec3::new(s, s, t));
            let d = DMat3::from_diagonal(bevy_math::DVec3::new(1.0, -1.0, 0.0));
            let second = (f + d).determinant() + (f - d).determinant() - 2.0 * f.determinant();
            let along = 1.0 + pressure * second / squares(d);
            let kappa = f64::from(bound(1.0, pressure as f32, squares(f) as f32, f.determinant() as f32));
            // That direction has the eigenvalue -t of the second derivative; the bound is at least that and at most the norm of F.
            prop_assert!(kappa >= along * (1.0 - 1e-3) - 1e-3);
            prop_assert!(kappa <= 1.0 - pressure * squares(f).sqrt() * 1.001 + 1e-3);
        }
    }

    #[test]
    fn is_twice_the_shear_modulus_at_rest() {
        assert!((bound(3.0, -3.0, 3.0, 1.0) - 6.0).abs() < 1e-5);
    }
}
