//! Refinement: brings the children of the base tetrahedra concerned up to what is released, and edits the mesh where they differ.

use crate::cutter::Cutter;
use crate::kernel::{Child, Vertex, subdivide_into};
use crate::release::{FaceState, split_order, split_rank};
use crate::separate::hash_of;
use crate::sheet::weighted;
use crate::stroke::{CrossingState, FaceWeights, Placed, SplitRank, Touched};
use keyhole_tetmesh::quality::is_positive;
use keyhole_tetmesh::{DVec3, EDGES, EdgeKey, FACES, FaceKey, NodeId, NodeWeights, TetId, TetMesh};
use rustc_hash::FxHashSet;
use smallvec::{SmallVec, smallvec};
use std::ops::Range;

/// Stands for a node that separation has yet to name.
pub(crate) const UNNAMED: NodeId = NodeId(u32::MAX);

/// A point of a face, and whether the sheet runs right through it.
type FacePoint = (FaceWeights, FaceState);

/// What a base tetrahedron is to become.
struct Plan {
    base: TetId,
    faces: SmallVec<[FaceKey; 4]>,
    edges: SmallVec<[EdgeKey; 6]>,
    /// Its children among those of all plans.
    children: Range<usize>,
}

/// What a step changes: face points that come, move or go, and base tetrahedra that become something else.
#[derive(Default)]
struct Changes {
    /// Ascending by face, with the point before this step.
    faces: Vec<(FaceKey, Option<FacePoint>)>,
    plans: Vec<Plan>,
    children: Vec<Child>,
}

impl Changes {
    /// The point that a face had before this step, when the step changes it.
    fn before(&self, face: FaceKey) -> Option<Option<FacePoint>> {
        self.faces.binary_search_by_key(&face, |f| f.0).ok().map(|i| self.faces[i].1)
    }
}

impl Cutter {
    /// Rest position of a vertex, m.
    pub(crate) fn vertex_rest(&self, mesh: &TetMesh, vertex: Vertex) -> DVec3 {
        match vertex {
            Vertex::Corner(n) => mesh.rest(n),
            Vertex::Edge(e) => {
                let [a, b] = e.nodes();
                mesh.rest(a).lerp(mesh.rest(b), self.stroke.crossings.get(&e).map_or(0.5, |c| c.t))
            }
            Vertex::Face(f) => on_face(mesh, f, self.stroke.face_points.get(&f).map_or([1.0 / 3.0; 3], |(w, _)| *w)),
        }
    }

    /// Brings the mesh up to what is released around the candidates (base tetrahedra) and in the faces given, both in any order.
    pub(crate) fn refine(&mut self, mesh: &mut TetMesh, mut candidates: Vec<TetId>, faces: &[FaceKey]) {
        candidates.sort_unstable();
        candidates.dedup();
        candidates.retain(|t| self.before.contains(mesh.topology(), *t));
        let mut held: FxHashSet<FaceKey> = FxHashSet::default();
        let mut changes = self.changes(mesh, &candidates, faces, &held);
        while self.take_back(mesh, &changes, &mut held) {
            self.undo(changes);
            changes = self.changes(mesh, &candidates, faces, &held);
        }

        // New points in the tissue as it is before the edit; then moved points; then tetrahedra.
        let added = self.add_points(mesh, &changes);
        self.move_points(mesh, &changes, &added);
        let mut doomed = Vec::new();
        let mut vertices = self.relabel(mesh);
        for plan in &changes.plans {
            self.replan(mesh, plan, &changes.children[plan.children.clone()], &mut doomed, &mut vertices);
        }
        vertices.sort_unstable();
        vertices.dedup();
        let mut concerned: Vec<TetId> = changes.plans.iter().map(|p| p.base).collect();
        let unused = self.separate(mesh, &vertices, &added, &mut concerned);
        self.place(mesh, concerned, doomed);
        for node in unused {
            mesh.remove_node(node);
        }
    }

    /// Sets the released face points, and finds what the candidates are to become. A held face keeps the point it had.
    fn changes(&mut self, mesh: &TetMesh, candidates: &[TetId], faces: &[FaceKey], held: &FxHashSet<FaceKey>) -> Changes {
        let topology = mesh.topology();
        let mut changes = Changes::default();
        let mut tets = candidates.to_vec();
        let mut seen: FxHashSet<TetId> = tets.iter().copied().collect();
        let mut seen_faces: FxHashSet<FaceKey> = FxHashSet::default();
        let mut next = 0;
        let mut pending: SmallVec<[FaceKey; 16]> = faces.iter().copied().collect();
        loop {
            for face in pending.drain(..) {
                if !seen_faces.insert(face) || held.contains(&face) {
                    continue;
                }
                let old = self.stroke.face_points.get(&face).copied();
                let new = self.face_point(mesh, face);
                if new == old {
                    continue;
                }
                // A face whose point comes or goes changes the tetrahedra on both of its sides.
                if new.map(|n| n.1) != old.map(|o| o.1) {
                    tets.extend(self.before.around_face(topology, face).filter(|t| seen.insert(*t)));
                }
                changes.faces.push((face, old));
                match new {
                    Some(point) => self.stroke.face_points.insert(face, point),
                    None => self.stroke.face_points.remove(&face),
                };
            }
            let Some(&tet) = tets.get(next) else { break };
            next += 1;
            let corners = self.before.corners(topology, tet);
            for [i, j, k] in FACES {
                pending.push(FaceKey::new(corners[i], corners[j], corners[k]));
            }
        }
        changes.faces.sort_unstable_by_key(|f| f.0);
        tets.sort_unstable();
        for base in tets {
            self.plan(mesh, base, &mut changes);
        }
        changes
    }

    /// Puts the face points back to what they were.
    fn undo(&mut self, changes: Changes) {
        for (face, old) in changes.faces {
            match old {
                Some(point) => self.stroke.face_points.insert(face, point),
                None => self.stroke.face_points.remove(&face),
            };
        }
    }

    /// Adds what a base tetrahedron is to become, when it differs from what it is.
    fn plan(&self, mesh: &TetMesh, base: TetId, changes: &mut Changes) {
        let topology = mesh.topology();
        let corners = self.before.corners(topology, base);
        let mut faces: SmallVec<[(FaceState, FaceKey); 4]> = SmallVec::new();
        for [i, j, k] in FACES {
            let face = FaceKey::new(corners[i], corners[j], corners[k]);
            if let Some((_, state)) = self.stroke.face_points.get(&face) {
                faces.push((*state, face));
            }
        }
        faces.sort_unstable();
        let faces: SmallVec<[FaceKey; 4]> = faces.into_iter().map(|(_, f)| f).collect();
        let mut edges: SmallVec<[EdgeKey; 6]> = SmallVec::new();
        for [i, j] in EDGES {
            let edge = EdgeKey::new(corners[i], corners[j]);
            if self.stroke.released(edge).is_some() {
                edges.push(edge);
            }
        }
        let same = match self.before.place(base) {
            Some(place) => {
                // The same edges are in the same order.
                let known = &self.stroke.touched[place];
                known.faces == faces && known.edges.len() == edges.len() && edges.iter().all(|e| known.edges.contains(e))
            }
            None => faces.is_empty() && edges.is_empty() && !corners.iter().any(|n| self.stroke.on_sheet.contains_key(n)),
        };
        if !same {
            let ranked = |e: EdgeKey| (self.stroke.ranks.get(&e).copied().unwrap_or_else(|| split_rank(mesh, e)), e);
            let mut order: SmallVec<[(SplitRank, EdgeKey); 6]> = edges.into_iter().map(ranked).collect();
            order.sort_by(|a, b| split_order((&a.0, a.1), (&b.0, b.1)));
            let edges: SmallVec<[EdgeKey; 6]> = order.into_iter().map(|o| o.1).collect();
            let start = changes.children.len();
            subdivide_into(corners, &faces, &edges, &mut changes.children);
            changes.plans.push(Plan { base, faces, edges, children: start..changes.children.len() });
        }
    }

    /// Takes back the events of this step that would make a tetrahedron that is not positive: crossings wait for the next step, face points
    /// stay where they were. Returns whether there were any. Only rounding can bring this about.
    fn take_back(&mut self, mesh: &TetMesh, changes: &Changes, held: &mut FxHashSet<FaceKey>) -> bool {
        let mut any = false;
        for plan in &changes.plans {
            let children = &changes.children[plan.children.clone()];
            if children.iter().all(|c| is_positive(c.map(|v| self.vertex_rest(mesh, v)))) {
                continue;
            }
            for edge in plan.edges.iter().filter(|e| !self.stroke.sides.contains_key(&Vertex::Edge(**e))) {
                if let Some(c) = self.stroke.crossings.get_mut(edge)
                    && c.state == CrossingState::Released
                {
                    c.state = CrossingState::Recorded;
                    c.settled = false;
                    self.stroke.unsettled.push(*edge);
                    any = true;
                }
            }
            for face in (0..4).map(|f| self.before.face_key(mesh.topology(), plan.base, f)) {
                any |= changes.before(face).is_some() && held.insert(face);
            }
            self.operations.deferred += 1;
        }
        any
    }

    /// Makes a node for each vertex that appears, where the tissue is now. Returns the first node of each, ascending by vertex.
    fn add_points(&mut self, mesh: &mut TetMesh, changes: &Changes) -> Vec<(Vertex, NodeId)> {
        let mut fresh: Vec<Vertex> = Vec::new();
        for plan in &changes.plans {
            fresh.extend(plan.edges.iter().map(|e| Vertex::Edge(*e)));
            fresh.extend(plan.faces.iter().map(|f| Vertex::Face(*f)));
        }
        fresh.sort_unstable();
        fresh.dedup();
        fresh.retain(|v| !self.stroke.sides.contains_key(v));
        fresh
            .into_iter()
            .map(|vertex| {
                let from: NodeWeights = match vertex {
                    Vertex::Edge(e) => {
                        let [a, b] = e.nodes();
                        let t = self.stroke.crossings.get(&e).map_or(0.5, |c| c.t);
                        smallvec![(a, 1.0 - t), (b, t)]
                    }
                    Vertex::Face(f) => self.tissue_at(mesh, f, self.stroke.face_points[&f].0, changes),
                    Vertex::Corner(n) => smallvec![(n, 1.0)],
                };
                (vertex, mesh.add_node(self.vertex_rest(mesh, vertex), from))
            })
            .collect()
    }

    /// Moves the nodes of face points that are elsewhere now, and counts the children that change with them.
    fn move_points(&mut self, mesh: &mut TetMesh, changes: &Changes, added: &[(Vertex, NodeId)]) {
        for &(face, then) in &changes.faces {
            let (Some((now, _)), Some((then, _))) = (self.stroke.face_points.get(&face).copied(), then) else { continue };
            let vertex = Vertex::Face(face);
            if now == then || added.binary_search_by_key(&vertex, |a| a.0).is_ok() {
                continue;
            }
            let Some(sides) = self.stroke.sides.get(&vertex) else { continue };
            let mut nodes: SmallVec<[NodeId; 4]> = sides.iter().map(|s| s.node).collect();
            let from = self.tissue_at(mesh, face, now, changes);
            // Whoever follows the edits one by one must find the node that the place is told by where it was.
            nodes.sort_by_key(|n| from.iter().any(|(f, _)| f == n));
            let rest = on_face(mesh, face, now);
            for node in nodes {
                mesh.move_node(node, rest, from.clone());
                self.operations.updated += mesh.topology().around_node(node).len() as u64;
            }
        }
    }

    /// The point of a base face with weights `w`, in the nodes of the child face that holds it now.
    fn tissue_at(&self, mesh: &TetMesh, face: FaceKey, w: FaceWeights, changes: &Changes) -> NodeWeights {
        let base_nodes: NodeWeights = face.nodes().iter().copied().zip(w).collect();
        let mut best: Option<(f64, NodeWeights)> = None;
        let mut bases: SmallVec<[TetId; 2]> = self.before.around_face(mesh.topology(), face).collect();
        bases.sort_unstable();
        for place in bases.into_iter().filter_map(|b| self.before.place(b)) {
            for child in &self.stroke.touched[place].children {
                let on: SmallVec<[(NodeId, FaceWeights); 4]> =
                    (0..4).filter_map(|i| self.on_base_face(face, child.key[i], changes).map(|b| (child.nodes[i], b))).collect();
                let [a, b, c] = on.as_slice() else { continue };
                let Some(inner) = solve_weights([a.1, b.1, c.1], w) else { continue };
                let least = inner.iter().copied().fold(f64::INFINITY, f64::min);
                if best.as_ref().is_none_or(|(l, _)| least > *l) {
                    best = Some((least, [a.0, b.0, c.0].into_iter().zip(inner).collect()));
                }
            }
        }
        best.map_or(base_nodes, |(_, nodes)| nodes)
    }

    /// A vertex as weights of the nodes of a base face, when it lies on that face, as the mesh was before this step.
    fn on_base_face(&self, face: FaceKey, vertex: Vertex, changes: &Changes) -> Option<FaceWeights> {
        let nodes = face.nodes();
        let at = |n: NodeId| nodes.iter().position(|m| *m == n);
        match vertex {
            Vertex::Corner(n) => at(n).map(|i| std::array::from_fn(|j| if i == j { 1.0 } else { 0.0 })),
            Vertex::Edge(e) => {
                let [a, b] = e.nodes();
                let (i, j) = (at(a)?, at(b)?);
                let t = self.stroke.crossings.get(&e)?.t;
                let mut w = [0.0; 3];
                w[i] = 1.0 - t;
                w[j] = t;
                Some(w)
            }
            Vertex::Face(f) if f == face => changes.before(f).unwrap_or_else(|| self.stroke.face_points.get(&f).copied()).map(|(w, _)| w),
            Vertex::Face(_) => None,
        }
    }

    /// Renews the sides of the children whose base's corners have become known or come to lie on the sheet. Returns the vertices on the sheet
    /// of those that changed.
    fn relabel(&mut self, mesh: &TetMesh) -> Vec<Vertex> {
        let mut vertices = Vec::new();
        let mut stale = std::mem::take(&mut self.stroke.stale_labels);
        stale.sort_unstable();
        stale.dedup();
        for base in stale.drain(..) {
            let Some(place) = self.before.place(base) else { continue };
            let corners = self.before.corners(mesh.topology(), base);
            let labels = self.stroke.labels(corners);
            for i in 0..self.stroke.touched[place].children.len() {
                let key = self.stroke.touched[place].children[i].key;
                self.stroke.touched[place].children[i].label = self.stroke.child_label(&key, corners, labels);
            }
            let touched = &self.stroke.touched[place];
            self.add_sheet_vertices(corners, &touched.faces, &touched.edges, &mut vertices);
        }
        self.stroke.stale_labels = stale;
        vertices
    }

    /// Replaces the list of children, keeping those that stay. `vertices` gains all of the sheet that the change concerns.
    fn replan(&mut self, mesh: &mut TetMesh, plan: &Plan, keys: &[Child], doomed: &mut Vec<TetId>, vertices: &mut Vec<Vertex>) {
        let place = self.before.place(plan.base).unwrap_or_else(|| {
            let place = self.before.touch(mesh.topology(), plan.base);
            let touched = Touched {
                tet: mesh.tet(plan.base),
                faces: SmallVec::new(),
                edges: SmallVec::new(),
                children: self.spare.pop().unwrap_or_default(),
            };
            self.stroke.touched.push(touched);
            mesh.retire_tet(plan.base);
            self.operations.deleted += 1;
            place
        });
        let corners = self.before.corners(mesh.topology(), plan.base);
        let labels = self.stroke.labels(corners);
        let mut old = std::mem::replace(&mut self.stroke.touched[place].children, self.spare.pop().unwrap_or_default());
        let touched = &self.stroke.touched[place];
        self.add_sheet_vertices(corners, &touched.faces, &touched.edges, vertices);
        self.add_sheet_vertices(corners, &plan.faces, &plan.edges, vertices);
        for &key in keys {
            let label = self.stroke.child_label(&key, corners, labels);
            let placed = match old.iter().position(|c| c.key == key) {
                Some(i) => Placed { label, ..old.swap_remove(i) },
                None => {
                    self.operations.created += 1;
                    Placed { key, hashes: key.map(hash_of), nodes: self.unnamed(&key), id: None, label }
                }
            };
            self.stroke.touched[place].children.push(placed);
        }
        for gone in old.drain(..).filter_map(|c| c.id) {
            self.operations.deleted += 1;
            doomed.push(gone);
        }
        self.spare.push(old);
        self.stroke.touched[place].faces.clone_from(&plan.faces);
        self.stroke.touched[place].edges.clone_from(&plan.edges);
    }

    /// Adds the vertices on the sheet that the children of a base tetrahedron have when these faces and edges of it have points.
    fn add_sheet_vertices(&self, corners: [NodeId; 4], faces: &[FaceKey], edges: &[EdgeKey], vertices: &mut Vec<Vertex>) {
        vertices.extend(corners.into_iter().filter(|n| self.stroke.on_sheet.contains_key(n)).map(Vertex::Corner));
        vertices.extend(edges.iter().map(|e| Vertex::Edge(*e)));
        vertices.extend(faces.iter().map(|f| Vertex::Face(*f)));
    }

    fn unnamed(&self, key: &Child) -> [NodeId; 4] {
        key.map(|v| match v {
            Vertex::Corner(n) if !self.stroke.on_sheet.contains_key(&n) => n,
            _ => UNNAMED,
        })
    }

    /// Puts the children whose nodes are new or changed into the mesh.
    fn place(&mut self, mesh: &mut TetMesh, mut concerned: Vec<TetId>, doomed: Vec<TetId>) {
        for id in doomed {
            self.before.disown(id);
            mesh.remove_tet(id);
        }
        concerned.sort_unstable();
        concerned.dedup();
        for base in concerned {
            let Some(place) = self.before.place(base) else { continue };
            let touched = &mut self.stroke.touched[place];
            for child in &mut touched.children {
                if child.nodes.contains(&UNNAMED) {
                    continue;
                }
                if let Some(id) = child.id {
                    if mesh.corners(id) == child.nodes {
                        continue;
                    }
                    self.before.disown(id);
                    mesh.remove_tet(id);
                    self.operations.updated += 1;
                }
                let id = mesh.add_tet(child.nodes, touched.tet);
                child.id = Some(id);
                self.before.adopt(id, base);
            }
        }
    }

    /// Area that the stroke in progress has opened, m2: one side of the faces of the cut.
    pub(crate) fn stroke_area(&self, mesh: &TetMesh) -> f64 {
        let mut twice = 0.0;
        for (touched, base) in self.stroke.touched.iter().zip(self.before.touched()) {
            for (child, id) in touched.children.iter().filter_map(|c| c.id.map(|id| (c, id))) {
                for (face, corners) in FACES.into_iter().enumerate() {
                    if mesh.topology().neighbour(id, face).is_none()
                        && corners.iter().all(|&i| self.stroke.is_on_sheet(child.key[i]))
                        && !self.was_boundary(mesh, *base, corners.map(|i| child.key[i]))
                    {
                        let [a, b, c] = corners.map(|i| mesh.rest(child.nodes[i]));
                        twice += (b - a).cross(c - a).length() / 2.0;
                    }
                }
            }
        }
        twice / 2.0
    }

    /// Whether a face of a child is a part of a face of its base that had nothing beyond it.
    pub(crate) fn was_boundary(&self, mesh: &TetMesh, base: TetId, face: [Vertex; 3]) -> bool {
        let topology = mesh.topology();
        (0..4).map(|f| self.before.face_key(topology, base, f)).any(|key| {
            let nodes = key.nodes();
            let on_it = |v: &Vertex| match v {
                Vertex::Corner(n) => nodes.contains(n),
                Vertex::Edge(e) => e.nodes().iter().all(|n| nodes.contains(n)),
                Vertex::Face(f) => *f == key,
            };
            face.iter().all(on_it) && self.before.around_face(topology, key).count() == 1
        })
    }
}

fn on_face(mesh: &TetMesh, face: FaceKey, w: FaceWeights) -> DVec3 {
    weighted(face.nodes().map(|n| mesh.rest(n)), w)
}

/// The weights of three points (given as weights themselves) that make `target`; `None` when the three are on a line.
fn solve_weights(points: [FaceWeights; 3], target: FaceWeights) -> Option<[f64; 3]> {
    let area = |p: FaceWeights, q: FaceWeights, r: FaceWeights| (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]);
    let [a, b, c] = points;
    let whole = area(a, b, c);
    (whole != 0.0).then(|| [area(target, b, c) / whole, area(a, target, c) / whole, area(a, b, target) / whole])
}
