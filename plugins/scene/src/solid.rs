//! Simple shapes of tetrahedra: a grid of cells, each split into the six tetrahedra around its long diagonal (Kuhn 1960), so that neighbours split their
//! common side alike, around a ring too.

use crate::format::SceneSolid;
use bevy_math::{DVec3, Vec3};
use keyhole_tetmesh::TetMesh;
use std::f64::consts::TAU;

/// The order in which a path from a cell's lowest corner to its highest takes the axes.
const PATHS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];

impl SceneSolid {
    /// The mesh, m. The shape is one that [`crate::check()`] finds nothing wrong with.
    #[must_use]
    pub fn mesh(&self) -> TetMesh {
        match *self {
            Self::Block { size, cells } => {
                let size = Vec3::from_array(size).as_dvec3();
                grid(cells, false, |u| (u - DVec3::splat(0.5)) * size)
            }
            Self::Tube { length, outer_radius, inner_radius, cells } => {
                let (length, outer, inner) = (f64::from(length), f64::from(outer_radius), f64::from(inner_radius));
                grid(cells, true, |u| {
                    let (radius, (s, c)) = (inner + u.z * (outer - inner), (TAU * u.y).sin_cos());
                    DVec3::new(radius * c, (u.x - 0.5) * length, radius * s)
                })
            }
        }
    }
}

/// A grid of cells on the unit cube, closed along its second axis if it is a ring, and its image under `place`.
fn grid(cells: [u32; 3], ring: bool, place: impl Fn(DVec3) -> DVec3) -> TetMesh {
    let nodes_along = [cells[0] + 1, if ring { cells[1] } else { cells[1] + 1 }, cells[2] + 1];
    let id = |at: [u32; 3]| at[0] + nodes_along[0] * (at[1] % nodes_along[1] + nodes_along[1] * at[2]);
    let all = |n: [u32; 3]| (0..n[2]).flat_map(move |k| (0..n[1]).flat_map(move |j| (0..n[0]).map(move |i| [i, j, k])));
    let share = |at: [u32; 3]| DVec3::from_array([0, 1, 2].map(|axis| f64::from(at[axis]) / f64::from(cells[axis])));
    let nodes: Vec<DVec3> = all(nodes_along).map(|at| place(share(at))).collect();
    let mut tets = Vec::new();
    for cell in all(cells) {
        for path in PATHS {
            let mut corner = cell;
            let mut tet = [id(corner); 4];
            for (step, axis) in path.into_iter().enumerate() {
                corner[axis] += 1;
                tet[step + 1] = id(corner);
            }
            let [a, b, c, d] = tet.map(|n| nodes[n as usize]);
            if (b - a).dot((c - a).cross(d - a)) < 0.0 {
                tet.swap(2, 3);
            }
            tets.push(tet);
        }
    }
    TetMesh::new(nodes, &tets, &[])
}

#[cfg(test)]
mod tests {
    use super::*;
    use keyhole_tetmesh::Boundary;
    use proptest::prelude::*;
    use std::f64::consts::PI;

    proptest! {
        #[test]
        fn shapes_are_closed_and_have_their_volume(cells in (1u32..7, 3u32..9, 1u32..5), size in (1e-3f32..0.1, 1e-3f32..0.1, 1e-3f32..0.1)) {
            let cells = [cells.0, cells.1, cells.2];
            let block = SceneSolid::Block { size: size.into(), cells }.mesh();
            prop_assert!(Boundary::of(&block).is_closed_manifold());
            let volume = f64::from(size.0) * f64::from(size.1) * f64::from(size.2);
            prop_assert!((block.total_volume() / volume - 1.0).abs() < 1e-9);
            let (inner, outer) = (size.1, size.1 + size.2);
            let tube = SceneSolid::Tube { length: size.0, outer_radius: outer, inner_radius: inner, cells }.mesh();
            prop_assert!(Boundary::of(&tube).is_closed_manifold());
            // A prism on regular polygons, whose sides are flat.
            let n = f64::from(cells[1]);
            let polygon = |r: f32| n / 2.0 * f64::from(r).powi(2) * (2.0 * PI / n).sin();
            let exact = f64::from(size.0) * (polygon(outer) - polygon(inner));
            prop_assert!((tube.total_volume() / exact - 1.0).abs() < 1e-9, "{} {exact}", tube.total_volume());
        }
    }
}
