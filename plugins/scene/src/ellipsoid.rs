//! An organ for scenes that bring none.

use crate::section::TUMOUR;
use bevy_math::DVec3;
use keyhole_tetmesh::{MaterialId, TetMesh};

/// An ellipsoid of 11 x 6 x 5.4 cm in shells of a subdivided icosahedron, with a tumour near one end.
#[must_use]
pub fn ellipsoid() -> TetMesh {
    const SHELLS: u32 = 6;
    let size = DVec3::new(0.055, 0.030, 0.027);
    let (directions, faces) = icosphere(2);
    let per_shell = directions.len() as u32;
    let mut nodes = vec![DVec3::ZERO];
    for shell in 1..=SHELLS {
        nodes.extend(directions.iter().map(|d| *d * size * (f64::from(shell) / f64::from(SHELLS))));
    }
    let node = |shell: u32, i: u32| 1 + (shell - 1) * per_shell + i;
    let mut tets = Vec::new();
    for mut face in faces {
        tets.push([0, node(1, face[0]), node(1, face[1]), node(1, face[2])]);
        // A prism is split by its corners in ascending order, so that neighbours split their common side alike.
        face.sort_unstable();
        for shell in 1..SHELLS {
            let [a, b, c] = face.map(|i| node(shell, i));
            let [d, e, f] = face.map(|i| node(shell + 1, i));
            tets.extend([[a, b, c, f], [a, b, e, f], [a, d, e, f]]);
        }
    }
    for t in &mut tets {
        let [a, b, c, d] = t.map(|i| nodes[i as usize]);
        if (b - a).dot((c - a).cross(d - a)) < 0.0 {
            t.swap(2, 3);
        }
    }
    let tumour = DVec3::new(0.036, 0.006, 0.004);
    let middle = |t: &[u32; 4]| t.iter().map(|i| nodes[*i as usize]).sum::<DVec3>() / 4.0;
    let materials: Vec<MaterialId> = tets.iter().map(|t| if middle(t).distance(tumour) < 0.014 { TUMOUR } else { MaterialId(0) }).collect();
    TetMesh::new(nodes, &tets, &materials)
}

/// Directions and faces of an icosahedron whose faces are each split in four, `times` times.
fn icosphere(times: u32) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let golden = (1.0 + 5f64.sqrt()) / 2.0;
    let mut points: Vec<DVec3> = Vec::new();
    for (a, b) in [(-1.0, golden), (1.0, golden), (-1.0, -golden), (1.0, -golden)] {
        points.extend([DVec3::new(a, b, 0.0), DVec3::new(0.0, a, b), DVec3::new(b, 0.0, a)]);
    }
    let edge = 2.0;
    let near = |i: usize, j: usize| (points[i].distance(points[j]) - edge).abs() < 1e-9 * edge;
    let mut faces = Vec::new();
    for i in 0..12 {
        for j in i + 1..12 {
            for k in j + 1..12 {
                if near(i, j) && near(j, k) && near(i, k) {
                    faces.push([i as u32, j as u32, k as u32]);
                }
            }
        }
    }
    for p in &mut points {
        *p = p.normalize();
    }
    for _ in 0..times {
        let mut middles = std::collections::BTreeMap::new();
        let mut middle = |a: u32, b: u32| {
            *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                points.push((points[a as usize] + points[b as usize]).normalize());
                points.len() as u32 - 1
            })
        };
        faces = faces
            .iter()
            .flat_map(|&[a, b, c]| {
                let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
    }
    (points, faces)
}
