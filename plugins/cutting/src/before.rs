//! The mesh as it was before the stroke in progress: its base tetrahedra. Those that the stroke has not touched are in the mesh; those that it
//! has are kept here beside their children, so that nothing is copied when a stroke begins and little is done when it ends.

use keyhole_tetmesh::{FACES, FaceKey, NodeId, TetId, Topology};
use rustc_hash::FxHashMap;

const NONE: u32 = u32::MAX;

/// Which base tetrahedra the stroke has touched, and which tetrahedra of the mesh are their children.
#[derive(Clone, Debug, Default)]
pub(crate) struct Before {
    /// By tetrahedron slot: the base of a child.
    parent: Vec<u32>,
    /// By tetrahedron slot: the place of a touched base among all touched ones.
    place: Vec<u32>,
    corners: Vec<[NodeId; 4]>,
    bases: Vec<TetId>,
    /// By node: the touched bases around it, as a chain through `links`.
    first: FxHashMap<NodeId, u32>,
    links: Vec<(TetId, u32)>,
}

impl Before {
    /// Makes room for the slots of the mesh.
    pub fn grow(&mut self, tet_slots: usize) {
        if self.parent.len() < tet_slots {
            if self.parent.capacity() < tet_slots {
                // An eighth more than asked for, so that it seldom copies.
                let more = tet_slots + tet_slots / 8 - self.parent.len();
                self.parent.reserve_exact(more);
                self.place.reserve_exact(more);
            }
            self.parent.resize(tet_slots, NONE);
            self.place.resize(tet_slots, NONE);
        }
    }

    /// The touched base tetrahedra in the order in which they were touched.
    pub fn touched(&self) -> &[TetId] {
        &self.bases
    }

    /// The place of a base tetrahedron among the touched ones.
    pub fn place(&self, base: TetId) -> Option<usize> {
        self.place.get(base.index()).copied().filter(|p| *p != NONE).map(|p| p as usize)
    }

    /// The four nodes of the touched base tetrahedron at a place.
    pub fn place_corners(&self, place: usize) -> [NodeId; 4] {
        self.corners[place]
    }

    /// The base tetrahedron of a child.
    pub fn parent(&self, tet: TetId) -> Option<TetId> {
        self.parent.get(tet.index()).copied().filter(|p| *p != NONE).map(TetId)
    }

    /// Whether this is a base tetrahedron.
    pub fn contains(&self, topology: &Topology, tet: TetId) -> bool {
        self.place(tet).is_some() || (topology.contains(tet) && self.parent(tet).is_none())
    }

    /// The four nodes of a base tetrahedron.
    pub fn corners(&self, topology: &Topology, base: TetId) -> [NodeId; 4] {
        self.place(base).map_or_else(|| topology.corners(base), |p| self.corners[p])
    }

    /// The four nodes of a tetrahedron when it is one of the base.
    pub fn known_corners(&self, topology: &Topology, tet: TetId) -> Option<[NodeId; 4]> {
        match self.place(tet) {
            Some(place) => Some(self.corners[place]),
            None => (topology.contains(tet) && self.parent(tet).is_none()).then(|| topology.corners(tet)),
        }
    }

    /// The key of face `face` of a base tetrahedron.
    pub fn face_key(&self, topology: &Topology, base: TetId, face: usize) -> FaceKey {
        let c = self.corners(topology, base);
        let [i, j, k] = FACES[face];
        FaceKey::new(c[i], c[j], c[k])
    }

    /// The base tetrahedra around a node.
    pub fn around_node<'a>(&'a self, topology: &'a Topology, node: NodeId) -> impl Iterator<Item = TetId> + 'a {
        topology.around_node(node).iter().copied().filter(|t| self.parent(*t).is_none()).chain(self.touched_around(node))
    }

    /// The touched base tetrahedra around a node.
    pub fn touched_around(&self, node: NodeId) -> impl Iterator<Item = TetId> + '_ {
        let mut next = self.first.get(&node).copied().unwrap_or(NONE);
        std::iter::from_fn(move || {
            let (tet, then) = *self.links.get(next as usize)?;
            next = then;
            Some(tet)
        })
    }

    /// The base tetrahedra around an edge.
    pub fn around_edge<'a>(&'a self, topology: &'a Topology, a: NodeId, b: NodeId) -> impl Iterator<Item = TetId> + 'a {
        self.around_node(topology, a).filter(move |t| self.corners(topology, *t).contains(&b))
    }

    /// The one or two base tetrahedra that have this face.
    pub fn around_face<'a>(&'a self, topology: &'a Topology, face: FaceKey) -> impl Iterator<Item = TetId> + 'a {
        let [a, b, c] = face.nodes();
        self.around_node(topology, a).filter(move |t| {
            let n = self.corners(topology, *t);
            n.contains(&b) && n.contains(&c)
        })
    }

    /// Notes that a base tetrahedron is about to leave the mesh. Returns its place.
    pub fn touch(&mut self, topology: &Topology, base: TetId) -> usize {
        let at = self.bases.len();
        let corners = topology.corners(base);
        self.bases.push(base);
        self.corners.push(corners);
        self.place[base.index()] = at as u32;
        for node in corners {
            let link = self.links.len() as u32;
            let before = self.first.insert(node, link).unwrap_or(NONE);
            self.links.push((base, before));
        }
        at
    }

    /// Notes whose child a tetrahedron of the mesh is.
    pub fn adopt(&mut self, child: TetId, base: TetId) {
        self.grow(child.index() + 1);
        self.parent[child.index()] = base.0;
    }

    /// Notes that a child is no more.
    pub fn disown(&mut self, child: TetId) {
        self.parent[child.index()] = NONE;
    }

    /// Makes all children base tetrahedra; the caller has disowned them.
    pub fn forget(&mut self) {
        for base in self.bases.drain(..) {
            self.place[base.index()] = NONE;
        }
        self.corners.clear();
        self.first.clear();
        self.links.clear();
    }
}
