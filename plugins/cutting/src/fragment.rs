//! Fragments: pieces that a stroke has cut off become organs of their own.

use crate::cutter::Cutter;
use keyhole_tetmesh::components::Components;
use keyhole_tetmesh::{NodeId, TetId, TetMesh};
use rustc_hash::FxHashMap;

/// A piece below this part of the mean tetrahedron's volume is numerical: it stays with the organ.
const SLIVER: f64 = 1e-3;

/// A piece that came free.
pub struct Fragment {
    /// Its mesh; materials, sources and hull marks are the donor's.
    pub mesh: TetMesh,
    /// The donor's node of each of its nodes, ascending.
    pub donor_nodes: Vec<NodeId>,
}

/// Takes all pieces but one out of a mesh: the one that stays holds most of the nodes `held`, the largest one among equals. Looks at the whole mesh: it is the one part of cutting that does, once a stroke.
pub fn detach(mesh: &mut TetMesh, cutter: &mut Cutter, held: &[NodeId]) -> Vec<Fragment> {
    let components = Components::of(mesh);
    if components.len() < 2 {
        return Vec::new();
    }
    let smallest = SLIVER * mesh.total_volume() / mesh.tet_count() as f64;
    let mut pieces: Vec<Vec<TetId>> = vec![Vec::new(); components.len()];
    for (tet, _) in mesh.iter() {
        pieces[components.component(tet) as usize].push(tet);
    }
    let mut holds = vec![0_u32; components.len()];
    for tet in held.iter().filter_map(|n| mesh.topology().around_node(*n).first()) {
        holds[components.component(*tet) as usize] += 1;
    }
    let most = holds.iter().copied().max().unwrap_or(0);
    let stays = holds.iter().position(|h| *h == most).unwrap_or(0);
    let free = pieces.into_iter().zip(&components.volumes).enumerate().filter(|(i, (_, v))| *i != stays && **v > smallest);
    free.map(|(_, (tets, _))| take_out(mesh, cutter, &tets)).collect()
}

fn take_out(mesh: &mut TetMesh, cutter: &mut Cutter, tets: &[TetId]) -> Fragment {
    let mut donor_nodes: Vec<NodeId> = tets.iter().flat_map(|t| mesh.corners(*t)).collect();
    donor_nodes.sort_unstable();
    donor_nodes.dedup();
    let new_id: FxHashMap<NodeId, u32> = donor_nodes.iter().enumerate().map(|(i, n)| (*n, i as u32)).collect();
    let nodes = donor_nodes.iter().map(|n| mesh.rest(*n)).collect();
    let parts: Vec<_> = tets.iter().map(|t| (mesh.corners(*t).map(|n| new_id[&n]), mesh.tet(*t))).collect();
    for tet in tets {
        cutter.forget(mesh, *tet);
        mesh.remove_tet(*tet);
    }
    for node in &donor_nodes {
        // A node where two pieces only touch stays with the donor as well.
        if mesh.topology().around_node(*node).is_empty() {
            mesh.remove_node(*node);
        }
    }
    Fragment { mesh: TetMesh::from_parts(nodes, &parts), donor_nodes }
}
