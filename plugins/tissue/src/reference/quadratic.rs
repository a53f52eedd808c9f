//! Ten-node tetrahedra: displacements quadratic in each element, so that nearly incompressible material does not lock as it does with linear ones.
//!
//! At rest the edges are straight and the middle nodes half way, so an element's gradients are linear in its barycentric coordinates; four points of equal weight
//! integrate what linear elasticity needs exactly. With `g_i` the gradients of the ten shape functions at a point, `F = sum x_i g_i'`, `c_i = cof F g_i` and
//! `p = lambda (J - a)`, force and tangent are those of [`super::energy`], summed over the points; they hold for any gradients, for `J` is linear in each node.

use super::energy::{cofactor, skew};
use super::{Problem, ReferenceError};
use crate::material::NeoHookean;
use bevy_math::{DMat3, DVec3};
use keyhole_tetmesh::{NodeId, TetMesh};
use keyhole_whiteboard::OrganMaterials;
use std::collections::BTreeMap;

/// The edges of a tetrahedron in the order of its middle nodes, 4 to 9.
pub const EDGES: [[usize; 2]; 6] = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];

/// Barycentric coordinates of the four points: one of the first, three of the second (Hammer, Marlowe, Stroud 1956).
const POINT: [f64; 2] = [0.585_410_196_624_968_5, 0.138_196_601_125_010_5];

/// Share of an element's mass at a corner and at a middle node: the diagonal of the consistent matrix, scaled to the whole mass (Hinton, Rock, Zienkiewicz 1976).
const MASS: [f64; 2] = [1.0 / 36.0, 4.0 / 27.0];

/// A ten-node tetrahedron.
#[derive(Clone, Debug, PartialEq)]
pub struct Quadratic {
    /// Its nodes, as indices of node slots: corners, then those between them in the order of [`EDGES`].
    pub nodes: [u32; 10],
    /// Gradients of the ten shape functions at the four points, 1/m.
    pub gradients: [[DVec3; 10]; 4],
    /// Rest volume, m3.
    pub volume: f64,
    /// Shear modulus, Pa.
    pub mu: f64,
    /// Lame's first parameter plus `mu`, Pa.
    pub lambda: f64,
}

impl Quadratic {
    /// An element with the given rest positions of its corners, m.
    #[must_use]
    pub fn new(nodes: [u32; 10], p: [DVec3; 4], material: NeoHookean) -> Self {
        let [_, a, b, c] = p.map(|q| q - p[0]);
        let six = a.dot(b.cross(c));
        let g = [b.cross(c) / six, c.cross(a) / six, a.cross(b) / six];
        let g = [-(g[0] + g[1] + g[2]), g[0], g[1], g[2]];
        let gradients = std::array::from_fn(|point| {
            let l: [f64; 4] = std::array::from_fn(|i| POINT[usize::from(i != point)]);
            std::array::from_fn(|n| match n.checked_sub(4) {
                None => g[n] * (4.0 * l[n] - 1.0),
                Some(edge) => {
                    let [i, j] = EDGES[edge];
                    (g[j] * l[i] + g[i] * l[j]) * 4.0
                }
            })
        });
        Self { nodes, gradients, volume: six / 6.0, mu: f64::from(material.mu), lambda: f64::from(material.lambda) }
    }

    /// The positions of its nodes among all.
    #[must_use]
    pub fn at(&self, positions: &[DVec3]) -> [DVec3; 10] {
        self.nodes.map(|n| positions[n as usize])
    }

    /// Deformation gradients at the four points.
    fn deformations(&self, x: &[DVec3; 10]) -> [DMat3; 4] {
        self.gradients.map(|g| {
            let mut f = DMat3::ZERO;
            for (x, g) in x.iter().zip(g) {
                f += DMat3::from_cols(*x * g.x, *x * g.y, *x * g.z);
            }
            f
        })
    }

    /// Energy, J: zero at rest.
    #[must_use]
    pub fn energy(&self, x: [DVec3; 10]) -> f64 {
        let f = self.deformations(&x);
        let a = 1.0 + self.mu / self.lambda;
        let at = |f: &DMat3| {
            let squares = f.x_axis.length_squared() + f.y_axis.length_squared() + f.z_axis.length_squared();
            let j = f.determinant();
            self.mu / 2.0 * (squares - 3.0) + self.lambda / 2.0 * (j - 1.0) * (j + 1.0 - 2.0 * a)
        };
        self.volume / 4.0 * f.iter().map(at).sum::<f64>()
    }

    /// Derivative of the energy's volumetric term, Pa.
    fn pressure(&self, f: &DMat3) -> f64 {
        self.lambda * (f.determinant() - 1.0) - self.mu
    }

    /// Forces on the nodes, N.
    #[must_use]
    pub fn forces(&self, x: [DVec3; 10]) -> [DVec3; 10] {
        let f = self.deformations(&x);
        let mut forces = [DVec3::ZERO; 10];
        for (f, gradients) in f.iter().zip(&self.gradients) {
            let stress = *f * self.mu + cofactor(f) * self.pressure(f);
            for (force, g) in forces.iter_mut().zip(gradients) {
                *force -= stress * *g * (self.volume / 4.0);
            }
        }
        forces
    }

    /// The tangent stiffness by pairs of nodes, N/m; `geometric` as in [`super::Tetra::stiffness`].
    #[must_use]
    pub fn stiffness(&self, x: [DVec3; 10], geometric: f64) -> [[DMat3; 10]; 10] {
        let f = self.deformations(&x);
        let mut k = [[DMat3::ZERO; 10]; 10];
        let weight = self.volume / 4.0;
        for (f, gradients) in f.iter().zip(&self.gradients) {
            let cof = cofactor(f);
            let p = geometric * self.pressure(f);
            let c = gradients.map(|g| cof * g);
            for (i, row) in k.iter_mut().enumerate() {
                for (j, block) in row.iter_mut().enumerate() {
                    let (g, h) = (gradients[i], gradients[j]);
                    let bulk = outer(c[i], c[j]) * self.lambda - skew(*f * g.cross(h)) * p;
                    *block += (DMat3::from_diagonal(DVec3::splat(self.mu * g.dot(h))) + bulk) * weight;
                }
            }
        }
        k
    }
}

fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}

impl Problem {
    /// The body of a mesh in ten-node elements: slots of the mesh's nodes as they are, those between them after the last. A middle node is fixed where both
    /// ends of its edge are. The membrane is left out.
    ///
    /// # Errors
    /// When a material has constants that no material has.
    pub fn quadratic(mesh: &TetMesh, materials: &OrganMaterials, is_fixed: impl Fn(NodeId) -> bool) -> Result<Self, ReferenceError> {
        let linear = Self::new(mesh, materials, is_fixed)?;
        let constants = materials.0.iter().map(NeoHookean::of).collect::<Result<Vec<_>, _>>()?;
        let Self { mut rest, mut fixed, .. } = linear;
        let mut masses = vec![0.0; rest.len()];
        let mut middles: BTreeMap<[u32; 2], u32> = BTreeMap::new();
        let mut elements = Vec::with_capacity(mesh.tet_count());
        for (tet, corners) in mesh.iter() {
            let corners = corners.map(|n| n.0);
            let mut nodes = [0; 10];
            nodes[..4].copy_from_slice(&corners);
            for (slot, edge) in nodes[4..].iter_mut().zip(EDGES) {
                let mut ends = edge.map(|i| corners[i]);
                ends.sort_unstable();
                *slot = *middles.entry(ends).or_insert_with(|| {
                    let [a, b] = ends.map(|n| n as usize);
                    rest.push((rest[a] + rest[b]) / 2.0);
                    fixed.push(fixed[a] && fixed[b]);
                    masses.push(0.0);
                    rest.len() as u32 - 1
                });
            }
            let id = usize::from(mesh.tet(tet).material.0).min(constants.len() - 1);
            let element = Quadratic::new(nodes, corners.map(|n| rest[n as usize]), constants[id]);
            let mass = f64::from(materials.0[id].density_kg_m3) * element.volume;
            for (i, n) in nodes.iter().enumerate() {
                masses[*n as usize] += mass * MASS[usize::from(i >= 4)];
            }
            elements.push(element);
        }
        Ok(Self { tets: Vec::new(), quadratic: elements, masses, rest, fixed, membrane: None })
    }

    /// The slot of the node between two of a body of ten-node elements; nothing where no edge joins them.
    #[must_use]
    pub fn middle(&self, a: NodeId, b: NodeId) -> Option<usize> {
        let between = |e: &Quadratic| {
            let place = |n: NodeId| e.nodes[..4].iter().position(|m| *m == n.0);
            let ends = [place(a)?, place(b)?];
            let edge = EDGES.iter().position(|edge| edge.iter().all(|i| ends.contains(i)))?;
            Some(e.nodes[4 + edge] as usize)
        };
        self.quadratic.iter().find_map(between)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn vector() -> impl Strategy<Value = DVec3> {
        [-1.0..1.0, -1.0..1.0, -1.0..1.0].prop_map(DVec3::from_array)
    }

    proptest! {
        /// Force is minus the gradient of the energy, the tangent that of minus the force, by central differences, far from rest.
        #[test]
        fn derivatives(x in prop::array::uniform10(vector()), d in prop::array::uniform10(vector()), nu in 0.0..0.49_f32) {
            let rest = [DVec3::ZERO, DVec3::new(1.0, 0.1, 0.0), DVec3::new(0.2, 0.9, 0.1), DVec3::new(0.1, 0.3, 1.1)];
            let mu = 1.0 / (2.0 * (1.0 + nu));
            let material = NeoHookean { mu, lambda: nu / ((1.0 + nu) * (1.0 - 2.0 * nu)) + mu };
            let t = Quadratic::new(std::array::from_fn(|i| i as u32), rest, material);
            let h = 1e-6;
            let moved = |s: f64| std::array::from_fn(|i| x[i] + d[i] * (s * h));
            let slope = (t.energy(moved(1.0)) - t.energy(moved(-1.0))) / (2.0 * h);
            let forces = t.forces(x);
            let work: f64 = forces.iter().zip(d).map(|(f, d)| f.dot(d)).sum();
            let size = forces.iter().map(|f| f.length()).sum::<f64>() + 1.0;
            prop_assert!((slope + work).abs() < 1e-5 * size, "{slope} {work} of {size}");
            let (ahead, behind) = (t.forces(moved(1.0)), t.forces(moved(-1.0)));
            let k = t.stiffness(x, 1.0);
            let stiff = k.iter().flatten().map(|b| b.determinant().abs().cbrt()).sum::<f64>() + size;
            for i in 0..10 {
                let exact: DVec3 = (0..10).map(|j| k[i][j] * d[j]).sum();
                prop_assert!((exact + (ahead[i] - behind[i]) / (2.0 * h)).length() < 1e-5 * stiff);
                for (j, row) in k.iter().enumerate() {
                    prop_assert!((k[i][j] - row[i].transpose()).abs_diff_eq(DMat3::ZERO, 1e-12 * stiff));
                }
            }
            // A rigid motion and a dilation: what linear elements say.
            let turned: [DVec3; 4] = rest.map(|p| DMat3::from_rotation_z(0.3) * p * 1.1);
            let all = std::array::from_fn(|i| if i < 4 { turned[i] } else { EDGES[i - 4].map(|e| turned[e]).iter().sum::<DVec3>() / 2.0 });
            let linear = super::super::Tetra::new([0, 1, 2, 3], rest, material);
            prop_assert!((t.energy(all) - linear.energy(turned)).abs() < 1e-12 * (1.0 + f64::from(material.lambda)));
        }
    }
}
