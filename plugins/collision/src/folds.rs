//! A body against itself: nodes of its surface in its own tetrahedra.
//!
//! What [`crate::Detector`] finds when a body looks at itself, node by node the same, but with a memory: patches that have kept their shape cannot
//! have come into themselves (see `calm.rs`), and what comes into a patch from elsewhere is in the box around it. In tissue at rest or moved
//! about as a whole that leaves a walk over the nodes of patches at the surface.

use crate::calm::Calm;
use crate::cells::{CellTable, Tag, cell_of, level_of};
use crate::detect::Hit;
use crate::inside::Weights;
use crate::patches::{Patch, Patches};
use crate::shape::{Role, Shape};
use bevy_math::{Vec3, Vec3A};
use keyhole_tetmesh::{NodeId, TetId, TetMesh, TopologyDelta};
use rayon::prelude::*;
use smallvec::SmallVec;

/// Of all patches those that are looked at anew in one tick: one of so many. It bounds what a tick costs in which all of a body is shaken.
const RENEWED: usize = 32;

/// Patches that one task looks at.
const TOGETHER: usize = 16;

/// A node with its position, m.
type Placed = (Vec3A, NodeId);

/// Finds the nodes of a body's surface in its own tetrahedra, tick by tick.
#[derive(Clone, Debug)]
pub struct Folds {
    patches: Patches,
    states: Vec<State>,
    points: Vec<Vec3A>,
    tags: Vec<Tag>,
    table: CellTable,
    hits: Vec<Hit>,
    /// The patch at which the next look begins.
    next: usize,
}

/// What is kept of a patch.
#[derive(Clone, Debug, Default)]
struct State {
    calm: Calm,
    version: u32,
    low: Vec3A,
    high: Vec3A,
    found: Vec<u32>,
    hits: Vec<(NodeId, TetId, [f32; 4])>,
    restless: bool,
    renew: bool,
}

impl Folds {
    /// For a mesh and its shape.
    #[must_use]
    pub fn of(mesh: &TetMesh, shape: &Shape) -> Self {
        let patches = Patches::of(mesh, shape);
        Self { patches, states: Vec::new(), points: Vec::new(), tags: Vec::new(), table: CellTable::default(), hits: Vec::new(), next: 0 }
    }

    /// Carries it over `delta`; `mesh` and `shape` are those after it, `touched` the nodes that [`Shape::update`] gave back.
    pub fn update(&mut self, mesh: &TetMesh, shape: &Shape, delta: &TopologyDelta, touched: &[NodeId]) {
        self.patches.update(mesh, shape, delta, touched);
    }

    /// The nodes of the surface in tetrahedra, in order of [`Hit::key`], as those of the body with the place `body`; `positions` (m) by node slot. The
    /// same on any number of threads, and whatever was looked at before.
    pub fn detect(&mut self, shape: &Shape, positions: &[Vec3], body: u16) -> &[Hit] {
        let patches = self.patches.list();
        self.states.resize_with(patches.len(), State::default);
        self.points.clear();
        self.tags.clear();
        for (node, (position, role)) in positions.iter().zip(shape.roles()).enumerate() {
            if *role == Role::Surface && position.is_finite() {
                self.points.push((*position).into());
                self.tags.push(Tag { own: true, node: node as u32 });
            }
        }
        let each = self.states.par_iter_mut().zip(patches).with_min_len(TOGETHER);
        each.for_each(|(state, patch)| state.bound(patch, positions));
        // Half as long as a patch is on average.
        let extents = self.states.iter().map(|s| (s.high - s.low).max_element()).filter(|e| e.is_finite() && *e >= 0.0);
        let (sum, count) = extents.fold((0.0, 0), |(sum, count), e| (sum + e, count + 1));
        self.table.build(cell_of(level_of(0.5 * sum / (count as f32).max(1.0))), &self.points, &self.tags);
        let table = &self.table;
        let each = self.states.par_iter_mut().zip(patches).with_min_len(TOGETHER);
        each.for_each(|(state, patch)| state.look(patch, shape, positions, table));
        self.renew(shape, positions);
        self.hits.clear();
        for state in &self.states {
            let hit = |(node, tet, weights): &(NodeId, TetId, [f32; 4])| Hit {
                node_body: body,
                node: *node,
                tet_body: body,
                tet: *tet,
                weights: *weights,
            };
            self.hits.extend(state.hits.iter().map(hit));
        }
        self.hits.sort_unstable_by_key(Hit::key);
        self.hits.dedup_by_key(|hit| hit.key());
        &self.hits
    }

    /// Looks anew at some of the patches that have not kept their shape, each in its turn.
    fn renew(&mut self, shape: &Shape, positions: &[Vec3]) {
        let count = self.states.len();
        let mut left = count.div_ceil(RENEWED);
        for at in (self.next..count).chain(0..self.next.min(count)) {
            if left == 0 {
                break;
            }
            if self.states[at].restless {
                self.states[at].renew = true;
                self.next = at + 1;
                left -= 1;
            }
        }
        let each = self.states.par_iter_mut().zip(self.patches.list()).with_min_len(TOGETHER);
        each.filter(|(state, _)| state.renew).for_each(|(state, patch)| {
            state.renew = false;
            state.calm.renew(patch, shape, positions);
        });
    }

    /// Patches that had to be looked at tetrahedron by tetrahedron, of all; in the last tick.
    #[must_use]
    pub fn restless(&self) -> (usize, usize) {
        (self.states.iter().filter(|s| s.restless).count(), self.states.len())
    }

    /// Memory that is kept, bytes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        let patch = |p: &Patch| size_of::<Patch>() + 4 * (p.tets.capacity() + p.nodes.capacity() + p.near.capacity());
        let state = |s: &State| size_of::<State>() + s.calm.bytes() + 4 * s.found.capacity() + 24 * s.hits.capacity();
        self.patches.list().iter().map(patch).sum::<usize>() + self.states.iter().map(state).sum::<usize>()
    }
}

impl State {
    /// The box around the patch's finite nodes.
    fn bound(&mut self, patch: &Patch, positions: &[Vec3]) {
        (self.low, self.high) = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
        for node in &patch.nodes {
            let at = Vec3A::from(positions[node.index()]);
            if at.is_finite() {
                self.low = self.low.min(at);
                self.high = self.high.max(at);
            }
        }
    }

    /// Finds the nodes in the patch's tetrahedra.
    fn look(&mut self, patch: &Patch, shape: &Shape, positions: &[Vec3], table: &CellTable) {
        self.hits.clear();
        self.restless = false;
        if self.version != patch.version {
            self.version = patch.version;
            self.calm.forget();
        }
        if !self.low.cmple(self.high).all() {
            return;
        }
        if !patch.near.is_empty() {
            self.restless = !self.calm.holds(patch, positions);
            let all = 0..patch.tets.len() as u32;
            let near: SmallVec<[Placed; 256]> = if self.restless || !self.calm.watched.is_empty() {
                // Many lie beside the patch: what is not in the box around it is in none of its tetrahedra.
                let surface = patch.near.iter().filter(|n| shape.role(**n) == Role::Surface);
                let placed = surface.map(|n| (Vec3A::from(positions[n.index()]), *n));
                placed.filter(|(at, _)| (at.cmpge(self.low) & at.cmple(self.high)).all()).collect()
            } else {
                SmallVec::new()
            };
            if self.restless {
                all.for_each(|i| test(patch.tets[i as usize], &near, shape, positions, &mut self.hits));
            } else {
                self.calm.watched.iter().for_each(|i| test(patch.tets[*i as usize], &near, shape, positions, &mut self.hits));
            }
        }
        let mut visitors: SmallVec<[Placed; 256]> = SmallVec::new();
        for at in table.list_box(self.low, self.high, &mut self.found) {
            let (point, tag) = table.node(*at);
            if patch.near.binary_search(&NodeId(tag.node)).is_err() {
                visitors.push((point, NodeId(tag.node)));
            }
        }
        if !visitors.is_empty() {
            patch.tets.iter().for_each(|tet| test(*tet, &visitors, shape, positions, &mut self.hits));
        }
    }
}

/// Which of these nodes are in the tetrahedron.
fn test(tet: TetId, nodes: &[Placed], shape: &Shape, positions: &[Vec3], hits: &mut Vec<(NodeId, TetId, [f32; 4])>) {
    let corners = shape.corners()[tet.index()];
    let at = corners.map(|n| Vec3A::from(positions[n.index()]));
    let [a, b, c, d] = at;
    let (low, high) = (a.min(b).min(c.min(d)), a.max(b).max(c.max(d)));
    let mut weights = None;
    for (point, node) in nodes {
        if !(point.cmpge(low) & point.cmple(high)).all() || corners.contains(node) {
            continue;
        }
        let weights = weights.get_or_insert_with(|| Weights::of(at));
        let Some(weights) = weights else { return };
        if let Some(weights) = weights.inside(*point) {
            hits.push((*node, tet, weights));
        }
    }
}
