//! Energy, forces and tangent of one linear tetrahedron in f64.
//!
//! With `g_i` the gradients of the shape functions, `F = sum x_i g_i'`, `c_i = cof F g_i` and `p = lambda (J - a)`:
//!
//! - force on node i: `-V (mu F g_i + p c_i)`;
//! - tangent: `V (mu g_i.g_j I + lambda c_i c_j' - p [F (g_i x g_j)]x)`, for `J` is linear in each node.

use crate::material::NeoHookean;
use bevy_math::{DMat3, DVec3};

/// A linear tetrahedron.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tetra {
    /// Its nodes, as indices of node slots.
    pub nodes: [u32; 4],
    /// Gradients of the four shape functions, 1/m.
    pub gradients: [DVec3; 4],
    /// Rest volume, m3.
    pub volume: f64,
    /// Shear modulus, Pa.
    pub mu: f64,
    /// Lame's first parameter plus `mu`, Pa.
    pub lambda: f64,
}

impl Tetra {
    /// A tetrahedron with the given rest positions, m.
    #[must_use]
    pub fn new(nodes: [u32; 4], p: [DVec3; 4], material: NeoHookean) -> Self {
        let (a, b, c) = (p[1] - p[0], p[2] - p[0], p[3] - p[0]);
        let six = a.dot(b.cross(c));
        let g = [b.cross(c) / six, c.cross(a) / six, a.cross(b) / six];
        let gradients = [-(g[0] + g[1] + g[2]), g[0], g[1], g[2]];
        Self { nodes, gradients, volume: six / 6.0, mu: f64::from(material.mu), lambda: f64::from(material.lambda) }
    }

    /// The positions of its nodes among all.
    #[must_use]
    pub fn at(&self, positions: &[DVec3]) -> [DVec3; 4] {
        self.nodes.map(|n| positions[n as usize])
    }

    /// Deformation gradient.
    #[must_use]
    pub fn deformation(&self, x: [DVec3; 4]) -> DMat3 {
        let (u, v, w) = (x[1] - x[0], x[2] - x[0], x[3] - x[0]);
        let [_, g, h, k] = self.gradients;
        DMat3::from_cols(u * g.x + v * h.x + w * k.x, u * g.y + v * h.y + w * k.y, u * g.z + v * h.z + w * k.z)
    }

    /// Energy, J: zero at rest.
    #[must_use]
    pub fn energy(&self, x: [DVec3; 4]) -> f64 {
        let f = self.deformation(x);
        let squares = f.x_axis.length_squared() + f.y_axis.length_squared() + f.z_axis.length_squared();
        let a = 1.0 + self.mu / self.lambda;
        let j = f.determinant();
        // (J - a)^2 - (1 - a)^2 without the difference of large numbers.
        let volumetric = (j - 1.0) * (j + 1.0 - 2.0 * a);
        self.volume * (self.mu / 2.0 * (squares - 3.0) + self.lambda / 2.0 * volumetric)
    }

    fn pressure(&self, f: &DMat3) -> f64 {
        self.lambda * (f.determinant() - 1.0) - self.mu
    }

    /// Forces on the nodes, N.
    #[must_use]
    pub fn forces(&self, x: [DVec3; 4]) -> [DVec3; 4] {
        let f = self.deformation(x);
        let stress = f * self.mu + cofactor(&f) * self.pressure(&f);
        self.gradients.map(|g| stress * g * -self.volume)
    }

    /// The tangent stiffness by pairs of nodes, N/m. `geometric` in [0, 1] is the part of the term of `d2J` that is taken: with 0 the tangent is
    /// positive definite but for translations, with 1 it is exact.
    #[must_use]
    pub fn stiffness(&self, x: [DVec3; 4], geometric: f64) -> [[DMat3; 4]; 4] {
        let f = self.deformation(x);
        let cof = cofactor(&f);
        let p = geometric * self.pressure(&f);
        let c = self.gradients.map(|g| cof * g);
        std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                let (g, h) = (self.gradients[i], self.gradients[j]);
                let outer = DMat3::from_cols(c[i] * c[j].x, c[i] * c[j].y, c[i] * c[j].z) * self.lambda;
                (DMat3::from_diagonal(DVec3::splat(self.mu * g.dot(h))) + outer - skew(f * g.cross(h)) * p) * self.volume
            })
        })
    }
}

/// The cofactor matrix, which is the gradient of the determinant.
#[must_use]
pub fn cofactor(f: &DMat3) -> DMat3 {
    DMat3::from_cols(f.y_axis.cross(f.z_axis), f.z_axis.cross(f.x_axis), f.x_axis.cross(f.y_axis))
}

/// The matrix of the cross product: `skew(w) v = w x v`.
#[must_use]
pub fn skew(w: DVec3) -> DMat3 {
    DMat3::from_cols(DVec3::new(0.0, w.z, -w.y), DVec3::new(-w.z, 0.0, w.x), DVec3::new(w.y, -w.x, 0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn vector() -> impl Strategy<Value = DVec3> {
        [-1.0..1.0, -1.0..1.0, -1.0..1.0].prop_map(DVec3::from_array)
    }

    proptest! {
        /// Force is minus the gradient of the energy, the tangent is that of minus the force, by central differences; inverted elements as well.
        #[test]
        fn derivatives(x in [vector(), vector(), vector(), vector()], d in [vector(), vector(), vector(), vector()], nu in 0.0..0.49_f32) {
            let rest = [DVec3::ZERO, DVec3::new(1.0, 0.1, 0.0), DVec3::new(0.2, 0.9, 0.1), DVec3::new(0.1, 0.3, 1.1)];
            let mu = 1.0 / (2.0 * (1.0 + nu));
            let material = NeoHookean { mu, lambda: nu / ((1.0 + nu) * (1.0 - 2.0 * nu)) + mu };
            let t = Tetra::new([0, 1, 2, 3], rest, material);
            let h = 1e-5;
            let moved = |s: f64| std::array::from_fn(|i| x[i] + d[i] * (s * h));
            let slope = (t.energy(moved(1.0)) - t.energy(moved(-1.0))) / (2.0 * h);
            let work: f64 = t.forces(x).iter().zip(d).map(|(f, d)| f.dot(d)).sum();
            let scale = 1.0 + slope.abs() + f64::from(material.lambda);
            prop_assert!((slope + work).abs() < 1e-7 * scale, "{slope} {work}");
            let (ahead, behind) = (t.forces(moved(1.0)), t.forces(moved(-1.0)));
            let k = t.stiffness(x, 1.0);
            for i in 0..4 {
                let exact: DVec3 = (0..4).map(|j| k[i][j] * d[j]).sum();
                prop_assert!((exact + (ahead[i] - behind[i]) / (2.0 * h)).length() < 1e-7 * scale);
                for (j, row) in k.iter().enumerate() {
                    prop_assert!((k[i][j] - row[i].transpose()).abs_diff_eq(DMat3::ZERO, 1e-12 * scale));
                }
            }
            let quadratic: f64 = (0..16).map(|n| d[n / 4].dot(t.stiffness(x, 0.0)[n / 4][n % 4] * d[n % 4])).sum();
            prop_assert!(quadratic >= -1e-12 * scale);
        }
    }
}
