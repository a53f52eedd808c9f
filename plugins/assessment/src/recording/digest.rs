//! The state in one number: two runs that have the same digest after a tick have the same bits.

use bevy_math::{Isometry3d, Vec3};
use keyhole_tetmesh::TetMesh;
use keyhole_whiteboard::{Hand, TissueState};

/// A digest of a state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StateDigest([u8; 32]);

impl StateDigest {
    /// Its first four bytes: kept for each tick, where two different states are alike once in four thousand million times.
    #[must_use]
    pub fn mark(self) -> u32 {
        u32::from_le_bytes([self.0[0], self.0[1], self.0[2], self.0[3]])
    }

    /// All of it.
    #[must_use]
    pub fn bytes(self) -> [u8; 32] {
        self.0
    }
}

/// BLAKE3 over every organ (its name, the positions and velocities of its nodes bit by bit, the number of its tetrahedra and the largest slot) and over the
/// pose of every instrument.
///
/// The order in which they are given does not matter: programs with and without a window may have them in different ones.
#[must_use]
pub fn state_digest<'a>(
    organs: impl Iterator<Item = (&'a str, &'a TetMesh, &'a TissueState)>,
    instruments: impl Iterator<Item = (Hand, Isometry3d)>,
) -> StateDigest {
    let mut parts: Vec<[u8; 32]> = organs.map(|(name, mesh, state)| organ(name, mesh, state)).collect();
    parts.extend(instruments.map(|(hand, pose)| instrument(hand, pose)));
    parts.sort_unstable();
    let mut hash = blake3::Hasher::new();
    parts.iter().for_each(|part| {
        hash.update(part);
    });
    StateDigest(*hash.finalize().as_bytes())
}

/// Floats of a chunk that is hashed in one go.
const CHUNK: usize = 1024;

/// Feeds the bits of vectors to a hash.
fn update(hash: &mut blake3::Hasher, vectors: impl Iterator<Item = Vec3>) {
    let mut bytes = Vec::with_capacity(4 * 3 * CHUNK);
    for v in vectors {
        v.to_array().iter().for_each(|x| bytes.extend_from_slice(&x.to_bits().to_le_bytes()));
        if bytes.len() == bytes.capacity() {
            hash.update(&bytes);
            bytes.clear();
        }
    }
    hash.update(&bytes);
}

fn organ(name: &str, mesh: &TetMesh, state: &TissueState) -> [u8; 32] {
    let mut hash = blake3::Hasher::new();
    hash.update(name.as_bytes());
    for count in [name.len(), mesh.node_count(), mesh.node_slots(), mesh.tet_count(), mesh.tet_slots()] {
        hash.update(&(count as u64).to_le_bytes());
    }
    // What stands in the slot of a removed node means nothing.
    update(&mut hash, mesh.nodes().filter_map(|n| state.positions.get(n.index()).copied()));
    update(&mut hash, mesh.nodes().filter_map(|n| state.velocities.get(n.index()).copied()));
    *hash.finalize().as_bytes()
}

fn instrument(hand: Hand, pose: Isometry3d) -> [u8; 32] {
    let mut hash = blake3::Hasher::new();
    hash.update(match hand {
        Hand::Left => b"left",
        Hand::Right => b"right",
    });
    let (place, turn) = (Vec3::from(pose.translation), pose.rotation);
    update(&mut hash, [place, turn.xyz(), Vec3::new(turn.w, 0.0, 0.0)].into_iter());
    *hash.finalize().as_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy_math::DVec3;

    #[test]
    fn a_digest_sees_every_bit_and_no_order() {
        let mesh = TetMesh::new(vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z], &[[0, 1, 2, 3]], &[]);
        let state = TissueState::at_rest(&mesh);
        let moved = |i: usize, velocity: bool| {
            let mut state = state.clone();
            let of = if velocity { &mut state.velocities } else { &mut state.positions };
            of[i].z = f32::from_bits(of[i].z.to_bits() ^ 1);
            state
        };
        let of = |states: [&TissueState; 2], order: [usize; 2]| {
            let organs = order.map(|i| (["kidney", "liver"][i], &mesh, states[i]));
            state_digest(organs.into_iter(), std::iter::once((Hand::Left, Isometry3d::IDENTITY)))
        };
        let rest = of([&state, &state], [0, 1]);
        assert_eq!(of([&state, &state], [1, 0]), rest);
        for i in 0..4 {
            for velocity in [false, true] {
                let other = moved(i, velocity);
                assert_ne!(of([&other, &state], [0, 1]), rest);
                // The two organs are told apart.
                assert_ne!(of([&other, &state], [0, 1]), of([&state, &other], [0, 1]));
            }
        }
        let alone = |hand, x| state_digest(std::iter::empty(), std::iter::once((hand, Isometry3d::from_translation(Vec3::X * x))));
        assert_ne!(alone(Hand::Left, 0.0), alone(Hand::Right, 0.0));
        assert_ne!(alone(Hand::Left, 0.0), alone(Hand::Left, f32::MIN_POSITIVE));
    }
}
