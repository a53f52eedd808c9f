//! A whole state in one number: two runs that end in the same bits have the same digest.

use bevy::prelude::*;
use keyhole_whiteboard::{Organ, TissueMesh, TissueState};

/// BLAKE3 over every organ in order of spawning: name, nodes with their positions and velocities bit by bit, tetrahedra with their nodes.
/// 32 hexadecimal digits.
pub fn digest(world: &mut World) -> String {
    let mut organs = world.query::<(Entity, &Organ, &TissueMesh, &TissueState)>();
    let mut found: Vec<_> = organs.iter(world).collect();
    found.sort_unstable_by_key(|(entity, ..)| *entity);
    let mut hash = blake3::Hasher::new();
    for (_, organ, TissueMesh(mesh), state) in found {
        hash.update(organ.name.as_bytes());
        hash.update(&(mesh.node_count() as u64).to_le_bytes());
        for node in mesh.nodes() {
            hash.update(&node.0.to_le_bytes());
            for x in [state.positions[node.index()], state.velocities[node.index()]].into_iter().flat_map(|v| v.to_array()) {
                hash.update(&x.to_bits().to_le_bytes());
            }
        }
        hash.update(&(mesh.tet_count() as u64).to_le_bytes());
        for (tet, nodes) in mesh.iter() {
            for id in [tet.0].into_iter().chain(nodes.map(|n| n.0)) {
                hash.update(&id.to_le_bytes());
            }
        }
    }
    hash.finalize().to_hex()[..32].to_owned()
}
