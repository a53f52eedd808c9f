//! One tetrahedron of a body: its rest shape and the neo-Hookean energy of its deformation.

use crate::material::NeoHookean;
use bevy_math::{DMat3, DVec3, Mat3, Vec3};

const EMPTY: u32 = u32::MAX;

/// A linear tetrahedron. An element whose slot is empty says so by [`Element::is_empty`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Element {
    /// Its nodes, as indices of node slots.
    pub nodes: [u32; 4],
    /// Inverse of the matrix whose columns are the rest edges from node 0, 1/m. Computed in f64.
    pub inverse_rest: Mat3,
    /// Rest volume, m3.
    pub volume: f32,
    /// Elastic constants; those of a thin element are lower than its material's, see [`THIN`].
    pub material: NeoHookean,
    /// Whether it is thinner than [`THIN`].
    pub thin: bool,
}

/// An element whose smallest altitude is below this part of its longest edge is as stiff as if that were its altitude: a cut leaves slivers along its
/// surface, whose stiffness against being pressed flat grows without bound as they get thinner, while a motion of their nodes that is nothing to
/// the organ turns them inside out. A layer of them yields as a layer of that thickness would. Meshes with dihedral angles above 10 degrees have none.
pub const THIN: f64 = 0.1;

impl Element {
    /// The element of a slot that is not in use.
    pub const VACANT: Self =
        Self { nodes: [EMPTY; 4], inverse_rest: Mat3::ZERO, volume: 0.0, material: NeoHookean { mu: 0.0, lambda: 0.0 }, thin: false };

    /// An element with the given rest positions, m.
    #[must_use]
    pub fn new(nodes: [u32; 4], rest: [DVec3; 4], material: NeoHookean) -> Self {
        let edges = DMat3::from_cols(rest[1] - rest[0], rest[2] - rest[0], rest[3] - rest[0]);
        let points = rest.map(|p| keyhole_tetmesh::DVec3::new(p.x, p.y, p.z));
        let longest = keyhole_tetmesh::EDGES.iter().map(|&[i, j]| rest[i].distance(rest[j])).fold(0.0, f64::max);
        let share = (keyhole_tetmesh::quality::min_altitude(points) / (THIN * longest)).min(1.0) as f32;
        let material = NeoHookean { mu: material.mu * share, lambda: material.lambda * share };
        Self { nodes, inverse_rest: edges.inverse().as_mat3(), volume: (edges.determinant() / 6.0) as f32, material, thin: share < 1.0 }
    }

    /// Whether the slot is not in use.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.nodes[0] == EMPTY
    }

    /// The nodes as indices of arrays.
    #[must_use]
    pub fn indices(&self) -> [usize; 4] {
        self.nodes.map(|n| n as usize)
    }

    /// Deformation gradient for the given positions of the four nodes, m.
    #[must_use]
    #[inline]
    pub fn deformation(&self, p: [Vec3; 4]) -> Mat3 {
        Mat3::from_cols(p[1] - p[0], p[2] - p[0], p[3] - p[0]) * self.inverse_rest
    }

    /// Elastic energy, J, in f64: zero at rest.
    #[must_use]
    pub fn energy(&self, p: [Vec3; 4]) -> f64 {
        let f = self.deformation(p).as_dmat3();
        let (mu, lambda) = (f64::from(self.material.mu), f64::from(self.material.lambda));
        let squares = f.x_axis.length_squared() + f.y_axis.length_squared() + f.z_axis.length_squared();
        let a = 1.0 + mu / lambda;
        let volumetric = (f.determinant() - a).powi(2) - (1.0 - a).powi(2);
        f64::from(self.volume) * (mu / 2.0 * (squares - 3.0) + lambda / 2.0 * volumetric)
    }

    /// Forces on nodes 1, 2 and 3 by a first Piola-Kirchhoff stress (Pa), as columns, N; that on node 0 is minus their sum.
    #[must_use]
    #[inline]
    pub fn forces(&self, stress: Mat3) -> Mat3 {
        stress * self.inverse_rest.transpose() * -self.volume
    }
}

/// The cofactor matrix, which is the gradient of the determinant.
#[must_use]
#[inline]
pub fn cofactor(f: Mat3) -> Mat3 {
    Mat3::from_cols(f.y_axis.cross(f.z_axis), f.z_axis.cross(f.x_axis), f.x_axis.cross(f.y_axis))
}
