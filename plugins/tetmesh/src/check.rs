//! What a mesh from outside must satisfy before anything is done with it.

use crate::ids::{FaceKey, MaterialId, NodeId};
use crate::mesh::TetMesh;
use crate::quality::is_positive;
use crate::topology::FACES;
use glam::DVec3;
use rustc_hash::FxHashMap;

/// What is wrong with a mesh, and where.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MeshError {
    /// No tetrahedron at all.
    #[error("the mesh has no tetrahedra: expected cells of VTK type 10")]
    Empty,
    /// A tetrahedron names a node that is not there.
    #[error("tetrahedron {tet} names node {node}, but there are {nodes} nodes: write the mesh again with valid connectivity")]
    UnknownNode {
        /// Index of the tetrahedron.
        tet: usize,
        /// The node it names.
        node: i64,
        /// Number of nodes.
        nodes: usize,
    },
    /// A node that is not finite.
    #[error("node {node} is at {position:?}: every coordinate must be finite")]
    NotFinite {
        /// Index of the node.
        node: usize,
        /// Its position, m.
        position: DVec3,
    },
    /// A tetrahedron that is flat or turned inside out.
    #[error("tetrahedron {tet} has volume {volume_mm3} mm3: it is inverted or flat; swap two of its nodes or mesh again")]
    NotPositive {
        /// Index of the tetrahedron.
        tet: usize,
        /// Its signed volume.
        volume_mm3: f64,
    },
    /// The same four nodes twice.
    #[error("tetrahedra {first} and {second} have the same nodes: remove one of them")]
    Duplicate {
        /// Index of the one.
        first: usize,
        /// Index of the other.
        second: usize,
    },
    /// Three or more tetrahedra at a face.
    #[error("{count} tetrahedra share the face of nodes {nodes:?}, at most two can: the mesh overlaps itself there")]
    NonManifoldFace {
        /// The face.
        nodes: [u32; 3],
        /// How many.
        count: usize,
    },
}

/// A mesh of the given nodes (m), tetrahedra and materials (one a tetrahedron, or none), once all is well with it. Nodes that no
/// tetrahedron uses are left out.
///
/// # Errors
/// The first thing that is wrong.
pub fn checked(nodes: &[DVec3], tets: &[[u32; 4]], materials: &[MaterialId]) -> Result<TetMesh, MeshError> {
    if tets.is_empty() {
        return Err(MeshError::Empty);
    }
    if let Some((node, position)) = nodes.iter().enumerate().find(|(_, p)| !p.is_finite()) {
        return Err(MeshError::NotFinite { node, position: *position });
    }
    let mut seen: FxHashMap<[u32; 4], usize> = FxHashMap::default();
    let mut faces: FxHashMap<FaceKey, usize> = FxHashMap::default();
    for (i, t) in tets.iter().enumerate() {
        if let Some(node) = t.iter().copied().find(|n| *n as usize >= nodes.len()) {
            return Err(MeshError::UnknownNode { tet: i, node: node.into(), nodes: nodes.len() });
        }
        let mut key = *t;
        key.sort_unstable();
        if let Some(first) = seen.insert(key, i) {
            return Err(MeshError::Duplicate { first, second: i });
        }
        let p = t.map(|n| nodes[n as usize]);
        if !is_positive(p) {
            return Err(MeshError::NotPositive { tet: i, volume_mm3: crate::quality::volume(p) * 1e9 });
        }
        for [a, b, c] in FACES {
            *faces.entry(FaceKey::new(NodeId(t[a]), NodeId(t[b]), NodeId(t[c]))).or_insert(0) += 1;
        }
    }
    if let Some((face, count)) = faces.iter().filter(|(_, n)| **n > 2).min() {
        return Err(MeshError::NonManifoldFace { nodes: face.nodes().map(|n| n.0), count: *count });
    }
    let mut new_id = vec![u32::MAX; nodes.len()];
    let mut kept = Vec::new();
    for n in tets.iter().flatten() {
        if new_id[*n as usize] == u32::MAX {
            new_id[*n as usize] = 0;
        }
    }
    for (i, id) in new_id.iter_mut().enumerate().filter(|(_, id)| **id == 0) {
        *id = kept.len() as u32;
        kept.push(nodes[i]);
    }
    let tets: Vec<[u32; 4]> = tets.iter().map(|t| t.map(|n| new_id[n as usize])).collect();
    Ok(TetMesh::new(kept, &tets, materials))
}
