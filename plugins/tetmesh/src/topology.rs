//! Which tetrahedra there are and which share a face or a node: everything about a mesh but its geometry.
//!
//! Slots are indexed by [`TetId`] and may be empty. Insertion and removal look at the tetrahedra around one node of each face, never at
//! the mesh.

use crate::ids::{FaceKey, NodeId, TetId};
use smallvec::SmallVec;

/// Corners of the six edges of a tetrahedron.
pub const EDGES: [[usize; 2]; 6] = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];

/// Corners of the four faces of a tetrahedron; face `i` is opposite to corner `i`, its normal points out of a positive tetrahedron.
pub const FACES: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];

const NONE: u32 = u32::MAX;

/// A number of slots and an eighth more.
pub(crate) fn with_room(slots: usize) -> usize {
    slots + slots / 8
}

/// Tetrahedra with face adjacency and the list of tetrahedra around each node.
#[derive(Clone, Debug, Default)]
pub struct Topology {
    corners: Vec<[NodeId; 4]>,
    neighbours: Vec<[u32; 4]>,
    around: Vec<SmallVec<[TetId; 8]>>,
    count: usize,
}

impl Topology {
    /// Makes room for as many tetrahedra and nodes as a mesh has and an eighth more, so that the first edit of a large mesh does not copy it.
    pub(crate) fn reserve(&mut self, tets: usize, nodes: usize) {
        self.corners.reserve_exact(with_room(tets));
        self.neighbours.reserve_exact(with_room(tets));
        self.around.reserve_exact(with_room(nodes));
    }

    /// Number of tetrahedra.
    #[must_use]
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether there is no tetrahedron.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Number of slots, occupied or not: the length of an array indexed by [`TetId`].
    #[must_use]
    pub fn slots(&self) -> usize {
        self.corners.len()
    }

    /// Whether the slot is occupied.
    #[must_use]
    pub fn contains(&self, tet: TetId) -> bool {
        self.corners.get(tet.index()).is_some_and(|c| c[0].0 != NONE)
    }

    /// The four nodes of a tetrahedron.
    ///
    /// # Panics
    /// When the slot was never used.
    #[must_use]
    pub fn corners(&self, tet: TetId) -> [NodeId; 4] {
        self.corners[tet.index()]
    }

    /// The tetrahedron beyond face `face` (0..4, opposite to that corner), `None` on the boundary.
    #[must_use]
    pub fn neighbour(&self, tet: TetId, face: usize) -> Option<TetId> {
        let n = self.neighbours[tet.index()][face];
        (n != NONE).then_some(TetId(n))
    }

    /// The key of face `face` of a tetrahedron.
    #[must_use]
    pub fn face_key(&self, tet: TetId, face: usize) -> FaceKey {
        let c = self.corners[tet.index()];
        let [i, j, k] = FACES[face];
        FaceKey::new(c[i], c[j], c[k])
    }

    /// The tetrahedra around a node, in no particular but deterministic order.
    #[must_use]
    pub fn around_node(&self, node: NodeId) -> &[TetId] {
        self.around.get(node.index()).map_or(&[], |a| a.as_slice())
    }

    /// The tetrahedra around an edge.
    pub fn around_edge(&self, a: NodeId, b: NodeId) -> impl Iterator<Item = TetId> + '_ {
        self.around_node(a).iter().copied().filter(move |t| self.corners[t.index()].contains(&b))
    }

    /// The one or two tetrahedra that have this face.
    pub fn around_face(&self, face: FaceKey) -> impl Iterator<Item = TetId> + '_ {
        // The node with the fewest tetrahedra is the fastest to ask.
        let nodes = face.nodes();
        let fewest = (0..3).min_by_key(|&i| self.around_node(nodes[i]).len()).unwrap_or(0);
        let (a, b, c) = (nodes[fewest], nodes[(fewest + 1) % 3], nodes[(fewest + 2) % 3]);
        self.around_node(a).iter().copied().filter(move |t| {
            let n = self.corners[t.index()];
            n.contains(&b) && n.contains(&c)
        })
    }

    /// Whether the node lies on the boundary: whether a tetrahedron around it has a face at it without a neighbour.
    #[must_use]
    pub fn is_boundary_node(&self, node: NodeId) -> bool {
        self.around_node(node).iter().any(|&t| {
            let c = self.corners[t.index()];
            (0..4).any(|f| c[f] != node && self.neighbours[t.index()][f] == NONE)
        })
    }

    /// All tetrahedra in ascending order of id.
    pub fn iter(&self) -> impl Iterator<Item = (TetId, [NodeId; 4])> + '_ {
        self.corners.iter().enumerate().filter(|(_, c)| c[0].0 != NONE).map(|(i, c)| (TetId(i as u32), *c))
    }

    /// Puts a tetrahedron into an empty slot and joins it to its neighbours.
    ///
    /// A face that already has two tetrahedra stays as it is: the third has no neighbour there. [`crate::check`] finds such input.
    ///
    /// # Panics
    /// When the slot is occupied.
    pub fn insert(&mut self, tet: TetId, corners: [NodeId; 4]) {
        assert!(!self.contains(tet), "slot {} is occupied", tet.0);
        if self.corners.len() <= tet.index() {
            self.corners.resize(tet.index() + 1, [NodeId(NONE); 4]);
            self.neighbours.resize(tet.index() + 1, [NONE; 4]);
        }
        let highest = corners.iter().map(|n| n.index()).max().unwrap_or(0);
        if self.around.len() <= highest {
            self.around.resize(highest + 1, SmallVec::new());
        }
        self.corners[tet.index()] = corners;
        self.neighbours[tet.index()] = [NONE; 4];
        // Three faces have the node with the fewest tetrahedra; the next one has the fourth.
        let mut order = [0, 1, 2, 3];
        order.sort_by_key(|&i| self.around[corners[i].index()].len());
        self.join_around(tet, order[0]);
        self.join_around(tet, order[1]);
        for node in corners {
            self.around[node.index()].push(tet);
        }
        self.count += 1;
    }

    /// Empties a slot.
    ///
    /// # Panics
    /// When the slot is empty.
    pub fn remove(&mut self, tet: TetId) {
        assert!(self.contains(tet), "slot {} is empty", tet.0);
        for face in 0..4 {
            let n = self.neighbours[tet.index()][face];
            if n != NONE {
                let back = self.neighbours[n as usize].iter().position(|&b| b == tet.0);
                if let Some(back) = back {
                    self.neighbours[n as usize][back] = NONE;
                }
            }
        }
        for node in self.corners[tet.index()] {
            let around = &mut self.around[node.index()];
            if let Some(at) = around.iter().position(|t| *t == tet) {
                around.remove(at);
            }
        }
        self.corners[tet.index()] = [NodeId(NONE); 4];
        self.neighbours[tet.index()] = [NONE; 4];
        self.count -= 1;
    }

    /// Joins a tetrahedron to those around its corner `corner` that share a face with it, where neither has a neighbour.
    fn join_around(&mut self, tet: TetId, corner: usize) {
        let own = self.corners[tet.index()];
        for at in 0..self.around[own[corner].index()].len() {
            let other = self.around[own[corner].index()][at];
            let theirs = self.corners[other.index()];
            let shared = own.map(|n| theirs.contains(&n));
            if shared.iter().filter(|s| **s).count() != 3 {
                continue;
            }
            let (Some(face), Some(other_face)) = (shared.iter().position(|s| !s), theirs.iter().position(|n| !own.contains(n))) else {
                continue;
            };
            if self.neighbours[tet.index()][face] == NONE && self.neighbours[other.index()][other_face] == NONE {
                self.neighbours[tet.index()][face] = other.0;
                self.neighbours[other.index()][other_face] = tet.0;
            }
        }
    }
}
