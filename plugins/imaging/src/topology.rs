//! Adjacency of plain tetrahedra and triangles: separate bodies, the boundary, and where it is pinched.

use crate::disjoint_sets::DisjointSets;
use glam::DVec3;
use keyhole_tetmesh::FACES;
use rustc_hash::FxHashMap;

/// The face-connected body of each tetrahedron, numbered by first appearance, and their number.
pub(crate) fn bodies(tets: &[[u32; 4]]) -> (Vec<u32>, usize) {
    let mut sets = DisjointSets::new(tets.len());
    let mut faces: FxHashMap<[u32; 3], u32> = FxHashMap::default();
    for (i, t) in tets.iter().enumerate() {
        for f in FACES {
            match faces.entry(key(f.map(|c| t[c]))) {
                std::collections::hash_map::Entry::Occupied(other) => sets.join(*other.get(), i as u32),
                std::collections::hash_map::Entry::Vacant(free) => {
                    free.insert(i as u32);
                }
            }
        }
    }
    sets.numbers()
}

/// The boundary triangles of positive tetrahedra, normals outward, in order of tetrahedron.
pub(crate) fn boundary(tets: &[[u32; 4]]) -> Vec<[u32; 3]> {
    let mut uses: FxHashMap<[u32; 3], u8> = FxHashMap::default();
    for t in tets {
        for f in FACES {
            *uses.entry(key(f.map(|c| t[c]))).or_insert(0) += 1;
        }
    }
    tets.iter().flat_map(|t| FACES.map(|f| f.map(|c| t[c]))).filter(|f| uses[&key(*f)] == 1).collect()
}

/// The edge-connected component of each triangle, and their number.
pub(crate) fn sheets(triangles: &[[u32; 3]]) -> (Vec<u32>, usize) {
    let mut sets = DisjointSets::new(triangles.len());
    let mut edges: FxHashMap<[u32; 2], u32> = FxHashMap::default();
    for (i, [a, b, c]) in triangles.iter().enumerate() {
        for (p, q) in [(a, b), (b, c), (c, a)] {
            let other = *edges.entry([*p.min(q), *p.max(q)]).or_insert(i as u32);
            sets.join(other, i as u32);
        }
    }
    sets.numbers()
}

/// Nodes where the boundary is no 2-manifold, or that lie on the boundary of an enclosed void; ascending.
pub(crate) fn pinched(nodes: &[DVec3], tets: &[[u32; 4]]) -> Vec<u32> {
    let triangles = boundary(tets);
    let mut found = Vec::new();
    let mut edges: FxHashMap<[u32; 2], u8> = FxHashMap::default();
    let mut degree: Vec<u32> = vec![0; nodes.len()];
    for [a, b, c] in &triangles {
        for (p, q) in [(a, b), (b, c), (c, a)] {
            *edges.entry([*p.min(q), *p.max(q)]).or_insert(0) += 1;
            degree[*p as usize] += 1;
        }
    }
    found.extend(edges.iter().filter(|(_, n)| **n != 2).flat_map(|(e, _)| *e));
    // Around a node of a 2-manifold one walk from triangle to triangle sees them all.
    let mut next: FxHashMap<(u32, u32), u32> = FxHashMap::default();
    let mut start: Vec<u32> = vec![u32::MAX; nodes.len()];
    for t in &triangles {
        for k in 0..3 {
            next.insert((t[k], t[(k + 1) % 3]), t[(k + 2) % 3]);
            start[t[k] as usize] = t[(k + 1) % 3];
        }
    }
    for node in (0..nodes.len() as u32).filter(|n| degree[*n as usize] > 0) {
        let first = start[node as usize];
        let (mut at, mut steps) = (first, 0);
        while let Some(to) = next.get(&(node, at)) {
            at = *to;
            steps += 1;
            if at == first || steps > degree[node as usize] {
                break;
            }
        }
        if at != first || steps != degree[node as usize] {
            found.push(node);
        }
    }
    let (of_triangle, count) = sheets(&triangles);
    let mut enclosed = vec![0.0; count];
    for (t, s) in triangles.iter().zip(&of_triangle) {
        let [a, b, c] = t.map(|n| nodes[n as usize] - nodes[triangles[0][0] as usize]);
        enclosed[*s as usize] += a.dot(b.cross(c));
    }
    found.extend(triangles.iter().zip(&of_triangle).filter(|(_, s)| enclosed[**s as usize] < 0.0).flat_map(|(t, _)| *t));
    found.sort_unstable();
    found.dedup();
    found
}

fn key(mut f: [u32; 3]) -> [u32; 3] {
    f.sort_unstable();
    f
}
