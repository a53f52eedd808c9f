//! What an edit of the topology did, so that an observer updates only what was touched.

use crate::ids::{NodeId, TetId};
use crate::topology::Topology;
use rustc_hash::{FxHashMap, FxHashSet};
use smallvec::SmallVec;

/// A point of the tissue as existing nodes and weights that sum to one.
pub type NodeWeights = SmallVec<[(NodeId, f64); 4]>;

/// A tetrahedron that an edit added.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AddedTet {
    /// Its slot.
    pub tet: TetId,
    /// Its nodes.
    pub nodes: [NodeId; 4],
}

/// One edit of a node. Edits are in order: a later one may refer to a node that an earlier one added.
#[derive(Clone, Debug, PartialEq)]
pub enum NodeEdit {
    /// A new node at a point of the tissue: its deformed position and velocity are the weighted ones of `from`.
    Added {
        /// The new node.
        node: NodeId,
        /// Where it comes from.
        from: NodeWeights,
    },
    /// A node whose rest position moved: its deformed position and velocity become the weighted ones of `from`, which holds values
    /// from before this edit and may name the node itself.
    Moved {
        /// The moved node.
        node: NodeId,
        /// Where it now is.
        from: NodeWeights,
    },
    /// A new node at the same place, with the same velocity, as an existing one: the other side of a cut.
    Split {
        /// The new node.
        node: NodeId,
        /// The node it was split from.
        of: NodeId,
    },
    /// A node that is no longer there.
    Removed {
        /// The removed node.
        node: NodeId,
    },
}

/// Everything that changed in one step, and nothing else.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TopologyDelta {
    /// Edits of nodes, in order.
    pub nodes: Vec<NodeEdit>,
    /// Tetrahedra that were there before the step and are gone after it.
    pub removed: Vec<TetId>,
    /// Tetrahedra that are there after the step and were not before it.
    pub added: Vec<AddedTet>,
}

impl TopologyDelta {
    /// Whether nothing changed.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty() && self.removed.is_empty() && self.added.is_empty()
    }

    /// The tetrahedra whose geometry changed without being added: those around moved nodes.
    #[must_use]
    pub fn reshaped(&self, topology: &Topology) -> Vec<TetId> {
        let fresh: FxHashSet<TetId> = self.added.iter().map(|a| a.tet).collect();
        let mut seen: FxHashMap<TetId, ()> = FxHashMap::default();
        let mut reshaped = Vec::new();
        for edit in &self.nodes {
            if let NodeEdit::Moved { node, .. } = edit {
                for &tet in topology.around_node(*node) {
                    if !fresh.contains(&tet) && seen.insert(tet, ()).is_none() {
                        reshaped.push(tet);
                    }
                }
            }
        }
        reshaped
    }
}
