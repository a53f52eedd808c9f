//! The cutter of one organ: takes the blade's line step by step, in the rest shape, and edits the mesh.

use crate::grid::RestGrid;
use crate::sheet::{Aabb, Strip, contains, pierce};
use crate::stroke::{Meeting, Stroke, starting_strip};
use keyhole_tetmesh::{DVec3, EDGES, EdgeKey, FaceKey, NodeId, TetId, TetMesh, Topology};
use keyhole_whiteboard::CutSettings;
use rustc_hash::FxHashSet;

/// Operations on tetrahedra, as the paper counts them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Operations {
    /// Tetrahedra removed, of the base mesh or children.
    pub deleted: u64,
    /// Tetrahedra created.
    pub created: u64,
    /// Children changed in place: a face point moved, or a node was replaced by its double on the other side of the cut.
    pub updated: u64,
    /// Events taken back because a tetrahedron would not have been positive.
    pub deferred: u64,
}

impl std::ops::AddAssign for Operations {
    fn add_assign(&mut self, other: Self) {
        self.deleted += other.deleted;
        self.created += other.created;
        self.updated += other.updated;
        self.deferred += other.deferred;
    }
}

/// What one step did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepReport {
    /// Operations of this step.
    pub operations: Operations,
    /// Area that the blade swept inside the tissue in this step, m2.
    pub swept_m2: f64,
}

/// Cuts one organ. Its own memory beside the mesh: the topology as it was before the stroke in progress, and what the stroke knows.
#[derive(Clone, Debug)]
pub struct Cutter {
    pub(crate) base: Topology,
    pub(crate) grid: RestGrid,
    pub(crate) on_surface: Vec<bool>,
    pub(crate) stroke: Stroke,
    pub(crate) settings: CutSettings,
    pub(crate) operations: Operations,
    /// Base tetrahedra of which a child's node was renamed in this step.
    pub(crate) relabelled: std::collections::BTreeSet<TetId>,
    committed_area_m2: f64,
    mean_edge_m: f64,
    has_cut: bool,
}

/// The blade's line is moved off special positions by this part of an edge, by an amount of its own for each point, so that it does
/// not run exactly through nodes of a regular mesh. Far below any length that matters, far above rounding.
const GENERIC: f64 = 1e-7;

impl Cutter {
    /// A cutter for a mesh as it is now. Looks at the whole mesh once.
    #[must_use]
    pub fn new(mesh: &TetMesh) -> Self {
        let base = mesh.topology().clone();
        let on_surface = (0..mesh.node_slots() as u32).map(|i| base.is_boundary_node(NodeId(i))).collect();
        let (mut sum, mut count) = (0.0, 0_u32);
        for (tet, _) in mesh.iter() {
            let p = mesh.points(tet);
            for [i, j] in EDGES {
                sum += p[i].distance(p[j]);
                count += 1;
            }
        }
        let mean_edge_m = if count > 0 { sum / f64::from(count) } else { 0.0 };
        let mut grid = RestGrid::new(mean_edge_m);
        for (tet, _) in mesh.iter() {
            grid.insert(tet, mesh.points(tet));
        }
        Self {
            base,
            grid,
            on_surface,
            stroke: Stroke::default(),
            settings: CutSettings::default(),
            operations: Operations::default(),
            relabelled: std::collections::BTreeSet::new(),
            committed_area_m2: 0.0,
            mean_edge_m,
            has_cut: false,
        }
    }

    /// Mean edge length of the mesh as the cutter met it, m: the scale of steps and of the line's resolution.
    #[must_use]
    pub fn mean_edge_m(&self) -> f64 {
        self.mean_edge_m
    }

    /// Uses other settings from the next stroke on; ignored while a stroke is in progress.
    pub fn set_settings(&mut self, settings: CutSettings) {
        if self.stroke.is_empty() {
            self.settings = settings;
        }
    }

    /// Operations since the cutter was made.
    #[must_use]
    pub fn operations(&self) -> Operations {
        self.operations
    }

    /// Number of points of the line of the stroke in progress.
    #[must_use]
    pub fn line_points(&self) -> Option<usize> {
        (!self.stroke.line.is_empty()).then_some(self.stroke.line.len())
    }

    /// Whether a stroke is in progress: whether children may still change.
    #[must_use]
    pub fn is_cutting(&self) -> bool {
        !self.stroke.is_empty()
    }

    /// The base tetrahedron that a tetrahedron of the mesh is a part of.
    #[must_use]
    pub fn base_of(&self, tet: TetId) -> TetId {
        self.stroke.parent.get(&tet).copied().unwrap_or(tet)
    }

    /// The base tetrahedra that hold points of the rest shape (m), for a blade whose line is given there.
    #[must_use]
    pub fn tets_at(&self, mesh: &TetMesh, points: &[DVec3]) -> Vec<TetId> {
        let mut found: Vec<TetId> = points
            .iter()
            .flat_map(|p| self.grid.near(*p).iter().copied().filter(|t| contains(self.base.corners(*t).map(|n| mesh.rest(n)), *p)))
            .collect();
        found.sort_unstable();
        found.dedup();
        found
    }

    /// Whether a later step may still change this tetrahedron of the mesh.
    #[must_use]
    pub fn is_temporary(&self, tet: TetId) -> bool {
        let Some(base) = self.stroke.parent.get(&tet) else { return false };
        if self.stroke.occupied.contains(base) {
            return true;
        }
        let corners = self.base.corners(*base);
        EDGES.iter().any(|&[i, j]| self.stroke.crossings.get(&EdgeKey::new(corners[i], corners[j])).is_some_and(|c| !c.settled))
    }

    /// Area opened since the cutter was made, m2: one side of the cut.
    #[must_use]
    pub fn opened_m2(&self, mesh: &TetMesh) -> f64 {
        self.committed_area_m2 + self.stroke_area(mesh)
    }

    /// The tetrahedra along the cut of the stroke in progress, ascending.
    #[must_use]
    pub fn children(&self) -> Vec<TetId> {
        let mut ids: Vec<TetId> = self.stroke.parent.keys().copied().collect();
        ids.sort_unstable();
        ids
    }

    /// Points where the present line goes through the outer surface (the base mesh's boundary), rest shape, m.
    #[must_use]
    pub fn surface_points(&self, mesh: &TetMesh) -> Vec<DVec3> {
        let mut faces: Vec<&FaceKey> = self.stroke.front.keys().collect();
        faces.sort_unstable();
        faces
            .into_iter()
            .filter(|f| self.base.around_face(**f).count() == 1)
            .map(|f| {
                let w = self.stroke.front[f];
                let [a, b, c] = f.nodes().map(|n| mesh.rest(n));
                a * w[0] + b * w[1] + c * w[2]
            })
            .collect()
    }

    /// Released points of the sheet on the outer surface, rest shape, m: the visible wound of the stroke in progress.
    #[must_use]
    pub fn wound_points(&self, mesh: &TetMesh) -> Vec<DVec3> {
        let surface_edge = |e: EdgeKey| {
            let [a, b] = e.nodes();
            self.base.around_edge(a, b).any(|t| {
                let c = self.base.corners(t);
                (0..4).any(|f| c[f] != a && c[f] != b && self.base.neighbour(t, f).is_none())
            })
        };
        let mut edges: Vec<EdgeKey> = self.stroke.crossings.keys().copied().collect();
        edges.sort_unstable();
        let mut points: Vec<DVec3> = edges
            .into_iter()
            .filter(|e| self.stroke.released(*e).is_some() && surface_edge(*e))
            .map(|e| self.vertex_rest(mesh, crate::kernel::Vertex::Edge(e)))
            .collect();
        let mut faces: Vec<FaceKey> = self.stroke.face_points.keys().copied().collect();
        faces.sort_unstable();
        points.extend(
            faces
                .into_iter()
                .filter(|f| self.base.around_face(*f).count() == 1)
                .map(|f| self.vertex_rest(mesh, crate::kernel::Vertex::Face(f))),
        );
        points
    }

    /// One step of an active blade: its line now, in the rest shape (m, tip first, the same number of points at each step of a stroke),
    /// and tetrahedra of the mesh that the line or its way here meets, at least one for each connected piece of tissue it meets.
    ///
    /// A step should move the line by less than a quarter of an edge. The changes are in the mesh's delta.
    pub fn advance(&mut self, mesh: &mut TetMesh, line: &[DVec3], seeds: &[TetId]) -> StepReport {
        let line = self.generic(line);
        let before = self.operations;
        let strip = if self.stroke.line.len() == line.len() { Strip::between(&self.stroke.line, &line) } else { starting_strip(&line) };
        let starts = self.stroke.line.len() != line.len();
        if !starts && strip.is_still() {
            return StepReport::default();
        }
        let mut meeting = self.meet(mesh, &strip, seeds);
        if starts {
            let start: Vec<_> = meeting.front.iter().map(|(f, w)| (*f, *w)).collect();
            meeting.border.extend(start);
        }
        let mut candidates: FxHashSet<TetId> = self.stroke.occupied.iter().chain(&meeting.tets).copied().collect();
        self.record_hits(mesh, meeting.hits, &mut candidates);
        self.stroke.border.extend(meeting.border);
        self.stroke.front = meeting.front;
        self.stroke.occupied = meeting.occupied;
        self.stroke.line = line;
        self.lead_past_nodes(mesh, &mut candidates);
        self.settle_and_release(mesh, &mut candidates);
        self.refine(mesh, candidates);
        if self.stroke.occupied.is_empty() && !self.stroke.crossings.is_empty() && self.stroke.unsettled.is_empty() {
            // The blade has left: children become base tetrahedra.
            self.commit(mesh);
        }
        StepReport { operations: self.operations_since(before), swept_m2: meeting.area }
    }

    /// Forgets where the blade was: the next step starts a stroke.
    pub fn forget_line(&mut self) {
        self.stroke.line.clear();
    }

    /// Whether the mesh was cut since the last call: whether there may be new fragments once no stroke is in progress.
    pub fn take_has_cut(&mut self) -> bool {
        std::mem::take(&mut self.has_cut)
    }

    /// Leaves out a tetrahedron that is about to be taken out of the mesh. No stroke may be in progress.
    pub(crate) fn forget(&mut self, mesh: &TetMesh, tet: TetId) {
        self.grid.remove(tet, mesh.points(tet));
        self.base.remove(tet);
    }

    /// Ends the stroke: everything settles, children become base tetrahedra. The changes are in the mesh's delta.
    pub fn end_stroke(&mut self, mesh: &mut TetMesh) -> StepReport {
        let before = self.operations;
        self.commit(mesh);
        self.forget_line();
        StepReport { operations: self.operations_since(before), swept_m2: 0.0 }
    }

    /// Settles and releases everything, then makes the children base tetrahedra.
    fn commit(&mut self, mesh: &mut TetMesh) {
        let mut candidates: FxHashSet<TetId> = self.stroke.occupied.drain().collect();
        candidates.extend(self.stroke.touched.keys().copied());
        // What the present line has reached is where the cut ends if it does not go on.
        let reached: Vec<_> = self.stroke.front.drain().collect();
        self.stroke.border.extend(reached);
        self.lead_past_nodes(mesh, &mut candidates);
        self.settle_and_release(mesh, &mut candidates);
        self.refine(mesh, candidates);
        self.committed_area_m2 += self.stroke_area(mesh);

        let mut bases: Vec<TetId> = self.stroke.touched.keys().copied().collect();
        bases.sort_unstable();
        for base in &bases {
            let points = self.base.corners(*base).map(|n| mesh.rest(n));
            self.grid.remove(*base, points);
            self.base.remove(*base);
        }
        let mut made = Vec::new();
        for base in bases {
            let Some(touched) = self.stroke.touched.remove(&base) else { continue };
            for child in touched.children {
                if let Some(id) = child.id {
                    self.base.insert(id, child.nodes);
                    self.grid.insert(id, mesh.points(id));
                    made.push(id);
                }
            }
            mesh.release_tet(base);
        }
        self.has_cut |= !made.is_empty();
        self.renew_hull(mesh, &made);
        let line = std::mem::take(&mut self.stroke.line);
        self.stroke = Stroke { line, ..Stroke::default() };
    }

    /// Renews surface and hull marks around tetrahedra that were made.
    fn renew_hull(&mut self, mesh: &mut TetMesh, made: &[TetId]) {
        self.on_surface.resize(mesh.node_slots(), false);
        let mut nodes: Vec<NodeId> = made.iter().flat_map(|t| self.base.corners(*t)).collect();
        nodes.sort_unstable();
        nodes.dedup();
        let mut changed = Vec::new();
        for node in nodes {
            let now = self.base.is_boundary_node(node);
            if now != self.on_surface[node.index()] {
                self.on_surface[node.index()] = now;
                changed.push(node);
            }
        }
        for node in changed {
            for &tet in self.base.around_node(node) {
                let hull = self.base.corners(tet).iter().any(|n| self.on_surface[n.index()]);
                mesh.set_hull(tet, hull);
            }
        }
    }

    /// Whether a node lay on the surface when the stroke began.
    pub(crate) fn is_surface_node(&self, node: NodeId) -> bool {
        self.on_surface.get(node.index()).copied().unwrap_or(false)
    }

    /// Everything that a strip meets, walking from the seeds over base tetrahedra.
    fn meet(&self, mesh: &TetMesh, strip: &Strip, seeds: &[TetId]) -> Meeting {
        let mut meeting = Meeting::default();
        let mut queue: Vec<TetId> = Vec::new();
        let mut seen: FxHashSet<TetId> = FxHashSet::default();
        let mut tested: FxHashSet<EdgeKey> = FxHashSet::default();
        let push = |t: TetId, queue: &mut Vec<TetId>, seen: &mut FxHashSet<TetId>| {
            if seen.insert(t) {
                queue.push(t);
            }
        };
        for &seed in seeds {
            push(self.base_of(seed), &mut queue, &mut seen);
        }
        let mut known: Vec<TetId> = self.stroke.occupied.iter().copied().collect();
        known.sort_unstable();
        for tet in known {
            push(tet, &mut queue, &mut seen);
        }
        let (mut near, mut hits) = (Vec::new(), Vec::new());
        let mut next = 0;
        while next < queue.len() {
            let tet = queue[next];
            next += 1;
            if !self.base.contains(tet) {
                continue;
            }
            let corners = self.base.corners(tet);
            let points = corners.map(|n| mesh.rest(n));
            let bounds = Aabb::of(&points);
            strip.near(&bounds, &mut near);
            if near.is_empty() {
                continue;
            }
            let mut meets = false;
            for [i, j] in EDGES {
                let edge = EdgeKey::new(corners[i], corners[j]);
                let crossed = if tested.insert(edge) {
                    let [a, b] = edge.nodes();
                    hits.clear();
                    strip.crossings(mesh.rest(a), mesh.rest(b), &near, &mut hits);
                    meeting.record(edge, &hits);
                    if !hits.is_empty() {
                        for t in self.base.around_edge(a, b) {
                            push(t, &mut queue, &mut seen);
                        }
                    }
                    !hits.is_empty()
                } else {
                    meeting.hits.contains_key(&edge)
                };
                meets |= crossed;
            }
            for face in 0..4 {
                let key = self.base.face_key(tet, face);
                let triangle = key.nodes().map(|n| mesh.rest(n));
                let box_of_face = Aabb::of(&triangle);
                let pierced =
                    strip.segments(&near).any(|[p, q]| Aabb::of(&[p, q]).overlaps(&box_of_face) && pierce(triangle, p, q).is_some());
                if pierced {
                    meets = true;
                    if let Some(other) = self.base.neighbour(tet, face) {
                        push(other, &mut queue, &mut seen);
                    }
                    for pair in strip.now().windows(2) {
                        if let Some(w) = pierce(triangle, pair[0], pair[1]) {
                            meeting.front.insert(key, w);
                            meeting.occupied.insert(tet);
                        }
                    }
                    for [p, q] in strip.ends() {
                        if let Some(w) = pierce(triangle, p, q) {
                            meeting.border.insert(key, w);
                        }
                    }
                }
            }
            if strip.now().iter().any(|p| Aabb::of(&[*p]).overlaps(&bounds) && contains(points, *p)) {
                meeting.occupied.insert(tet);
                meets = true;
            }
            if meets {
                meeting.tets.push(tet);
                meeting.area += strip.area_inside(points, &near);
            }
        }
        meeting
    }

    /// The line moved off special positions.
    fn generic(&self, line: &[DVec3]) -> Vec<DVec3> {
        let size = self.mean_edge_m * GENERIC;
        line.iter()
            .enumerate()
            .map(|(i, p)| {
                let i = i as f64 + 1.0;
                *p + DVec3::new((i * 12.9898).sin(), (i * 78.233).sin(), (i * 37.719).sin()) * size
            })
            .collect()
    }

    fn operations_since(&self, before: Operations) -> Operations {
        Operations {
            deleted: self.operations.deleted - before.deleted,
            created: self.operations.created - before.created,
            updated: self.operations.updated - before.updated,
            deferred: self.operations.deferred - before.deferred,
        }
    }
}
