//! Face-connected components: the fragments of a cut organ.

use crate::ids::TetId;
use crate::mesh::TetMesh;

/// The component of each tetrahedron slot, `u32::MAX` for empty ones; component 0 has the largest rest volume, the others follow by
/// volume, then by their smallest tetrahedron.
#[derive(Clone, Debug, Default)]
pub struct Components {
    /// Component of each slot.
    pub of_tet: Vec<u32>,
    /// Rest volume of each component, m3.
    pub volumes: Vec<f64>,
}

impl Components {
    /// The components of a mesh, by a look at all of it.
    #[must_use]
    pub fn of(mesh: &TetMesh) -> Self {
        let mut of_tet = vec![u32::MAX; mesh.tet_slots()];
        let mut volumes = Vec::new();
        let mut stack = Vec::new();
        for (seed, _) in mesh.iter() {
            if of_tet[seed.index()] != u32::MAX {
                continue;
            }
            let component = volumes.len() as u32;
            let mut volume = 0.0;
            of_tet[seed.index()] = component;
            stack.push(seed);
            while let Some(tet) = stack.pop() {
                volume += mesh.volume(tet);
                for face in 0..4 {
                    if let Some(next) = mesh.topology().neighbour(tet, face)
                        && of_tet[next.index()] == u32::MAX
                    {
                        of_tet[next.index()] = component;
                        stack.push(next);
                    }
                }
            }
            volumes.push(volume);
        }
        let mut order: Vec<u32> = (0..volumes.len() as u32).collect();
        order.sort_by(|a, b| volumes[*b as usize].total_cmp(&volumes[*a as usize]).then(a.cmp(b)));
        let mut rank = vec![0; order.len()];
        for (new, old) in order.iter().enumerate() {
            rank[*old as usize] = new as u32;
        }
        for c in of_tet.iter_mut().filter(|c| **c != u32::MAX) {
            *c = rank[*c as usize];
        }
        Self { of_tet, volumes: order.iter().map(|o| volumes[*o as usize]).collect() }
    }

    /// Number of components.
    #[must_use]
    pub fn len(&self) -> usize {
        self.volumes.len()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.volumes.is_empty()
    }

    /// The component of a tetrahedron.
    #[must_use]
    pub fn component(&self, tet: TetId) -> u32 {
        self.of_tet[tet.index()]
    }
}
