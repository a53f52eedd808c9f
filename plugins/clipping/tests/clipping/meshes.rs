//! Meshes for tests.

use keyhole_tetmesh::{DVec3, TetMesh};

/// A box of cubes, six tetrahedra each, from the origin: `size` in metres.
pub fn block(cells: [u32; 3], size: [f64; 3]) -> TetMesh {
    let [nx, ny, nz] = cells.map(|n| n + 1);
    let at = |i: u32, n: u32, size: f64| f64::from(i) / f64::from(n) * size;
    let grid = (0..nz).flat_map(|z| (0..ny).flat_map(move |y| (0..nx).map(move |x| (x, y, z))));
    let nodes = grid.map(|(x, y, z)| DVec3::new(at(x, cells[0], size[0]), at(y, cells[1], size[1]), at(z, cells[2], size[2]))).collect();
    let node = |x: u32, y: u32, z: u32| x + nx * (y + ny * z);
    let mut tets = Vec::new();
    for (x, y, z) in (0..cells[2]).flat_map(|z| (0..cells[1]).flat_map(move |y| (0..cells[0]).map(move |x| (x, y, z)))) {
        // Along each of the six ways from corner to opposite corner.
        for ([a, b, _], odd) in
            [([0, 1, 2], false), ([1, 2, 0], false), ([2, 0, 1], false), ([0, 2, 1], true), ([1, 0, 2], true), ([2, 1, 0], true)]
        {
            let step = |axes: &[usize]| {
                let on = |axis: usize| u32::from(axes.contains(&axis));
                node(x + on(0), y + on(1), z + on(2))
            };
            let [p, q, r, s] = [step(&[]), step(&[a]), step(&[a, b]), step(&[0, 1, 2])];
            tets.push(if odd { [p, r, q, s] } else { [p, q, r, s] });
        }
    }
    let mesh = TetMesh::new(nodes, &tets, &[]);
    assert!(mesh.iter().all(|(t, _)| mesh.volume(t) > 0.0));
    mesh
}
