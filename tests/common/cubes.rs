//! Blocks of tissue in cubes of five tetrahedra.

use bevy::math::DVec3;
use keyhole_tetmesh::TetMesh;

/// A block of so many cubes along each axis. `place` puts the corners of the cubes, which are whole numbers, where they are, m; it must not mirror them.
pub fn block(counts: [usize; 3], place: impl Fn(DVec3) -> DVec3) -> TetMesh {
    let [nx, ny, nz] = counts;
    let id = |i: usize, j: usize, k: usize| (i + (nx + 1) * (j + (ny + 1) * k)) as u32;
    let mut nodes = Vec::new();
    for k in 0..=nz {
        for j in 0..=ny {
            nodes.extend((0..=nx).map(|i| place(DVec3::new(i as f64, j as f64, k as f64))));
        }
    }
    let mut tets = Vec::new();
    for (i, j, k) in (0..nx * ny * nz).map(|c| (c % nx, c / nx % ny, c / nx / ny)) {
        // Corner b of the cube has the bits x, y, z; odd cubes are mirrored so that the diagonals of shared faces agree.
        for five in [[0, 1, 2, 4], [3, 1, 7, 2], [5, 1, 4, 7], [6, 2, 7, 4], [1, 2, 4, 7]] {
            let five = if (i + j + k) % 2 == 0 { five } else { five.map(|b| b ^ 1) };
            let mut tet = five.map(|b: usize| id(i + (b & 1), j + (b >> 1 & 1), k + (b >> 2 & 1)));
            let [a, b, c, d] = tet.map(|n| nodes[n as usize]);
            if (b - a).dot((c - a).cross(d - a)) < 0.0 {
                tet.swap(0, 1);
            }
            tets.push(tet);
        }
    }
    TetMesh::new(nodes, &tets, &[])
}
