//! The subdivision kernel: what becomes of one base tetrahedron, given the points on its faces and the crossings on its edges.
//!
//! 1. For each face point in turn, the one child that owns that face becomes three.
//! 2. For each crossing in one global order of edges, every child that contains the edge becomes two.
//!
//! What happens to a face depends on that face's own edges and point alone, and on the global order. The neighbour does the same, so the
//! mesh is conforming for any of the 64 masks of edges and 16 sets of faces. Every operation splits at a point strictly inside an edge or
//! a face, so children are positive whenever the base tetrahedron is.

use keyhole_tetmesh::{EdgeKey, FaceKey, NodeId};

/// A corner of a child, named by where it lies on the base mesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Vertex {
    /// A node of the base tetrahedron.
    Corner(NodeId),
    /// The crossing on an edge.
    Edge(EdgeKey),
    /// The point on a face.
    Face(FaceKey),
}

/// A child by its four vertices, positive whenever the base tetrahedron is.
pub type Child = [Vertex; 4];

/// The children of a base tetrahedron.
///
/// `faces` are the faces that have a point: those of open faces first, then those of full ones, each by key. With a full face first the
/// symmetric pattern leaves unmarked faces inside the cut. `edges` are the released crossings in the global order.
#[must_use]
pub fn subdivide(corners: [NodeId; 4], faces: &[FaceKey], edges: &[EdgeKey]) -> Vec<Child> {
    let mut children = Vec::with_capacity(16);
    subdivide_into(corners, faces, edges, &mut children);
    children
}

/// The same, added to `all`.
pub(crate) fn subdivide_into(corners: [NodeId; 4], faces: &[FaceKey], edges: &[EdgeKey], all: &mut Vec<Child>) {
    let start = all.len();
    all.push(corners.map(Vertex::Corner));
    for &face in faces {
        let owned = face.nodes().map(Vertex::Corner);
        let Some(at) = all[start..].iter().position(|c| owned.iter().all(|v| c.contains(v))) else { continue };
        let owner = all[start + at];
        let [first, second, third] = owned.map(|v| replaced(owner, v, Vertex::Face(face)));
        all[start + at] = first;
        all.extend([second, third]);
    }
    for &edge in edges {
        let [a, b] = edge.nodes().map(Vertex::Corner);
        for i in start..all.len() {
            let whole = all[i];
            if whole.contains(&a) && whole.contains(&b) {
                all[i] = replaced(whole, b, Vertex::Edge(edge));
                all.push(replaced(whole, a, Vertex::Edge(edge)));
            }
        }
    }
}

fn replaced(mut child: Child, old: Vertex, new: Vertex) -> Child {
    for v in &mut child {
        if *v == old {
            *v = new;
        }
    }
    child
}
