//! The beam that engines are compared on: 0.06 x 0.03 x 0.03 m of cubes of five tetrahedra, mirrored in every second one; clamped at x = 0, loaded
//! by gravity, E 10 kPa, nu 0.45, 1050 kg/m3.
//!
//! Static Newton in f64 on the same meshes: the tip hangs 21.763 mm low with 10 x 5 x 5 cubes, 23.446 with 16 x 8 x 8, 24.340 with 26 x 13 x 13, 24.676 with 36 x 18 x 18; with
//! quadratic elements 25.06, so these meshes themselves are 13, 6, 3 and 1.5 % off.

use crate::hold::Hold;
use bevy_math::Vec3;
use keyhole_tetmesh::{DVec3, NodeId, TetMesh};
use keyhole_whiteboard::{OrganMaterial, OrganMaterials, TissueState};
use smallvec::smallvec;

/// Earth's gravity along -y, m/s2.
pub const GRAVITY: Vec3 = Vec3::new(0.0, -9.81, 0.0);

/// Cubes along the beam and over its height, and where its tip hangs by static Newton, mm.
pub const REFERENCE: [([u32; 2], f64); 4] = [([10, 5], -21.763), ([16, 8], -23.446), ([26, 13], -24.340), ([36, 18], -24.676)];

/// A box of `cells` cubes, five tetrahedra each, with the given size in metres, one corner at the origin.
#[must_use]
pub fn block(cells: [u32; 3], size: [f64; 3]) -> TetMesh {
    let [nx, ny, nz] = cells;
    let id = |i: u32, j: u32, k: u32| (i * (ny + 1) + j) * (nz + 1) + k;
    let mut nodes = Vec::new();
    for i in 0..=nx {
        for j in 0..=ny {
            for k in 0..=nz {
                let at = |n: u32, of: u32, length: f64| length * f64::from(n) / f64::from(of);
                nodes.push(DVec3::new(at(i, nx, size[0]), at(j, ny, size[1]), at(k, nz, size[2])));
            }
        }
    }
    let mut tets = Vec::new();
    for i in 0..nx {
        for j in 0..ny {
            for k in 0..nz {
                let odd = (i + j + k) % 2 == 1;
                let c = |x: u32, y: u32, z: u32| id(i + if odd { 1 - x } else { x }, j + y, k + z);
                let five = [
                    [c(1, 0, 0), c(0, 1, 0), c(0, 0, 1), c(1, 1, 1)],
                    [c(0, 0, 0), c(1, 0, 0), c(0, 1, 0), c(0, 0, 1)],
                    [c(1, 1, 0), c(1, 0, 0), c(1, 1, 1), c(0, 1, 0)],
                    [c(1, 0, 1), c(1, 0, 0), c(0, 0, 1), c(1, 1, 1)],
                    [c(0, 1, 1), c(0, 1, 0), c(1, 1, 1), c(0, 0, 1)],
                ];
                for mut t in five {
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

/// The beam with `m` cubes over its height and `n` along it.
#[must_use]
pub fn beam(n: u32, m: u32) -> TetMesh {
    block([n, m, m], [0.06, 0.03, 0.03])
}

/// Its material: E 10 kPa, nu 0.45, 1050 kg/m3.
#[must_use]
pub fn beam_material() -> OrganMaterials {
    OrganMaterials(vec![OrganMaterial { young_modulus_pa: 10_000.0, poisson_ratio: 0.45, density_kg_m3: 1050.0, ..Default::default() }])
}

/// The face x = 0, clamped.
#[must_use]
pub fn clamp(mesh: &TetMesh) -> Vec<Hold> {
    let at_wall = mesh.nodes().filter(|n| mesh.rest(*n).x == 0.0);
    at_wall.map(|n| fix(n, mesh.rest(n).as_vec3())).collect()
}

/// A node fixed to a point.
#[must_use]
pub fn fix(node: NodeId, position: Vec3) -> Hold {
    Hold { point: smallvec![(node, 1.0)], from: position, to: position, compliance_m_n: 0.0 }
}

/// Mean displacement of the free end face along y, mm.
#[must_use]
pub fn tip_mm(mesh: &TetMesh, state: &TissueState) -> f64 {
    let end = mesh.nodes().map(|n| mesh.rest(n).x).fold(0.0, f64::max);
    let tip: Vec<NodeId> = mesh.nodes().filter(|n| mesh.rest(*n).x == end).collect();
    tip.iter().map(|n| f64::from(state.position(*n).y) - mesh.rest(*n).y).sum::<f64>() / tip.len() as f64 * 1e3
}
