//! The boundary surface: the faces with one tetrahedron.

use crate::ids::{EdgeKey, NodeId, TetId};
use crate::mesh::TetMesh;
use crate::topology::FACES;
use rustc_hash::FxHashMap;

/// The boundary triangles of a mesh, normals outward.
#[derive(Clone, Debug, Default)]
pub struct Boundary {
    /// Triangles by their nodes.
    pub triangles: Vec<[NodeId; 3]>,
    /// The tetrahedron that each triangle belongs to.
    pub tets: Vec<TetId>,
}

impl Boundary {
    /// The boundary of a mesh, in ascending order of tetrahedron.
    #[must_use]
    pub fn of(mesh: &TetMesh) -> Self {
        let mut boundary = Self::default();
        for (tet, corners) in mesh.iter() {
            for (face, [i, j, k]) in FACES.into_iter().enumerate() {
                if mesh.topology().neighbour(tet, face).is_none() {
                    boundary.triangles.push([corners[i], corners[j], corners[k]]);
                    boundary.tets.push(tet);
                }
            }
        }
        boundary
    }

    /// Euler characteristic V - E + F: 2 for a sphere.
    #[must_use]
    pub fn euler_characteristic(&self) -> i64 {
        let edges = self.edge_uses();
        let mut nodes: Vec<NodeId> = self.triangles.iter().flatten().copied().collect();
        nodes.sort_unstable();
        nodes.dedup();
        nodes.len() as i64 - edges.len() as i64 + self.triangles.len() as i64
    }

    /// Whether every edge has exactly two triangles and the triangles at every node form one closed fan.
    #[must_use]
    pub fn is_closed_manifold(&self) -> bool {
        if self.edge_uses().values().any(|&n| n != 2) {
            return false;
        }
        let mut fans: FxHashMap<NodeId, Vec<usize>> = FxHashMap::default();
        for (i, t) in self.triangles.iter().enumerate() {
            for n in t {
                fans.entry(*n).or_default().push(i);
            }
        }
        fans.iter().all(|(node, fan)| self.is_one_fan(*node, fan))
    }

    /// Area in the rest shape, m2.
    #[must_use]
    pub fn area(&self, mesh: &TetMesh) -> f64 {
        self.triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|n| mesh.rest(n));
                (b - a).cross(c - a).length() / 2.0
            })
            .sum()
    }

    fn edge_uses(&self) -> FxHashMap<EdgeKey, u32> {
        let mut uses = FxHashMap::default();
        for [a, b, c] in &self.triangles {
            for (p, q) in [(a, b), (b, c), (c, a)] {
                *uses.entry(EdgeKey::new(*p, *q)).or_insert(0) += 1;
            }
        }
        uses
    }

    fn is_one_fan(&self, node: NodeId, fan: &[usize]) -> bool {
        let mut next: FxHashMap<NodeId, NodeId> = FxHashMap::default();
        for &i in fan {
            let t = self.triangles[i];
            let k = t.iter().position(|n| *n == node).unwrap_or(0);
            next.insert(t[(k + 1) % 3], t[(k + 2) % 3]);
        }
        let Some((&start, _)) = next.iter().next() else { return false };
        let (mut at, mut steps) = (start, 0);
        while let Some(&to) = next.get(&at) {
            at = to;
            steps += 1;
            if at == start || steps > fan.len() {
                break;
            }
        }
        at == start && steps == fan.len()
    }
}
