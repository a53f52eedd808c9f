//! The lips of an earlier cut: in the rest shape they lie on each other node by node, though nothing holds them together.
//!
//! The sheet lives in the rest shape, so it meets both lips at once and in the same places. What is decided for a node or an edge of one is decided
//! for the other too; else one lip would be split where the other is not, and they would no longer lie on each other node by node.

use crate::cutter::Cutter;
use keyhole_tetmesh::{FACES, NodeId, TetId, TetMesh};
use smallvec::{SmallVec, smallvec};

/// The nodes at one place.
pub(crate) type Twins = SmallVec<[NodeId; 2]>;

impl Cutter {
    /// The nodes at the place of a node, itself among them, ascending.
    pub(crate) fn twins(&self, mesh: &TetMesh, node: NodeId) -> Twins {
        let mut twins: Twins = smallvec![node];
        if self.is_wound_node(node) {
            let place = mesh.rest(node);
            for other in self.grid.near(place).iter().flat_map(|t| self.before.corners(mesh.topology(), *t)) {
                if mesh.rest(other) == place && !twins.contains(&other) {
                    twins.push(other);
                }
            }
            twins.sort_unstable();
        }
        twins
    }

    /// The base tetrahedra around an edge or a face of these nodes, and around those of their twins.
    pub(crate) fn around_twins<'a, const N: usize>(&'a self, mesh: &'a TetMesh, nodes: [NodeId; N]) -> impl Iterator<Item = TetId> + 'a {
        let mut others = nodes.map(|n| self.twins(mesh, n));
        let topology = mesh.topology();
        std::mem::take(&mut others[0]).into_iter().flat_map(|n| self.before.around_node(topology, n)).filter(move |t| {
            let corners = self.before.corners(topology, *t);
            others[1..].iter().all(|at| at.iter().any(|n| corners.contains(n)))
        })
    }

    /// Adds the base tetrahedra that lie on these across earlier cuts: what a blade's leaving one of them settles is settled on both lips.
    pub(crate) fn add_those_across(&self, mesh: &TetMesh, tets: &mut Vec<TetId>) {
        for i in 0..tets.len() {
            let Some(corners) = self.before.known_corners(mesh.topology(), tets[i]) else { continue };
            for face in FACES.map(|f| f.map(|k| corners[k])) {
                if face.iter().all(|n| self.is_wound_node(*n)) {
                    tets.extend(self.around_twins(mesh, face));
                }
            }
        }
    }
}
