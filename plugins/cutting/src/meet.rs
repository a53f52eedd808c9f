//! Search: everything that one step of the sheet meets, walking over base tetrahedra from those it met last and from where it enters. The cost
//! depends on what is met, not on the mesh.

use crate::cutter::Cutter;
use crate::sheet::{Aabb, Hit, Strip, contains, pierce};
use crate::sides::STICK;
use crate::stroke::FaceWeights;
use keyhole_tetmesh::{DVec3, EDGES, EdgeKey, FaceKey, NodeId, TetId, TetMesh};
use rustc_hash::{FxHashMap, FxHashSet};

/// What a step of the sheet meets.
#[derive(Debug, Default)]
pub(crate) struct Meeting {
    /// Base tetrahedra that the present line is in.
    pub occupied: Occupied,
    /// Where the strip crosses edges, at most once each; `t` from the node with the smaller id.
    pub hits: FxHashMap<EdgeKey, Hit>,
    /// Where the present line pierces faces.
    pub front: FxHashMap<FaceKey, FaceWeights>,
    /// Where the paths of tip and heel pierce faces.
    pub border: FxHashMap<FaceKey, FaceWeights>,
    /// Area of the strip inside the tissue, m2.
    pub area: f64,
    /// Nodes of the base tetrahedra that the strip meets.
    pub near: Vec<NodeId>,
    /// Nodes of earlier cuts close to the strip, ascending.
    pub beside: Vec<NodeId>,
}

/// Base tetrahedra that a line is in, and their nodes with the twins of these.
#[derive(Clone, Debug, Default)]
pub(crate) struct Occupied {
    pub tets: FxHashSet<TetId>,
    pub nodes: FxHashSet<NodeId>,
}

impl Occupied {
    fn insert(&mut self, tet: TetId, corners: impl IntoIterator<Item = NodeId>) {
        if self.tets.insert(tet) {
            self.nodes.extend(corners);
        }
    }

    pub(crate) fn clear(&mut self) {
        self.tets.clear();
        self.nodes.clear();
    }
}

impl Meeting {
    /// Keeps the hits of an edge. An edge hit twice in one step dips through the sheet and comes back: both of its ends are on one side, and the
    /// sheet may as well pass it by.
    fn record(&mut self, edge: EdgeKey, hits: &[Hit]) {
        if hits.len() % 2 == 1 {
            self.hits.insert(edge, hits[0]);
        }
    }

    /// Keeps where the border of the strip goes through a face. What of the strip goes through a face without crossing an edge of it ends there.
    fn pierce(&mut self, strip: &Strip, key: FaceKey, face: [DVec3; 3], near: &[usize]) -> Option<Pierced> {
        let bounds = Aabb::of(&face);
        let (mut by_line, mut by_other) = (false, false);
        for &triangle in near {
            let Some(w) = strip.rail_through(triangle, face, &bounds) else { continue };
            if Strip::is_rail_now(triangle) {
                self.front.insert(key, w);
                by_line = true;
            } else {
                by_other = true;
            }
        }
        for [p, q] in strip.ends() {
            let w = if Aabb::of(&[p, q]).overlaps(&bounds) { pierce(face, p, q) } else { None };
            if let Some(w) = w {
                self.border.insert(key, w);
                by_other = true;
            }
        }
        if by_line { Some(Pierced::ByLine) } else { by_other.then_some(Pierced::ByOther) }
    }
}

/// What of the border of a strip goes through a face.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Pierced {
    /// The present line.
    ByLine,
    /// The line before, or the paths of the ends.
    ByOther,
}

/// Room for one search, used again for the next.
#[derive(Clone, Debug, Default)]
pub(crate) struct Search {
    /// Base tetrahedra to look at, each once.
    queue: Vec<TetId>,
    /// By tetrahedron slot, a bit each: whether it is in the queue.
    seen: Vec<u64>,
    /// Whether the strip crosses an edge.
    tested: FxHashMap<EdgeKey, bool>,
    pierced: FxHashMap<FaceKey, Option<Pierced>>,
    /// Triangles of the strip near a tetrahedron.
    near: Vec<usize>,
    hits: Vec<Hit>,
}

impl Search {
    /// Forgets the last search.
    fn clear(&mut self, tet_slots: usize) {
        for tet in self.queue.drain(..) {
            self.seen[tet.index() / 64] = 0;
        }
        self.seen.resize(tet_slots.div_ceil(64), 0);
        self.tested.clear();
        self.pierced.clear();
    }

    fn push(&mut self, tet: TetId) {
        let (word, bit) = (tet.index() / 64, 1 << (tet.index() % 64));
        if self.seen[word] & bit == 0 {
            self.seen[word] |= bit;
            self.queue.push(tet);
        }
    }
}

impl Cutter {
    /// Everything that a strip meets.
    pub(crate) fn meet(&mut self, mesh: &TetMesh, course: usize, strip: &Strip) -> Meeting {
        let mut search = std::mem::take(&mut self.search);
        search.clear(mesh.tet_slots());
        let meeting = self.walk(mesh, course, strip, &mut search);
        self.search = search;
        meeting
    }

    fn walk(&self, mesh: &TetMesh, course: usize, strip: &Strip, search: &mut Search) -> Meeting {
        let topology = mesh.topology();
        let mut meeting = Meeting::default();
        let mut known: Vec<TetId> = self.courses[course].occupied.tets.iter().copied().collect();
        known.sort_unstable();
        for tet in known {
            search.push(tet);
        }
        self.seed(mesh, strip, search);
        let mut next = 0;
        while let Some(&tet) = search.queue.get(next) {
            next += 1;
            let Some(corners) = self.before.known_corners(topology, tet) else { continue };
            let points = corners.map(|n| mesh.rest(n));
            let bounds = Aabb::of(&points);
            strip.near(&bounds, &mut search.near);
            if search.near.is_empty() {
                continue;
            }
            for (node, point) in corners.into_iter().zip(points).filter(|(n, _)| self.is_wound_node(*n)) {
                if strip.distance(point, &search.near) <= STICK * self.mean_edge_m() {
                    meeting.beside.push(node);
                }
            }
            let mut meets = false;
            for [i, j] in EDGES {
                let edge = EdgeKey::new(corners[i], corners[j]);
                let crossed = search.tested.get(&edge).copied().unwrap_or_else(|| {
                    let [a, b] = edge.nodes();
                    search.hits.clear();
                    strip.crossings(mesh.rest(a), mesh.rest(b), &search.near, &mut search.hits);
                    meeting.record(edge, &search.hits);
                    let crossed = !search.hits.is_empty();
                    search.tested.insert(edge, crossed);
                    if crossed {
                        for t in self.around_twins(mesh, [a, b]) {
                            search.push(t);
                        }
                    }
                    crossed
                });
                meets |= crossed;
            }
            for face in keyhole_tetmesh::FACES {
                let key = FaceKey::new(corners[face[0]], corners[face[1]], corners[face[2]]);
                let pierced = search.pierced.get(&key).copied().unwrap_or_else(|| {
                    let pierced = meeting.pierce(strip, key, key.nodes().map(|n| mesh.rest(n)), &search.near);
                    search.pierced.insert(key, pierced);
                    if pierced.is_some() {
                        for other in self.around_twins(mesh, key.nodes()) {
                            search.push(other);
                        }
                    }
                    pierced
                });
                meets |= pierced.is_some();
                if pierced == Some(Pierced::ByLine) {
                    meeting.occupied.insert(tet, corners.into_iter().flat_map(|n| self.twins(mesh, n)));
                }
            }
            if strip.now().iter().any(|p| bounds.holds(*p) && contains(points, *p)) {
                meeting.occupied.insert(tet, corners.into_iter().flat_map(|n| self.twins(mesh, n)));
                meets = true;
            }
            if meets {
                meeting.near.extend(corners);
                meeting.area += strip.area_inside(points, &search.near);
            }
        }
        meeting.near.sort_unstable();
        meeting.near.dedup();
        meeting.beside.sort_unstable();
        meeting.beside.dedup();
        meeting
    }

    /// Where a walk begins: the tetrahedra that hold the points of the present line, and all near the parts of the strip that are not deep in tissue
    /// from end to end, for there the strip may meet a corner of it between two points, or a piece that an earlier cut has parted from the others.
    fn seed(&self, mesh: &TetMesh, strip: &Strip, search: &mut Search) {
        let mut deep_before = false;
        for (j, point) in strip.now().iter().enumerate() {
            let holder = self.tet_at(mesh, *point);
            if let Some(tet) = holder {
                search.push(tet);
            }
            let deep = holder.is_some_and(|t| !self.before.corners(mesh.topology(), t).iter().any(|n| self.is_surface_node(*n)));
            if j > 0 && !(deep_before && deep) {
                self.grid.touching(strip.quad(j - 1), |tet| search.push(tet));
            }
            deep_before = deep;
        }
    }
}
