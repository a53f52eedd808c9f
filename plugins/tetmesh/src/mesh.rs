//! The mesh: rest positions, tetrahedra with their attributes, and edits whose cost depends on what they touch.

use crate::delta::{AddedTet, NodeEdit, NodeWeights, TopologyDelta};
use crate::ids::{MaterialId, NodeId, TetId};
use crate::topology::{Topology, with_room};
use glam::DVec3;
use rustc_hash::FxHashMap;

/// What a tetrahedron carries besides its nodes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tet {
    /// What it is made of.
    pub material: MaterialId,
    /// Index of the original tetrahedron that it is a part of.
    pub source: u32,
    /// Whether it belongs to the hull: whether it, or the tetrahedron it was cut from, shares a node with the surface.
    pub hull: bool,
}

/// A tetrahedral mesh in its rest shape, in metres.
///
/// Every edit is written to a [`TopologyDelta`] that [`TetMesh::take_delta`] hands out. Slots of removed nodes and tetrahedra are used
/// again only after that.
#[derive(Clone, Debug, Default)]
pub struct TetMesh {
    rest: Vec<DVec3>,
    alive: Vec<bool>,
    node_count: usize,
    topology: Topology,
    tets: Vec<Tet>,
    delta: TopologyDelta,
    /// Where in the delta an added tetrahedron is.
    added_at: FxHashMap<TetId, usize>,
    free_nodes: Vec<NodeId>,
    free_tets: Vec<TetId>,
    freed_nodes: Vec<NodeId>,
    freed_tets: Vec<TetId>,
}

impl TetMesh {
    /// A mesh of the given nodes (metres) and tetrahedra, with `source` their index, material 0, hull marks set, and no delta.
    ///
    /// Nothing is checked: input from outside goes through [`crate::check::checked`] first.
    #[must_use]
    pub fn new(nodes: Vec<DVec3>, tets: &[[u32; 4]], materials: &[MaterialId]) -> Self {
        let mut mesh = Self::of_nodes(nodes, tets.len());
        for (i, t) in tets.iter().enumerate() {
            mesh.topology.insert(TetId(i as u32), t.map(NodeId));
            let material = materials.get(i).copied().unwrap_or_default();
            mesh.tets.push(Tet { material, source: i as u32, hull: false });
        }
        mesh.mark_hull();
        mesh
    }

    /// A mesh of the given nodes (metres) and tetrahedra with attributes that are kept as they are: a piece of another mesh.
    #[must_use]
    pub fn from_parts(nodes: Vec<DVec3>, tets: &[([u32; 4], Tet)]) -> Self {
        let mut mesh = Self::of_nodes(nodes, tets.len());
        for (i, (nodes, tet)) in tets.iter().enumerate() {
            mesh.topology.insert(TetId(i as u32), nodes.map(NodeId));
            mesh.tets.push(*tet);
        }
        mesh
    }

    /// A mesh without tetrahedra, with room for so many and for what cuts add.
    fn of_nodes(mut rest: Vec<DVec3>, tets: usize) -> Self {
        let nodes = rest.len();
        rest.reserve_exact(with_room(nodes) - nodes);
        let mut alive = Vec::with_capacity(with_room(nodes));
        alive.resize(nodes, true);
        let mut topology = Topology::default();
        topology.reserve(tets, nodes);
        Self { alive, node_count: nodes, rest, topology, tets: Vec::with_capacity(with_room(tets)), ..Self::default() }
    }

    /// Adjacency.
    #[must_use]
    pub fn topology(&self) -> &Topology {
        &self.topology
    }

    /// Number of tetrahedra.
    #[must_use]
    pub fn tet_count(&self) -> usize {
        self.topology.len()
    }

    /// Number of nodes.
    #[must_use]
    pub fn node_count(&self) -> usize {
        self.node_count
    }

    /// Number of node slots: the length of an array indexed by [`NodeId`].
    #[must_use]
    pub fn node_slots(&self) -> usize {
        self.rest.len()
    }

    /// Number of tetrahedron slots: the length of an array indexed by [`TetId`].
    #[must_use]
    pub fn tet_slots(&self) -> usize {
        self.tets.len()
    }

    /// Whether the node is there.
    #[must_use]
    pub fn contains_node(&self, node: NodeId) -> bool {
        self.alive.get(node.index()).copied().unwrap_or(false)
    }

    /// Whether the tetrahedron is there.
    #[must_use]
    pub fn contains(&self, tet: TetId) -> bool {
        self.topology.contains(tet)
    }

    /// Rest position of a node, m.
    #[must_use]
    pub fn rest(&self, node: NodeId) -> DVec3 {
        self.rest[node.index()]
    }

    /// Rest positions of all node slots, m; those of removed nodes are stale.
    #[must_use]
    pub fn rest_positions(&self) -> &[DVec3] {
        &self.rest
    }

    /// Material, source and hull mark.
    #[must_use]
    pub fn tet(&self, tet: TetId) -> Tet {
        self.tets[tet.index()]
    }

    /// The four nodes.
    #[must_use]
    pub fn corners(&self, tet: TetId) -> [NodeId; 4] {
        self.topology.corners(tet)
    }

    /// The four rest positions, m.
    #[must_use]
    pub fn points(&self, tet: TetId) -> [DVec3; 4] {
        self.topology.corners(tet).map(|n| self.rest[n.index()])
    }

    /// Rest volume, m3; positive for every tetrahedron of a valid mesh.
    #[must_use]
    pub fn volume(&self, tet: TetId) -> f64 {
        crate::quality::volume(self.points(tet))
    }

    /// Sum of all rest volumes, m3.
    #[must_use]
    pub fn total_volume(&self) -> f64 {
        self.topology.iter().map(|(t, _)| self.volume(t)).sum()
    }

    /// All tetrahedra with their nodes, ascending by id.
    pub fn iter(&self) -> impl Iterator<Item = (TetId, [NodeId; 4])> + '_ {
        self.topology.iter()
    }

    /// All nodes, ascending.
    pub fn nodes(&self) -> impl Iterator<Item = NodeId> + '_ {
        self.alive.iter().enumerate().filter(|(_, a)| **a).map(|(i, _)| NodeId(i as u32))
    }

    /// Marks the tetrahedra that share a node with the surface as hull, the others as core, by a look at the whole mesh.
    pub fn mark_hull(&mut self) {
        let surface: Vec<bool> = (0..self.rest.len()).map(|i| self.topology.is_boundary_node(NodeId(i as u32))).collect();
        for (t, c) in self.topology.iter() {
            self.tets[t.index()].hull = c.iter().any(|n| surface[n.index()]);
        }
    }

    /// Sets the hull mark of one tetrahedron.
    pub fn set_hull(&mut self, tet: TetId, hull: bool) {
        self.tets[tet.index()].hull = hull;
    }

    /// Adds a node at `rest` (m), which is the point `from` of the tissue.
    pub fn add_node(&mut self, rest: DVec3, from: NodeWeights) -> NodeId {
        let node = self.new_node(rest);
        self.delta.nodes.push(NodeEdit::Added { node, from });
        node
    }

    /// Adds a node at the place of another: the other side of a cut.
    pub fn split_node(&mut self, of: NodeId) -> NodeId {
        let node = self.new_node(self.rest[of.index()]);
        self.delta.nodes.push(NodeEdit::Split { node, of });
        node
    }

    /// Moves the rest position of a node to `rest` (m), which is the point `from` of the tissue.
    pub fn move_node(&mut self, node: NodeId, rest: DVec3, from: NodeWeights) {
        self.rest[node.index()] = rest;
        self.delta.nodes.push(NodeEdit::Moved { node, from });
    }

    /// Removes a node that no tetrahedron uses.
    ///
    /// # Panics
    /// When the node is in use.
    pub fn remove_node(&mut self, node: NodeId) {
        assert!(self.topology.around_node(node).is_empty(), "node {} is in use", node.0);
        self.alive[node.index()] = false;
        self.node_count -= 1;
        self.freed_nodes.push(node);
        self.delta.nodes.push(NodeEdit::Removed { node });
    }

    /// Adds a tetrahedron.
    pub fn add_tet(&mut self, nodes: [NodeId; 4], tet: Tet) -> TetId {
        let id = self.free_tets.pop().unwrap_or(TetId(self.tets.len() as u32));
        if id.index() == self.tets.len() {
            self.tets.push(tet);
        } else {
            self.tets[id.index()] = tet;
        }
        self.topology.insert(id, nodes);
        self.added_at.insert(id, self.delta.added.len());
        self.delta.added.push(AddedTet { tet: id, nodes });
        id
    }

    /// Removes a tetrahedron and keeps its slot until the delta has been taken.
    pub fn remove_tet(&mut self, tet: TetId) {
        self.retire_tet(tet);
        self.freed_tets.push(tet);
    }

    /// Removes a tetrahedron but keeps its slot and its attributes reserved until [`TetMesh::release_tet`].
    pub fn retire_tet(&mut self, tet: TetId) {
        self.topology.remove(tet);
        if let Some(i) = self.added_at.remove(&tet) {
            self.delta.added.swap_remove(i);
            if let Some(moved) = self.delta.added.get(i) {
                self.added_at.insert(moved.tet, i);
            }
        } else {
            self.delta.removed.push(tet);
        }
    }

    /// Gives back the slot of a retired tetrahedron.
    pub fn release_tet(&mut self, tet: TetId) {
        debug_assert!(!self.topology.contains(tet));
        self.freed_tets.push(tet);
    }

    /// Whether anything changed since the last [`TetMesh::take_delta`].
    #[must_use]
    pub fn has_delta(&self) -> bool {
        !self.delta.is_empty()
    }

    /// What changed since the last call. From now on the slots it freed may be used again.
    pub fn take_delta(&mut self) -> TopologyDelta {
        self.free_nodes.append(&mut self.freed_nodes);
        self.free_tets.append(&mut self.freed_tets);
        self.added_at.clear();
        std::mem::take(&mut self.delta)
    }

    fn new_node(&mut self, rest: DVec3) -> NodeId {
        self.node_count += 1;
        if let Some(node) = self.free_nodes.pop() {
            self.rest[node.index()] = rest;
            self.alive[node.index()] = true;
            return node;
        }
        self.rest.push(rest);
        self.alive.push(true);
        NodeId(self.rest.len() as u32 - 1)
    }
}
