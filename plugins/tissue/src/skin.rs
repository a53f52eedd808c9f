//! The capsule in the rows of the implicit solver: its forces, and a tangent of it that is positive.
//!
//! An edge of a triangle of the surface is an edge of a tetrahedron, so its blocks have their place in the rows already. Like all rows those of its nodes are
//! gathered, each by the thread that has the node.

use crate::membrane::Membrane;
use crate::rows::{Chunk, Forces, Inertia};
use bevy_math::{DVec3, Mat3A, Vec3A};

fn places(nodes: [u32; 3], x: &[Vec3A]) -> [DVec3; 3] {
    nodes.map(|n| x[n as usize].as_dvec3())
}

/// Adds the capsule to the assembled rows of a chunk, the first node of which is `first`, at positions `x` (m), and to the forces on its nodes.
pub(crate) fn assemble(membrane: &Membrane, chunk: &mut Chunk, first: usize, x: &[Vec3A], inertia: Inertia<'_>, out: &mut [Forces]) {
    for (at, out) in out.iter_mut().enumerate() {
        let mut any = false;
        for (triangle, corner) in membrane.around(first + at) {
            let row = triangle.row(places(triangle.nodes, x), corner, inertia.convex);
            out.elastic += row.force.as_vec3a();
            out.turned += row.turned.as_vec3a();
            chunk.add(at, row.others.into_iter().map(|(n, block)| (n, Mat3A::from(block.as_mat3()))));
            any = true;
        }
        if any {
            chunk.invert(at);
        }
    }
}

/// Adds the forces of the capsule on the nodes of a chunk, N.
pub(crate) fn forces(membrane: &Membrane, first: usize, x: &[Vec3A], out: &mut [Vec3A]) {
    for (at, out) in out.iter_mut().enumerate() {
        for (triangle, corner) in membrane.around(first + at) {
            *out += triangle.force(places(triangle.nodes, x), corner).as_vec3a();
        }
    }
}
