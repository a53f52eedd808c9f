//! The edges of a mesh as a graph, kept up to date element by element: for models that have springs there.

use keyhole_tetmesh::{EDGES, EdgeKey, NodeId};
use rustc_hash::FxHashMap;

/// The ends of a slot that is not in use: an edge from node 0 to itself, with no effect on any sum.
const VACANT: [u32; 2] = [0, 0];

/// Edges by slot, and the six edges of each element.
#[derive(Clone, Debug, Default)]
pub struct EdgeGraph {
    ends: Vec<[u32; 2]>,
    uses: Vec<u32>,
    free: Vec<u32>,
    slot: FxHashMap<EdgeKey, u32>,
    of_element: Vec<[u32; 6]>,
}

impl EdgeGraph {
    /// The two nodes of each edge slot; equal where the slot is not in use.
    #[must_use]
    pub fn ends(&self) -> &[[u32; 2]] {
        &self.ends
    }

    /// The slots of the edges of each element, in the order of [`EDGES`].
    #[must_use]
    pub fn of_element(&self) -> &[[u32; 6]] {
        &self.of_element
    }

    /// Number of edges in use.
    #[must_use]
    pub fn len(&self) -> usize {
        self.slot.len()
    }

    /// Whether there is no edge.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.slot.is_empty()
    }

    /// Makes room for this many elements.
    pub fn reserve(&mut self, elements: usize) {
        // A large tetrahedral mesh has 1.2 edges an element, a coarse one up to 2.
        let edges = 2 * elements;
        self.ends.reserve(edges);
        self.uses.reserve(edges);
        self.slot.reserve(edges);
        self.of_element.reserve(elements);
    }

    /// Adds the edges of an element.
    pub fn insert(&mut self, element: usize, nodes: [u32; 4]) {
        if self.of_element.len() <= element {
            self.of_element.resize(element + 1, [0; 6]);
        }
        self.of_element[element] = EDGES.map(|[i, j]| {
            let key = EdgeKey::new(NodeId(nodes[i]), NodeId(nodes[j]));
            let slot = *self.slot.entry(key).or_insert_with(|| {
                self.free.pop().unwrap_or_else(|| {
                    self.ends.push(VACANT);
                    self.uses.push(0);
                    self.ends.len() as u32 - 1
                })
            });
            self.ends[slot as usize] = key.nodes().map(|n| n.0);
            self.uses[slot as usize] += 1;
            slot
        });
    }

    /// Takes the edges of an element out; it must have been inserted with these nodes.
    pub fn remove(&mut self, element: usize, nodes: [u32; 4]) {
        for ([i, j], slot) in EDGES.into_iter().zip(self.of_element[element]) {
            self.uses[slot as usize] -= 1;
            if self.uses[slot as usize] == 0 {
                self.slot.remove(&EdgeKey::new(NodeId(nodes[i]), NodeId(nodes[j])));
                self.ends[slot as usize] = VACANT;
                self.free.push(slot);
            }
        }
    }
}
