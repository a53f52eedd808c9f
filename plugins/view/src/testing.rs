//! Meshes for the tests of this crate.

use bevy::math::DVec3;
use keyhole_tetmesh::{NodeId, TetMesh};
use std::collections::{BTreeMap, BTreeSet};

/// A block of cubes with five tetrahedra each, one octant at the origin, edges of `edge` m.
pub(crate) fn block(cells: [usize; 3], edge: f64) -> TetMesh {
    let [nx, ny, nz] = cells;
    let id = |i: usize, j: usize, k: usize| (i + (nx + 1) * (j + (ny + 1) * k)) as u32;
    let mut nodes = Vec::new();
    for k in 0..=nz {
        for j in 0..=ny {
            for i in 0..=nx {
                nodes.push(DVec3::new(i as f64, j as f64, k as f64) * edge);
            }
        }
    }
    let mut tets = Vec::new();
    for k in 0..nz {
        for j in 0..ny {
            for i in 0..nx {
                // Corner b of the cube has the bits x, y, z; odd cubes are mirrored so that the diagonals of shared faces agree.
                let c = |b: usize| id(i + (b & 1), j + (b >> 1 & 1), k + (b >> 2 & 1));
                let five = [[0, 1, 2, 4], [3, 1, 7, 2], [5, 1, 4, 7], [6, 2, 7, 4], [1, 2, 4, 7]];
                for t in five {
                    let t = if (i + j + k) % 2 == 0 { t } else { t.map(|b| b ^ 1) };
                    let mut t = t.map(c);
                    let p = t.map(|n| nodes[n as usize]);
                    if (p[1] - p[0]).dot((p[2] - p[0]).cross(p[3] - p[0])) < 0.0 {
                        t.swap(2, 3);
                    }
                    tets.push(t);
                }
            }
        }
    }
    TetMesh::new(nodes, &tets, &[])
}

/// Parts a mesh along the faces nearest to a plane: each tetrahedron goes to the side that its middle is on. The surface that opens is as
/// coarse as the mesh. Returns the nodes that were doubled, with their doubles on the side that `normal` points to.
pub(crate) fn parted(mesh: &mut TetMesh, point: DVec3, normal: DVec3) -> Vec<(NodeId, NodeId)> {
    let beyond = |mesh: &TetMesh, tet| (mesh.points(tet).iter().sum::<DVec3>() / 4.0 - point).dot(normal) > 0.0;
    let all: Vec<_> = mesh.iter().collect();
    let sides: BTreeMap<_, _> = all.iter().map(|(tet, _)| (*tet, beyond(mesh, *tet))).collect();
    let here: BTreeSet<NodeId> = all.iter().filter(|(tet, _)| !sides[tet]).flat_map(|(_, corners)| *corners).collect();
    let mut doubles = BTreeMap::new();
    for (tet, corners) in all.into_iter().filter(|(tet, _)| sides[tet]) {
        if corners.iter().any(|n| here.contains(n)) {
            let attributes = mesh.tet(tet);
            let corners = corners.map(|n| if here.contains(&n) { *doubles.entry(n).or_insert_with(|| mesh.split_node(n)) } else { n });
            mesh.remove_tet(tet);
            mesh.add_tet(corners, attributes);
        }
    }
    doubles.into_iter().collect()
}
