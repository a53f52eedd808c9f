//! A body in patches: few tetrahedra that lie together, kept over topology changes at a cost that depends on the change alone.
//!
//! What is far from all of a patch is far from each of its tetrahedra, so that most of them need no look of their own.

use crate::shape::{Role, Shape};
use keyhole_tetmesh::{DVec3, NodeId, TetId, TetMesh, Topology, TopologyDelta};

/// Tetrahedra of a new patch: with 24 the boxes of a block of 20 480 overlapped so much, with 96 a box held so many nodes, that either took longer.
const SIZE: usize = 48;

/// By how much the box at rest is larger than the patch, on each side, as a part of it: what is in a box that has been bent a little is mostly near.
const MARGIN: f64 = 0.1;

/// Marks a tetrahedron slot in no patch.
const NONE: u32 = u32::MAX;

/// Tetrahedra that lie together.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Patch {
    /// Its tetrahedra, ascending.
    pub tets: Vec<TetId>,
    /// Their corners, ascending.
    pub nodes: Vec<NodeId>,
    /// The surface's nodes among these, those with an edge to one of these, and those two edges further that were in the box around the patch at
    /// rest when it was gathered. Ascending.
    pub near: Vec<NodeId>,
    /// Counts its changes.
    pub version: u32,
}

/// The patches of a body: every tetrahedron is in one.
#[derive(Clone, Debug, Default)]
pub struct Patches {
    of_tet: Vec<u32>,
    list: Vec<Patch>,
    walk: Walk,
}

impl Patches {
    /// The patches of a mesh, by Morton's order of the middles of its tetrahedra at rest.
    #[must_use]
    pub fn of(mesh: &TetMesh, shape: &Shape) -> Self {
        let mut patches = Self { of_tet: vec![NONE; mesh.tet_slots()], ..Self::default() };
        let all: Vec<TetId> = mesh.iter().map(|(t, _)| t).collect();
        for tets in in_order(mesh, &all).chunks(SIZE) {
            patches.push(tets.to_vec());
        }
        for at in 0..patches.list.len() {
            patches.gather(at, mesh, shape);
        }
        patches
    }

    /// Carries the patches over `delta`; `mesh` and `shape` are those after it, `touched` the nodes that [`Shape::update`] gave back.
    pub fn update(&mut self, mesh: &TetMesh, shape: &Shape, delta: &TopologyDelta, touched: &[NodeId]) {
        self.of_tet.resize(mesh.tet_slots(), NONE);
        let mut changed = Vec::new();
        for tet in &delta.removed {
            let patch = std::mem::replace(&mut self.of_tet[tet.index()], NONE);
            if let Some(known) = self.list.get_mut(patch as usize) {
                known.tets.retain(|t| t != tet);
                changed.push(patch);
            }
        }
        for added in &delta.added {
            // Where its neighbours are; the first that is known, in order of slot.
            let around = added.nodes.iter().flat_map(|n| mesh.topology().around_node(*n));
            let known = around.filter(|t| self.of_tet[t.index()] != NONE).min();
            match known.map(|t| self.of_tet[t.index()]) {
                Some(patch) => self.join(added.tet, patch),
                None => self.push(vec![added.tet]),
            }
        }
        let mut ring: Vec<NodeId> = touched.to_vec();
        ring.extend(touched.iter().flat_map(|n| mesh.topology().around_node(*n)).flat_map(|t| mesh.topology().corners(*t)));
        ring.sort_unstable();
        ring.dedup();
        changed.extend(ring.iter().flat_map(|n| mesh.topology().around_node(*n)).map(|t| self.of_tet[t.index()]));
        changed.sort_unstable();
        changed.dedup();
        for at in 0..changed.len() {
            let patch = changed[at] as usize;
            if self.list[patch].tets.len() > 2 * SIZE {
                let tets = in_order(mesh, &self.list[patch].tets);
                let (stay, go) = tets.split_at(SIZE);
                self.list[patch].tets = stay.to_vec();
                self.list[patch].tets.sort_unstable();
                for tets in go.chunks(SIZE) {
                    changed.push(self.list.len() as u32);
                    self.push(tets.to_vec());
                }
            }
        }
        for patch in changed {
            self.gather(patch as usize, mesh, shape);
        }
    }

    /// All patches; a place keeps its patch.
    #[must_use]
    pub fn list(&self) -> &[Patch] {
        &self.list
    }

    fn join(&mut self, tet: TetId, patch: u32) {
        self.of_tet[tet.index()] = patch;
        let tets = &mut self.list[patch as usize].tets;
        tets.insert(tets.partition_point(|t| *t < tet), tet);
    }

    fn push(&mut self, mut tets: Vec<TetId>) {
        for tet in &tets {
            self.of_tet[tet.index()] = self.list.len() as u32;
        }
        tets.sort_unstable();
        self.list.push(Patch { tets, ..Patch::default() });
    }

    /// Lists the nodes of a patch anew.
    fn gather(&mut self, at: usize, mesh: &TetMesh, shape: &Shape) {
        let (patch, walk) = (&mut self.list[at], &mut self.walk);
        walk.begin(mesh);
        patch.nodes.clear();
        patch.nodes.extend(patch.tets.iter().flat_map(|t| mesh.topology().corners(*t)).filter(|n| walk.comes_to(*n)));
        patch.nodes.sort_unstable();
        let rest = |n: NodeId| mesh.rest(n);
        let (low, high) = patch.nodes.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), n| (l.min(rest(*n)), h.max(rest(*n))));
        let margin = MARGIN * (high - low);
        let within = |n: NodeId| rest(n).cmpge(low - margin).all() && rest(n).cmple(high + margin).all();
        let surface = |n: NodeId| shape.role(n) == Role::Surface;
        walk.begin(mesh);
        patch.near.clear();
        walk.on(&patch.nodes, mesh.topology(), &mut patch.near, surface);
        let mut from = 0;
        for _ in 0..2 {
            let edge = patch.near[from..].to_vec();
            from = patch.near.len();
            walk.on(&edge, mesh.topology(), &mut patch.near, |n| surface(n) && within(n));
        }
        patch.near.sort_unstable();
        patch.version = patch.version.wrapping_add(1);
    }
}

/// A walk over a mesh from node to node that comes to each node and each tetrahedron once.
#[derive(Clone, Debug, Default)]
struct Walk {
    /// By slot: the walk that has been there last.
    nodes: Vec<u32>,
    tets: Vec<u32>,
    now: u32,
}

impl Walk {
    /// Begins another one.
    fn begin(&mut self, mesh: &TetMesh) {
        self.nodes.resize(mesh.node_slots(), 0);
        self.tets.resize(mesh.tet_slots(), 0);
        self.now = self.now.wrapping_add(1);
        if self.now == 0 {
            self.nodes.fill(0);
            self.tets.fill(0);
            self.now = 1;
        }
    }

    /// Whether it has not been at this node before.
    fn comes_to(&mut self, node: NodeId) -> bool {
        std::mem::replace(&mut self.nodes[node.index()], self.now) != self.now
    }

    /// Adds the corners that are wanted of the tetrahedra around nodes to a list. What is not wanted once may not be wanted later either.
    fn on(&mut self, nodes: &[NodeId], topology: &Topology, list: &mut Vec<NodeId>, wanted: impl Fn(NodeId) -> bool) {
        for tet in nodes.iter().flat_map(|n| topology.around_node(*n)) {
            if std::mem::replace(&mut self.tets[tet.index()], self.now) != self.now {
                list.extend(topology.corners(*tet).into_iter().filter(|n| wanted(*n) && self.comes_to(*n)));
            }
        }
    }
}

/// Tetrahedra in Morton's order of their middles at rest, in the box around these.
fn in_order(mesh: &TetMesh, tets: &[TetId]) -> Vec<TetId> {
    let middle = |t: TetId| mesh.points(t).iter().sum::<DVec3>() / 4.0;
    let (low, high) = tets.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), t| (l.min(middle(*t)), h.max(middle(*t))));
    let scale = f64::from(1 << 10) / (high - low).max_element();
    let code = |t: TetId| {
        let cell = (middle(t) - low) * scale;
        // Beyond the range and not a number become the nearest and zero.
        spread(cell.x as u32) | spread(cell.y as u32) << 1 | spread(cell.z as u32) << 2
    };
    let mut ordered: Vec<(u32, TetId)> = tets.iter().map(|t| (code(*t), *t)).collect();
    ordered.sort_unstable();
    ordered.into_iter().map(|(_, t)| t).collect()
}

/// The lowest ten bits with two between each.
fn spread(bits: u32) -> u32 {
    (0..10).fold(0, |spread, i| spread | (bits.min(1023) >> i & 1) << (3 * i))
}
