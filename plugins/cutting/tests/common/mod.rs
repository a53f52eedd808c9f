//! Meshes, strokes and an oracle for the tests of cutting. The oracle looks at points and tetrahedra alone and shares no code with the
//! kernel.

use keyhole_cutting::{BladeId, Cutter};
use keyhole_tetmesh::{DVec3, TetMesh};
use keyhole_whiteboard::{CutMethod, CutPattern, CutSettings};
use std::collections::HashMap;

/// A block of `n` cubes of edge `h`, five tetrahedra each, mirrored in every second cube, its inner nodes moved by up to `jitter` h.
pub fn block(n: [usize; 3], h: f64, jitter: f64) -> TetMesh {
    let id = |i: usize, j: usize, k: usize| ((i * (n[1] + 1) + j) * (n[2] + 1) + k) as u32;
    let mut seed = 12345_u64;
    let mut random = || {
        seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (seed >> 33) as f64 / (1_u64 << 31) as f64 * 2.0 - 1.0
    };
    let mut nodes = Vec::new();
    for i in 0..=n[0] {
        for j in 0..=n[1] {
            for k in 0..=n[2] {
                let inner = i > 0 && i < n[0] && j > 0 && j < n[1] && k > 0 && k < n[2];
                let off = DVec3::new(random(), random(), random()) * if inner { jitter } else { 0.0 };
                nodes.push((DVec3::new(i as f64, j as f64, k as f64) + off) * h);
            }
        }
    }
    let mut tets = Vec::new();
    for i in 0..n[0] {
        for j in 0..n[1] {
            for k in 0..n[2] {
                let c = |m: usize| id(i + (m & 1), j + (m >> 1 & 1), k + (m >> 2));
                let five: [[usize; 4]; 5] = if (i + j + k) % 2 == 0 {
                    [[0, 1, 2, 4], [3, 2, 1, 7], [5, 1, 4, 7], [6, 4, 2, 7], [1, 2, 4, 7]]
                } else {
                    [[1, 0, 5, 3], [2, 3, 6, 0], [4, 5, 0, 6], [7, 6, 3, 5], [0, 3, 5, 6]]
                };
                for t in five {
                    let mut t = t.map(c);
                    let p = t.map(|m| nodes[m as usize]);
                    if (p[1] - p[0]).dot((p[2] - p[0]).cross(p[3] - p[0])) < 0.0 {
                        t.swap(0, 1);
                    }
                    tets.push(t);
                }
            }
        }
    }
    TetMesh::new(nodes, &tets, &[])
}

/// Settings of a method with one pattern in both layers.
pub fn settings(method: CutMethod, pattern: CutPattern, snap: f64) -> CutSettings {
    CutSettings { method, hull: pattern, core: pattern, snap }
}

/// A straight line of points from tip to heel, spaced for a mesh of edge `h`.
pub fn line(tip: DVec3, heel: DVec3, h: f64) -> Vec<DVec3> {
    let n = ((tip.distance(heel) / (0.35 * h)).ceil() as usize).max(1);
    (0..=n).map(|i| tip.lerp(heel, i as f64 / n as f64)).collect()
}

/// One step of a blade whose line is given in the rest shape.
pub fn step(cutter: &mut Cutter, mesh: &mut TetMesh, line: &[DVec3]) -> keyhole_cutting::StepReport {
    cutter.advance(mesh, BladeId(0), line)
}

/// What the oracle measured.
#[derive(Debug)]
pub struct Verdict {
    pub fragments: usize,
    pub volume: f64,
    pub boundary_area: f64,
    /// Area of the boundary faces that have no other at their place: the skin.
    pub outer_area: f64,
    pub volumes: Vec<f64>,
}

impl Verdict {
    /// Checks that the lips of all cuts lie on each other face by face, so that what has none at its place is the skin as it was, of this area (m2).
    pub fn check_lips(&self, skin_m2: f64) {
        let off = self.outer_area - skin_m2;
        assert!(off.abs() <= 1e-9 * skin_m2, "{off} m2 of the lips do not lie on each other face by face");
    }
}

/// Checks a mesh by its points and tetrahedra alone: positive, no face with more than two tetrahedra, no place with more than two boundary faces.
///
/// Faces are grouped by the places of their corners. An inner face is two tetrahedra by identity; a boundary face is either alone at its place, and then
/// of the skin, or one of a pair of opposite faces of a cut. A hanging node would leave faces inside the body that are alone at their places:
/// see [`Verdict::check_lips`]. (Counting the faces at an edge would not show it: the boundary of any tetrahedra is closed.)
pub fn verdict(mesh: &TetMesh) -> Verdict {
    let tets: Vec<([u32; 4], [DVec3; 4])> = mesh.iter().map(|(t, c)| (c.map(|n| n.0), mesh.points(t))).collect();
    let mut by_face: HashMap<[u32; 3], Vec<usize>> = HashMap::new();
    // Summed with its rounding (Neumaier 1974): thousands of slivers after one large tetrahedron would round one way.
    let (mut volume, mut lost) = (0.0_f64, 0.0_f64);
    let mut each = Vec::new();
    for (i, (c, p)) in tets.iter().enumerate() {
        let v = (p[1] - p[0]).dot((p[2] - p[0]).cross(p[3] - p[0])) / 6.0;
        assert!(v > 0.0, "tetrahedron {c:?} has volume {v}");
        let sum = volume + v;
        lost += if volume >= v { volume - sum + v } else { v - sum + volume };
        volume = sum;
        each.push(v);
        for skip in 0..4 {
            let mut f: Vec<u32> = (0..4).filter(|&k| k != skip).map(|k| c[k]).collect();
            f.sort_unstable();
            by_face.entry([f[0], f[1], f[2]]).or_default().push(i);
        }
    }
    let place = |n: u32| mesh.rest_positions()[n as usize].to_array().map(f64::to_bits);
    let mut parent: Vec<usize> = (0..tets.len()).collect();
    fn root(parent: &mut [usize], mut i: usize) -> usize {
        while parent[i] != i {
            parent[i] = parent[parent[i]];
            i = parent[i];
        }
        i
    }
    let mut boundary_area = 0.0;
    let mut by_place: HashMap<Vec<[u64; 3]>, usize> = HashMap::new();
    for (f, users) in &by_face {
        assert!(users.len() <= 2, "{} tetrahedra at face {f:?}", users.len());
        let mut places: Vec<[u64; 3]> = f.iter().map(|n| place(*n)).collect();
        places.sort_unstable();
        if let [i, j] = users[..] {
            let (a, b) = (root(&mut parent, i), root(&mut parent, j));
            parent[a] = b;
        } else {
            boundary_area += area(&places);
            *by_place.entry(places).or_insert(0) += 1;
        }
    }
    assert!(by_place.values().all(|n| *n <= 2), "three boundary faces at one place");
    let outer_area = by_place.iter().filter(|(_, n)| **n == 1).map(|(f, _)| area(f)).sum();
    let mut volumes: HashMap<usize, f64> = HashMap::new();
    for (i, volume) in each.into_iter().enumerate() {
        *volumes.entry(root(&mut parent, i)).or_insert(0.0) += volume;
    }
    let mut volumes: Vec<f64> = volumes.into_values().collect();
    volumes.sort_by(|a, b| b.total_cmp(a));
    Verdict { fragments: volumes.len(), volume: volume + lost, boundary_area, outer_area, volumes }
}

fn area(places: &[[u64; 3]]) -> f64 {
    let at = |k: usize| DVec3::from_array(places[k].map(f64::from_bits));
    (at(1) - at(0)).cross(at(2) - at(0)).length() / 2.0
}
