//! Names of nodes, tetrahedra, edges and faces. None of them is a bare integer in a public signature.

/// A node of a mesh. Ids stay valid until the node is removed; a removed id is not used again before the delta that says so is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct NodeId(pub u32);

/// A tetrahedron of a mesh, with the same promise as [`NodeId`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TetId(pub u32);

/// What a tetrahedron is made of: an index into the organ's list of materials.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct MaterialId(pub u16);

/// An edge by its nodes, the smaller id first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct EdgeKey(NodeId, NodeId);

/// A face by its nodes in ascending order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct FaceKey([NodeId; 3]);

impl NodeId {
    /// As an index into arrays that have one entry a node.
    #[must_use]
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

impl TetId {
    /// As an index into arrays that have one entry a tetrahedron slot.
    #[must_use]
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

impl EdgeKey {
    /// The key of the edge between two nodes, in either order.
    #[must_use]
    pub fn new(a: NodeId, b: NodeId) -> Self {
        if a < b { Self(a, b) } else { Self(b, a) }
    }

    /// The two nodes, the smaller id first.
    #[must_use]
    pub fn nodes(self) -> [NodeId; 2] {
        [self.0, self.1]
    }
}

impl FaceKey {
    /// The key of the face of three nodes, in any order.
    #[must_use]
    pub fn new(a: NodeId, b: NodeId, c: NodeId) -> Self {
        let mut nodes = [a, b, c];
        nodes.sort_unstable();
        Self(nodes)
    }

    /// The three nodes in ascending order.
    #[must_use]
    pub fn nodes(self) -> [NodeId; 3] {
        self.0
    }

    /// The three edges, each opposite to the node of the same index.
    #[must_use]
    pub fn edges(self) -> [EdgeKey; 3] {
        let [a, b, c] = self.0;
        [EdgeKey(b, c), EdgeKey(a, c), EdgeKey(a, b)]
    }
}
