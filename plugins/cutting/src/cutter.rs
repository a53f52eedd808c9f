//! The cutter of one organ: takes the blade's line step by step, in the rest shape, and edits the mesh.

use crate::before::Before;
use crate::course::{BladeId, Course};
use crate::grid::RestGrid;
use crate::meet::Search;
use crate::sheet::{Aabb, contains};
use crate::stroke::{Placed, Stroke};
use keyhole_tetmesh::{DVec3, EDGES, EdgeKey, FaceKey, NodeId, TetId, TetMesh};
use keyhole_whiteboard::CutSettings;

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

impl Operations {
    /// Those since an earlier count.
    pub(crate) fn since(self, before: Self) -> Self {
        Self {
            deleted: self.deleted - before.deleted,
            created: self.created - before.created,
            updated: self.updated - before.updated,
            deferred: self.deferred - before.deferred,
        }
    }
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

/// Cuts one organ.
#[derive(Clone, Debug)]
pub struct Cutter {
    pub(crate) before: Before,
    pub(crate) grid: RestGrid,
    pub(crate) on_surface: Vec<bool>,
    /// By node: whether an earlier stroke has made it a node of its cut.
    pub(crate) on_wound: Vec<bool>,
    /// The blades that cut or have cut.
    pub(crate) courses: Vec<Course>,
    pub(crate) stroke: Stroke,
    pub(crate) settings: CutSettings,
    pub(crate) operations: Operations,
    /// Lists of children to use again.
    pub(crate) spare: Vec<Vec<Placed>>,
    /// Room for a search to use again.
    pub(crate) search: Search,
    pub(crate) removed_m3: f64,
    pub(crate) committed_area_m2: f64,
    mean_edge_m: f64,
    longest_edge_m: f64,
    landmarks: Vec<NodeId>,
    pub(crate) has_cut: bool,
}

impl Cutter {
    /// A cutter for a mesh as it is now. Looks at the whole mesh once.
    #[must_use]
    pub fn new(mesh: &TetMesh) -> Self {
        let on_surface: Vec<bool> = (0..mesh.node_slots() as u32).map(|i| mesh.topology().is_boundary_node(NodeId(i))).collect();
        let (mut sum, mut count, mut longest_edge_m) = (0.0, 0_u32, 0.0_f64);
        for (tet, _) in mesh.iter() {
            let p = mesh.points(tet);
            for [i, j] in EDGES {
                let length = p[i].distance(p[j]);
                sum += length;
                count += 1;
                longest_edge_m = longest_edge_m.max(length);
            }
        }
        let mean_edge_m = if count > 0 { sum / f64::from(count) } else { 0.0 };
        let mut grid = RestGrid::new(mean_edge_m);
        for (tet, _) in mesh.iter() {
            grid.insert(tet, mesh.points(tet));
        }
        let mut before = Before::default();
        before.grow(mesh.tet_slots());
        Self {
            before,
            grid,
            on_wound: vec![false; on_surface.len()],
            on_surface,
            courses: Vec::new(),
            stroke: Stroke::default(),
            settings: CutSettings::default(),
            operations: Operations::default(),
            spare: Vec::new(),
            search: Search::default(),
            removed_m3: 0.0,
            committed_area_m2: 0.0,
            mean_edge_m,
            longest_edge_m,
            landmarks: landmarks(mesh),
            has_cut: false,
        }
    }

    /// Mean edge length of the mesh as the cutter met it, m: the scale of steps and of the line's resolution.
    #[must_use]
    pub fn mean_edge_m(&self) -> f64 {
        self.mean_edge_m
    }

    /// The longest edge of the mesh as the cutter met it, m: no point of the tissue is further from a node.
    pub(crate) fn longest_edge_m(&self) -> f64 {
        self.longest_edge_m
    }

    /// A few nodes far apart from each other, from which searches begin; some may have left the mesh.
    pub(crate) fn landmarks(&self) -> &[NodeId] {
        &self.landmarks
    }

    /// Tetrahedra of the mesh near a point of the rest shape (m).
    pub(crate) fn tets_near(&self, point: DVec3) -> impl Iterator<Item = TetId> + '_ {
        self.grid.near(point).iter().flat_map(|base| {
            let touched = self.before.place(*base).map(|p| &self.stroke.touched[p]);
            let whole = touched.is_none().then_some(*base);
            whole.into_iter().chain(touched.into_iter().flat_map(|t| t.children.iter().filter_map(|c| c.id)))
        })
    }

    /// Uses other settings from the next stroke on; ignored while a stroke is in progress.
    pub fn set_settings(&mut self, settings: CutSettings) {
        if self.stroke.is_empty() {
            self.settings = settings;
        }
    }

    /// Lets a blade take away this thickness of tissue (m) along its cut when the stroke ends; 0 for a cold one.
    pub fn set_kerf(&mut self, blade: BladeId, kerf_m: f64) {
        let course = self.course(blade);
        self.courses[course].kerf_m = kerf_m;
    }

    /// The place of a blade among those known.
    pub(crate) fn course(&mut self, blade: BladeId) -> usize {
        self.courses.iter().position(|c| c.blade == blade).unwrap_or_else(|| {
            self.courses.push(Course::of(blade));
            self.courses.len() - 1
        })
    }

    /// Rest volume that was taken away since the cutter was made, m3.
    #[must_use]
    pub fn removed_m3(&self) -> f64 {
        self.removed_m3
    }

    /// Operations since the cutter was made.
    #[must_use]
    pub fn operations(&self) -> Operations {
        self.operations
    }

    /// Number of points of a blade's line when it is in the middle of a stroke.
    #[must_use]
    pub fn line_points(&self, blade: BladeId) -> Option<usize> {
        self.courses.iter().find(|c| c.blade == blade && !c.line.is_empty()).map(|c| c.line.len())
    }

    /// Whether a stroke is in progress: whether children may still change.
    #[must_use]
    pub fn is_cutting(&self) -> bool {
        !self.stroke.is_empty()
    }

    /// A base tetrahedron that holds a point of the rest shape (m).
    #[must_use]
    pub fn tet_at(&self, mesh: &TetMesh, point: DVec3) -> Option<TetId> {
        self.grid.near(point).iter().copied().find(|t| self.holds(mesh, *t, point))
    }

    fn holds(&self, mesh: &TetMesh, base: TetId, p: DVec3) -> bool {
        let corners = self.before.corners(mesh.topology(), base).map(|n| mesh.rest(n));
        Aabb::of(&corners).holds(p) && contains(corners, p)
    }

    /// Whether a later step may still change this tetrahedron of the mesh.
    #[must_use]
    pub fn is_temporary(&self, tet: TetId) -> bool {
        let Some(base) = self.before.parent(tet) else { return false };
        if self.is_occupied(base) {
            return true;
        }
        let Some(place) = self.before.place(base) else { return false };
        let corners = self.before.place_corners(place);
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
        let mut ids: Vec<TetId> = self.stroke.touched.iter().flat_map(|t| &t.children).filter_map(|c| c.id).collect();
        ids.sort_unstable();
        ids
    }

    /// Points where the present lines go through the outer surface (the base mesh's boundary), rest shape, m.
    #[must_use]
    pub fn surface_points(&self, mesh: &TetMesh) -> Vec<DVec3> {
        let mut front: Vec<_> = self.courses.iter().flat_map(|c| &c.front).collect();
        front.sort_unstable_by_key(|f| f.0);
        front
            .into_iter()
            .filter(|(f, _)| self.before.around_face(mesh.topology(), **f).count() == 1)
            .map(|(f, w)| {
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
            self.before.around_edge(mesh.topology(), a, b).any(|t| {
                let c = self.before.corners(mesh.topology(), t);
                let on_edge = |f: &usize| c[*f] != a && c[*f] != b;
                (0..4)
                    .filter(on_edge)
                    .any(|f| self.before.around_face(mesh.topology(), self.before.face_key(mesh.topology(), t, f)).count() == 1)
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
                .filter(|f| self.before.around_face(mesh.topology(), *f).count() == 1)
                .map(|f| self.vertex_rest(mesh, crate::kernel::Vertex::Face(f))),
        );
        points
    }

    /// Whether the mesh was cut since the last call: whether there may be new fragments once no stroke is in progress.
    pub fn take_has_cut(&mut self) -> bool {
        std::mem::take(&mut self.has_cut)
    }

    /// Leaves out a tetrahedron that is about to be taken out of the mesh. No stroke may be in progress.
    pub(crate) fn forget(&mut self, mesh: &TetMesh, tet: TetId) {
        self.grid.remove(tet, mesh.points(tet));
    }

    /// Whether a node lay on the surface when the stroke began.
    pub(crate) fn is_surface_node(&self, node: NodeId) -> bool {
        self.on_surface.get(node.index()).copied().unwrap_or(false)
    }
}

/// Up to 64 nodes, each as far as can be from those before it (Gonzalez 1985), so that from any place a walk to the nearest node is short.
fn landmarks(mesh: &TetMesh) -> Vec<NodeId> {
    let nodes: Vec<NodeId> = mesh.nodes().filter(|n| mesh.topology().is_boundary_node(*n)).collect();
    let mut nearest = vec![f64::INFINITY; nodes.len()];
    let mut chosen = Vec::new();
    let mut next = 0;
    while chosen.len() < nodes.len().min(64) {
        chosen.push(nodes[next]);
        let at = mesh.rest(nodes[next]);
        for (d, n) in nearest.iter_mut().zip(&nodes) {
            *d = d.min(mesh.rest(*n).distance_squared(at));
        }
        next = (0..nodes.len()).fold(0, |m, i| if nearest[i] > nearest[m] { i } else { m });
    }
    chosen
}
