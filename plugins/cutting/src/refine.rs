//! Refinement: brings the children of the base tetrahedra concerned up to what is released, and edits the mesh where they differ.

use crate::cutter::Cutter;
use crate::kernel::{Child, Vertex, subdivide};
use crate::release::{FaceState, split_order, split_rank};
use crate::stroke::{CrossingState, FaceWeights, Placed, Touched};
use keyhole_tetmesh::quality::is_positive;
use keyhole_tetmesh::{DVec3, EDGES, EdgeKey, FaceKey, NodeId, NodeWeights, TetId, TetMesh};
use rustc_hash::{FxHashMap, FxHashSet};
use smallvec::smallvec;
use std::collections::{BTreeMap, BTreeSet};

/// Stands for a node that separation has yet to name.
pub(crate) const UNNAMED: NodeId = NodeId(u32::MAX);

/// How often a step is taken back before it is left as it is: each time takes back all of the step's events at the places at fault.
const ROUNDS: usize = 4;

/// What a base tetrahedron is to become.
struct Plan {
    base: TetId,
    faces: Vec<FaceKey>,
    edges: Vec<EdgeKey>,
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
            Vertex::Face(f) => self.on_face(mesh, f, self.stroke.face_points.get(&f).copied().unwrap_or([1.0 / 3.0; 3])),
        }
    }

    fn on_face(&self, mesh: &TetMesh, face: FaceKey, w: FaceWeights) -> DVec3 {
        let [a, b, c] = face.nodes().map(|n| mesh.rest(n));
        a * w[0] + b * w[1] + c * w[2]
    }

    /// Brings the mesh up to what is released around the candidates.
    pub(crate) fn refine(&mut self, mesh: &mut TetMesh, mut candidates: FxHashSet<TetId>) {
        candidates.retain(|t| self.base.contains(*t));
        let mut candidates: BTreeSet<TetId> = candidates.into_iter().collect();
        let fresh_on_sheet: Vec<TetId> = candidates
            .iter()
            .flat_map(|t| self.base.corners(*t))
            .filter(|n| self.stroke.on_sheet.contains_key(n))
            .collect::<BTreeSet<NodeId>>()
            .into_iter()
            .flat_map(|n| self.base.around_node(n).to_vec())
            .collect();
        candidates.extend(fresh_on_sheet);

        let old_points = self.stroke.face_points.clone();
        // A face whose point comes or goes changes the tetrahedra on both of its sides.
        let mut faces_seen: BTreeSet<FaceKey> = BTreeSet::new();
        let mut fresh: Vec<TetId> = candidates.iter().copied().collect();
        while let Some(tet) = fresh.pop() {
            for face in (0..4).map(|f| self.base.face_key(tet, f)) {
                if faces_seen.insert(face) && self.face_point(mesh, face).is_some() != old_points.contains_key(&face) {
                    fresh.extend(self.base.around_face(face).filter(|t| candidates.insert(*t)));
                }
            }
        }
        let mut held: FxHashSet<FaceKey> = FxHashSet::default();
        let mut plans = self.plans(mesh, &candidates, &faces_seen, &old_points, &held);
        for _ in 0..ROUNDS {
            if !self.take_back(mesh, &plans, &mut held) {
                break;
            }
            plans = self.plans(mesh, &candidates, &faces_seen, &old_points, &held);
        }

        // New points in the tissue as it is before the edit; then moved points; then tetrahedra.
        let added = self.add_points(mesh, &plans, &old_points);
        self.move_points(mesh, &faces_seen, &old_points, &added);
        let mut doomed = Vec::new();
        let mut vertices: BTreeSet<Vertex> = BTreeSet::new();
        for plan in &plans {
            self.replan(mesh, plan, &mut doomed, &mut vertices);
        }
        for tet in &candidates {
            if let Some(touched) = self.stroke.touched.get(tet) {
                let on_sheet = touched.children.iter().flat_map(|c| c.key).filter(|v| self.stroke.is_on_sheet(*v));
                vertices.extend(on_sheet);
            }
        }
        let unused = self.separate(mesh, &vertices, &added);
        self.place(mesh, &candidates, doomed);
        for node in unused {
            mesh.remove_node(node);
        }
    }

    /// What the candidates are to become, and with it the released face points. A held face keeps the point it had.
    fn plans(
        &mut self,
        mesh: &TetMesh,
        candidates: &BTreeSet<TetId>,
        faces: &BTreeSet<FaceKey>,
        old_points: &FxHashMap<FaceKey, FaceWeights>,
        held: &FxHashSet<FaceKey>,
    ) -> Vec<Plan> {
        self.stroke.face_points.clone_from(old_points);
        let mut points = old_points.clone();
        let mut states: FxHashMap<FaceKey, FaceState> = FxHashMap::default();
        for face in faces {
            let mut point = self.face_point(mesh, *face);
            if held.contains(face) {
                point = point.and_then(|(_, state)| old_points.get(face).map(|w| (*w, state)));
            }
            match point {
                Some((w, state)) => {
                    points.insert(*face, w);
                    states.insert(*face, state);
                }
                None => {
                    points.remove(face);
                }
            }
        }
        self.stroke.face_points = points;
        let plans = candidates.iter().map(|&tet| self.plan(mesh, tet, &states));
        plans
            .filter(|plan| {
                let trivial = plan.faces.is_empty() && plan.edges.is_empty();
                let known = self.stroke.touched.get(&plan.base);
                let on_sheet = || self.base.corners(plan.base).iter().any(|n| self.stroke.on_sheet.contains_key(n));
                let same = known.is_some_and(|k| k.faces == plan.faces && k.edges == plan.edges);
                !same && (!trivial || known.is_some() || on_sheet())
            })
            .collect()
    }

    /// Takes back the events of this step that would make a tetrahedron that is not positive: crossings wait for the next step, face points
    /// stay where they were. Returns whether there were any. Only rounding can bring this about.
    fn take_back(&mut self, mesh: &TetMesh, plans: &[Plan], held: &mut FxHashSet<FaceKey>) -> bool {
        let mut any = false;
        for plan in plans {
            let children = subdivide(self.base.corners(plan.base), &plan.faces, &plan.edges);
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
            for face in &plan.faces {
                any |= held.insert(*face);
            }
            self.operations.deferred += 1;
        }
        any
    }

    fn plan(&self, mesh: &TetMesh, base: TetId, states: &FxHashMap<FaceKey, FaceState>) -> Plan {
        let corners = self.base.corners(base);
        let mut faces: Vec<(FaceState, FaceKey)> =
            (0..4).map(|f| self.base.face_key(base, f)).filter_map(|f| states.get(&f).map(|s| (*s, f))).collect();
        faces.sort_unstable();
        let mut edges: Vec<EdgeKey> =
            EDGES.iter().map(|&[i, j]| EdgeKey::new(corners[i], corners[j])).filter(|e| self.stroke.released(*e).is_some()).collect();
        let rank = |e: &EdgeKey| self.stroke.ranks.get(e).copied().unwrap_or_else(|| split_rank(mesh, *e));
        edges.sort_by(|a, b| split_order((&rank(a), *a), (&rank(b), *b)));
        Plan { base, faces: faces.into_iter().map(|(_, f)| f).collect(), edges }
    }

    /// Makes a node for each vertex that appears, where the tissue is now. Returns the first node of each.
    fn add_points(&mut self, mesh: &mut TetMesh, plans: &[Plan], old_points: &FxHashMap<FaceKey, FaceWeights>) -> BTreeMap<Vertex, NodeId> {
        let mut fresh: BTreeSet<Vertex> = BTreeSet::new();
        for plan in plans {
            fresh.extend(plan.edges.iter().map(|e| Vertex::Edge(*e)));
            fresh.extend(plan.faces.iter().map(|f| Vertex::Face(*f)));
        }
        fresh.retain(|v| !self.stroke.sides.contains_key(v));
        let mut added = BTreeMap::new();
        for vertex in fresh {
            let from: NodeWeights = match vertex {
                Vertex::Edge(e) => {
                    let [a, b] = e.nodes();
                    let t = self.stroke.crossings.get(&e).map_or(0.5, |c| c.t);
                    smallvec![(a, 1.0 - t), (b, t)]
                }
                Vertex::Face(f) => self.tissue_at(f, self.stroke.face_points[&f], old_points),
                Vertex::Corner(n) => smallvec![(n, 1.0)],
            };
            let rest = self.vertex_rest(mesh, vertex);
            added.insert(vertex, mesh.add_node(rest, from));
        }
        added
    }

    /// Moves the nodes of face points that are elsewhere now, and counts the children that change with them.
    fn move_points(
        &mut self,
        mesh: &mut TetMesh,
        faces: &BTreeSet<FaceKey>,
        old_points: &FxHashMap<FaceKey, FaceWeights>,
        added: &BTreeMap<Vertex, NodeId>,
    ) {
        for face in faces {
            let (Some(now), Some(then)) = (self.stroke.face_points.get(face).copied(), old_points.get(face)) else { continue };
            let vertex = Vertex::Face(*face);
            if now == *then || added.contains_key(&vertex) {
                continue;
            }
            let Some(nodes) = self.stroke.sides.get(&vertex) else { continue };
            let nodes: Vec<NodeId> = nodes.iter().map(|s| s.node).collect();
            let from = self.tissue_at(*face, now, old_points);
            let rest = self.on_face(mesh, *face, now);
            for node in nodes {
                mesh.move_node(node, rest, from.clone());
                self.operations.updated += mesh.topology().around_node(node).len() as u64;
            }
        }
    }

    /// The point of a base face with weights `w`, in the nodes of the child face that holds it now.
    fn tissue_at(&self, face: FaceKey, w: FaceWeights, old_points: &FxHashMap<FaceKey, FaceWeights>) -> NodeWeights {
        let base_nodes: NodeWeights = face.nodes().iter().copied().zip(w).collect();
        let mut best: Option<(f64, NodeWeights)> = None;
        let mut bases: Vec<TetId> = self.base.around_face(face).collect();
        bases.sort_unstable();
        for base in bases {
            let Some(touched) = self.stroke.touched.get(&base) else { continue };
            for child in &touched.children {
                let on: Vec<(NodeId, FaceWeights)> =
                    (0..4).filter_map(|i| self.on_base_face(face, child.key[i], old_points).map(|b| (child.nodes[i], b))).collect();
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
    fn on_base_face(&self, face: FaceKey, vertex: Vertex, old_points: &FxHashMap<FaceKey, FaceWeights>) -> Option<FaceWeights> {
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
            Vertex::Face(f) => {
                if f == face {
                    old_points.get(&f).copied()
                } else {
                    None
                }
            }
        }
    }

    /// Replaces the list of children, keeping those that stay.
    fn replan(&mut self, mesh: &mut TetMesh, plan: &Plan, doomed: &mut Vec<TetId>, vertices: &mut BTreeSet<Vertex>) {
        let corners = self.base.corners(plan.base);
        let tet = mesh.tet(plan.base);
        let mut old = match self.stroke.touched.remove(&plan.base) {
            Some(touched) => touched.children,
            None => {
                mesh.retire_tet(plan.base);
                self.operations.deleted += 1;
                Vec::new()
            }
        };
        vertices.extend(old.iter().flat_map(|c| c.key).filter(|v| self.stroke.is_on_sheet(*v)));
        let keys = subdivide(corners, &plan.faces, &plan.edges);
        let children = keys
            .into_iter()
            .map(|key| match old.iter().position(|c| c.key == key) {
                Some(i) => old.swap_remove(i),
                None => {
                    self.operations.created += 1;
                    Placed { key, nodes: self.unnamed(&key), id: None }
                }
            })
            .collect();
        for gone in old {
            if let Some(id) = gone.id {
                self.operations.deleted += 1;
                doomed.push(id);
            }
        }
        let touched = Touched { corners, tet, faces: plan.faces.clone(), edges: plan.edges.clone(), children };
        self.stroke.touched.insert(plan.base, touched);
    }

    fn unnamed(&self, key: &Child) -> [NodeId; 4] {
        key.map(|v| match v {
            Vertex::Corner(n) if !self.stroke.on_sheet.contains_key(&n) => n,
            _ => UNNAMED,
        })
    }

    /// Puts the children whose nodes are new or changed into the mesh.
    fn place(&mut self, mesh: &mut TetMesh, candidates: &BTreeSet<TetId>, doomed: Vec<TetId>) {
        for id in doomed {
            self.stroke.parent.remove(&id);
            mesh.remove_tet(id);
        }
        let mut concerned: BTreeSet<TetId> = candidates.clone();
        concerned.extend(std::mem::take(&mut self.relabelled));
        for base in concerned {
            let Some(touched) = self.stroke.touched.get_mut(&base) else { continue };
            let mut placed = Vec::new();
            for child in &mut touched.children {
                if child.nodes.contains(&UNNAMED) {
                    continue;
                }
                if let Some(id) = child.id {
                    if mesh.corners(id) == child.nodes {
                        continue;
                    }
                    self.stroke.parent.remove(&id);
                    mesh.remove_tet(id);
                    self.operations.updated += 1;
                }
                let id = mesh.add_tet(child.nodes, touched.tet);
                child.id = Some(id);
                placed.push(id);
            }
            for id in placed {
                self.stroke.parent.insert(id, base);
            }
        }
    }

    /// Area that the stroke in progress has opened, m2: of the marked faces whose two sides have nodes of their own.
    pub(crate) fn stroke_area(&self, mesh: &TetMesh) -> f64 {
        let mut bases: Vec<TetId> = self.stroke.touched.keys().copied().collect();
        bases.sort_unstable();
        let mut faces: BTreeMap<[Vertex; 3], [NodeId; 3]> = BTreeMap::new();
        let mut area = 0.0;
        for base in bases {
            for child in &self.stroke.touched[&base].children {
                for (face, nodes) in child_faces(&child.key, child.nodes) {
                    if !face.iter().all(|v| self.stroke.is_on_sheet(*v)) {
                        continue;
                    }
                    if let Some(other) = faces.remove(&face) {
                        if other != nodes {
                            let [a, b, c] = nodes.map(|n| mesh.rest(n));
                            area += (b - a).cross(c - a).length() / 2.0;
                        }
                    } else {
                        faces.insert(face, nodes);
                    }
                }
            }
        }
        area
    }
}

/// The four faces of a child: vertices in ascending order, with their nodes.
pub(crate) fn child_faces(key: &Child, nodes: [NodeId; 4]) -> [([Vertex; 3], [NodeId; 3]); 4] {
    let mut order = [0, 1, 2, 3];
    order.sort_unstable_by_key(|&i| key[i]);
    [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]].map(|face| {
        let picked = face.map(|i: usize| order[i]);
        (picked.map(|i| key[i]), picked.map(|i| nodes[i]))
    })
}

/// The weights of three points (given as weights themselves) that make `target`; `None` when the three are on a line.
fn solve_weights(points: [FaceWeights; 3], target: FaceWeights) -> Option<[f64; 3]> {
    let area = |p: FaceWeights, q: FaceWeights, r: FaceWeights| (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]);
    let [a, b, c] = points;
    let whole = area(a, b, c);
    (whole != 0.0).then(|| [area(target, b, c) / whole, area(a, target, c) / whole, area(a, b, target) / whole])
}
