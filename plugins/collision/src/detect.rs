//! Nodes in tetrahedra: which node of any body is inside which tetrahedron of another body, or of its own.
//!
//! Spatial hashing as published (see `cells.rs`) has cells of one size, the mean length of the edges. After cuts that length is bimodal and no
//! one size fits: a tetrahedron of the old size meets many cells, or a cell holds many nodes of the new size. The hierarchical form (M. Eitz,
//! L. Gu, "Hierarchical spatial hashing for real-time collision detection", SMI 2007) gives each tetrahedron the level that fits its box; nodes are
//! in the cells of every level that any tetrahedron has, and a tetrahedron looks at its own level's.
//!
//! Everything is built anew in each tick: positions change all over, so that there is nothing to keep. Only [`Shape`] is kept over the ticks.

use crate::cells::{CellTable, LEVELS, Level, Tag, cell_of, level_of};
use crate::inside::Weights;
use crate::shape::{Role, Shape, VACANT};
use bevy_math::{Vec3, Vec3A};
use keyhole_tetmesh::{EDGES, NodeId, TetId, TetMesh};
use rayon::prelude::*;

/// Tetrahedra that one task looks at.
const CHUNK: usize = 2048;

/// A level has a table of its own where it has more queries than a part of the nodes in the table: `nodes / QUERIES_A_NODE`. With 8 instead of 1 a mesh
/// after 20 cuts took a sixth longer: its slivers are on so many levels that the tables cost more than looking at larger cells.
const QUERIES_A_NODE: usize = 1;

/// What detection looks at of one body.
#[derive(Clone, Copy, Debug)]
pub struct Body<'a> {
    /// Its tetrahedra and its surface.
    pub shape: &'a Shape,
    /// Deformed positions by node slot, m.
    pub positions: &'a [Vec3],
    /// Whether its surface's nodes are looked for in its own tetrahedra.
    pub self_collision: bool,
}

/// How large the cells are.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Grading {
    /// Each tetrahedron has cells that fit its box.
    #[default]
    Hierarchical,
    /// All cells have edges of this length, m: [`mean_edge_m`] is the published choice.
    Flat(f32),
}

/// A node in a tetrahedron.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Place of the node's body in the list of bodies.
    pub node_body: u16,
    /// The node.
    pub node: NodeId,
    /// Place of the tetrahedron's body.
    pub tet_body: u16,
    /// The tetrahedron.
    pub tet: TetId,
    /// Weights of its corners at the node; none is negative, and they sum to one.
    pub weights: [f32; 4],
}

impl Hit {
    /// What hits are ordered by.
    #[must_use]
    pub fn key(&self) -> (u16, u16, NodeId, TetId) {
        (self.node_body, self.tet_body, self.node, self.tet)
    }
}

/// Finds nodes in tetrahedra. What it keeps from call to call is room.
#[derive(Clone, Debug, Default)]
pub struct Detector {
    boxes: Vec<Bounds>,
    chunks: Vec<Chunk>,
    points: Vec<Vec3A>,
    tags: Vec<Tag>,
    /// By body: where its nodes begin in the two lists; one more at the end.
    begins: Vec<usize>,
    /// By body and node slot: on which sides of the space that the body shares with others the node is.
    sides: Vec<Vec<u8>>,
    /// By body and level. A table for each body, so that a tetrahedron looks at no nodes of bodies that it cannot meet.
    tables: Vec<CellTable>,
    hits: Vec<Hit>,
    /// Tetrahedra that had to look in the last call.
    looked_into: usize,
}

/// An axis-aligned box, m.
#[derive(Clone, Copy, Debug)]
struct Bounds {
    low: Vec3A,
    high: Vec3A,
}

impl Bounds {
    const EVERYTHING: Self = Self { low: Vec3A::NEG_INFINITY, high: Vec3A::INFINITY };
    const NOTHING: Self = Self { low: Vec3A::INFINITY, high: Vec3A::NEG_INFINITY };

    fn add(&mut self, point: Vec3A) {
        self.low = self.low.min(point);
        self.high = self.high.max(point);
    }

    fn meets(&self, other: &Self) -> bool {
        (self.low.cmple(other.high) & self.high.cmpge(other.low)).all()
    }

    fn contains(&self, point: Vec3A) -> bool {
        (point.cmpge(self.low) & point.cmple(self.high)).all()
    }

    fn shared(&self, other: &Self) -> Self {
        Self { low: self.low.max(other.low), high: self.high.min(other.high) }
    }

    /// A bit for each of the six sides of the box on which a point is beyond it; of a point that is not a number none.
    fn sides(&self, point: Vec3A) -> u8 {
        (point.cmplt(self.low).bitmask() | point.cmpgt(self.high).bitmask() << 3) as u8
    }
}

/// A tetrahedron that has to look.
#[derive(Clone, Copy, Debug)]
struct Query {
    bounds: Bounds,
    tet: u32,
    level: Level,
}

/// A number a level.
#[derive(Clone, Copy, Debug)]
struct Counts([u32; LEVELS]);

impl Default for Counts {
    fn default() -> Self {
        Self([0; LEVELS])
    }
}

/// A run of tetrahedron slots of one body: what one task works on.
#[derive(Clone, Debug, Default)]
struct Chunk {
    body: usize,
    from: usize,
    queries: Vec<Query>,
    /// Queries by level.
    levels: Counts,
    /// Nodes that a query listed.
    found: Vec<u32>,
    hits: Vec<Hit>,
}

impl Detector {
    /// The nodes in tetrahedra, in order of [`Hit::key`]; the same on any number of threads. The corners of a tetrahedron are not in it. A node or
    /// tetrahedron that is not finite is in nothing and has nothing in it.
    ///
    /// # Panics
    /// With more than 65 535 bodies.
    pub fn detect(&mut self, bodies: &[Body], grading: Grading) -> &[Hit] {
        assert!(bodies.len() <= usize::from(u16::MAX), "{} bodies; at most {} are told apart", bodies.len(), u16::MAX);
        self.boxes.clear();
        self.boxes.extend(bodies.iter().map(bounds_of));
        let chunks = self.cut_chunks(bodies);
        self.gather_nodes(bodies);
        let (boxes, sides) = (&self.boxes, &self.sides);
        self.chunks[..chunks].par_iter_mut().for_each(|chunk| chunk.find_boxes(bodies, boxes, sides, grading));
        self.looked_into = self.chunks[..chunks].iter().map(|chunk| chunk.queries.len()).sum();
        let levels = self.serving_levels(chunks);
        let cell = |level: usize| match grading {
            Grading::Hierarchical => cell_of(level as Level),
            Grading::Flat(cell_m) => cell_m,
        };
        let (points, tags, begins) = (&self.points, &self.tags, &self.begins);
        self.tables.resize_with(self.tables.len().max(LEVELS * bodies.len()), CellTable::default);
        let serves = |level: usize| levels.contains(&Some(level as Level));
        let tables = self.tables[..LEVELS * bodies.len()].par_iter_mut().enumerate();
        tables.filter(|(i, _)| serves(i % LEVELS)).for_each(|(i, table)| {
            let nodes = begins[i / LEVELS]..begins[i / LEVELS + 1];
            table.build(cell(i % LEVELS), &points[nodes.clone()], &tags[nodes]);
        });
        let (tables, boxes) = (&self.tables, &self.boxes);
        self.chunks[..chunks].par_iter_mut().for_each(|chunk| chunk.look(&bodies[chunk.body], boxes, tables, &levels));
        self.hits.clear();
        for chunk in &self.chunks[..chunks] {
            self.hits.extend_from_slice(&chunk.hits);
        }
        self.hits.sort_unstable_by_key(Hit::key);
        self.hits.dedup_by_key(|hit| hit.key());
        &self.hits
    }

    /// Tetrahedra of the last call in which a node may have been: the work of a call beside what is in proportion to the nodes.
    #[must_use]
    pub fn looked_into(&self) -> usize {
        self.looked_into
    }

    /// Makes the chunks of all bodies that have anything to look for; returns their number.
    fn cut_chunks(&mut self, bodies: &[Body]) -> usize {
        let mut count = 0;
        for (body, of) in bodies.iter().enumerate() {
            let meets_another = self.boxes.iter().enumerate().any(|(other, b)| other != body && b.meets(&self.boxes[body]));
            if !meets_another && !of.self_collision {
                continue;
            }
            for from in (0..of.shape.corners().len()).step_by(CHUNK) {
                if count == self.chunks.len() {
                    self.chunks.push(Chunk::default());
                }
                self.chunks[count].body = body;
                self.chunks[count].from = from;
                count += 1;
            }
        }
        count
    }

    /// The level whose table serves each level that has queries: its own, or, where its queries are so few that a table of all nodes would cost more
    /// than looking at larger cells, the next coarser one that has queries.
    fn serving_levels(&self, chunks: usize) -> [Option<Level>; LEVELS] {
        let mut counts = [0; LEVELS];
        for chunk in &self.chunks[..chunks] {
            for (sum, count) in counts.iter_mut().zip(&chunk.levels.0) {
                *sum += *count as usize;
            }
        }
        let mut serving = [None; LEVELS];
        // Queries of finer levels that wait for a table.
        let mut waiting = 0;
        let mut waiting_from = 0;
        let coarsest = counts.iter().rposition(|count| *count > 0);
        for level in 0..LEVELS {
            waiting += counts[level];
            if waiting > 0 && (QUERIES_A_NODE * waiting > self.points.len() || Some(level) == coarsest) {
                serving[waiting_from..=level].fill(Some(level as Level));
                (waiting, waiting_from) = (0, level + 1);
            }
        }
        serving
    }

    /// Lists the nodes that may be in a tetrahedron, and on which sides of what bodies share each node is. Those that may be in a tetrahedron are those in another body's box, and those that may be in their own body.
    fn gather_nodes(&mut self, bodies: &[Body]) {
        self.points.clear();
        self.tags.clear();
        self.begins.clear();
        self.sides.resize_with(self.sides.len().max(bodies.len()), Vec::new);
        for (body, of) in bodies.iter().enumerate() {
            self.begins.push(self.points.len());
            // Nobody is in a body without tetrahedra.
            let others = |p: Vec3A| {
                let mut around = self.boxes.iter().enumerate().filter(|(other, b)| *other != body && b.contains(p));
                around.any(|(other, _)| !bodies[other].shape.corners().is_empty())
            };
            let meeting = self.boxes.iter().enumerate().filter(|(other, b)| *other != body && b.meets(&self.boxes[body]));
            let shared =
                meeting.map(|(_, b)| self.boxes[body].shared(b)).reduce(|a, b| Bounds { low: a.low.min(b.low), high: a.high.max(b.high) });
            let sides = &mut self.sides[body];
            sides.clear();
            let space = match (shared, of.self_collision) {
                (None, false) => continue,
                (Some(shared), false) => shared,
                (_, true) => Bounds::EVERYTHING,
            };
            for (node, (position, role)) in of.positions.iter().zip(of.shape.roles()).enumerate() {
                let point = Vec3A::from(*position);
                let side = space.sides(point);
                sides.push(side);
                let own = of.self_collision && *role == Role::Surface;
                if side == 0 && *role != Role::Unused && point.is_finite() && (own || others(point)) {
                    self.points.push(point);
                    self.tags.push(Tag { own, node: node as u32 });
                }
            }
        }
        self.begins.push(self.points.len());
    }
}

impl Chunk {
    /// Lists the tetrahedra of the chunk that may have a node in them, with their boxes and levels.
    fn find_boxes(&mut self, bodies: &[Body], boxes: &[Bounds], sides: &[Vec<u8>], grading: Grading) {
        self.queries.clear();
        self.levels = Counts::default();
        let sides = &sides[self.body];
        let Body { shape, positions, self_collision } = bodies[self.body];
        let corners = shape.corners();
        let others = |b: &Bounds| boxes.iter().enumerate().any(|(other, o)| other != self.body && o.meets(b));
        for (tet, nodes) in corners.iter().enumerate().take(corners.len().min(self.from + CHUNK)).skip(self.from) {
            // A tetrahedron whose corners are all beyond the same side of the space that is shared has nobody in it.
            if *nodes == VACANT || nodes.iter().fold(u8::MAX, |all, n| all & sides[n.index()]) != 0 {
                continue;
            }
            let [a, b, c, d] = nodes.map(|n| Vec3A::from(positions[n.index()]));
            let bounds = Bounds { low: a.min(b).min(c.min(d)), high: a.max(b).max(c.max(d)) };
            // The sum is finite only where every corner is: minima and maxima may pass over one that is not a number.
            if !(a + b + c + d).is_finite() || !(self_collision || others(&bounds)) {
                continue;
            }
            let level = match grading {
                Grading::Hierarchical => level_of((bounds.high - bounds.low).max_element()),
                Grading::Flat(_) => 0,
            };
            self.levels.0[usize::from(level)] += 1;
            self.queries.push(Query { bounds, tet: tet as u32, level });
        }
    }

    /// Finds the nodes in the listed tetrahedra.
    fn look(&mut self, own: &Body, boxes: &[Bounds], tables: &[CellTable], levels: &[Option<Level>; LEVELS]) {
        self.hits.clear();
        let (corners, positions) = (own.shape.corners(), own.positions);
        for Query { bounds, tet, level } in &self.queries {
            let Some(level) = levels[usize::from(*level)] else { continue };
            let nodes = corners[*tet as usize];
            let mut weights = None;
            for (body, of) in boxes.iter().enumerate() {
                let is_own = body == self.body;
                if (is_own && !own.self_collision) || !of.meets(bounds) {
                    continue;
                }
                let table = &tables[body * LEVELS + usize::from(level)];
                for at in table.list_box(bounds.low, bounds.high, &mut self.found) {
                    let (point, tag) = table.node(*at);
                    let node = NodeId(tag.node);
                    if is_own && (!tag.own || nodes.contains(&node)) {
                        continue;
                    }
                    let weights = weights.get_or_insert_with(|| Weights::of(nodes.map(|n| positions[n.index()].into())));
                    let Some(weights) = weights else { break };
                    if let Some(weights) = weights.inside(point) {
                        let [node_body, tet_body] = [body, self.body].map(|b| b as u16);
                        self.hits.push(Hit { node_body, node, tet_body, tet: TetId(*tet), weights });
                    }
                }
            }
        }
    }
}

/// The box around the nodes that are used and finite.
fn bounds_of(body: &Body) -> Bounds {
    let mut bounds = Bounds::NOTHING;
    for (position, role) in body.positions.iter().zip(body.shape.roles()) {
        if *role != Role::Unused && position.is_finite() {
            bounds.add((*position).into());
        }
    }
    bounds
}

/// Mean length of the edges of the tetrahedra of a mesh in the rest shape, m, an edge counted once a tetrahedron; zero without tetrahedra.
#[must_use]
pub fn mean_rest_edge_m(mesh: &TetMesh) -> f32 {
    let (mut sum, mut count) = (0.0, 0_u32);
    for (tet, _) in mesh.iter() {
        let at = mesh.points(tet);
        sum += EDGES.iter().map(|[i, j]| at[*i].distance(at[*j])).sum::<f64>();
        count += 6;
    }
    (sum / f64::from(count.max(1))) as f32
}

/// Mean length of the edges of the tetrahedra of all bodies, m, an edge counted once a tetrahedron: the published size of cells. `None` without
/// tetrahedra.
#[must_use]
pub fn mean_edge_m(bodies: &[Body]) -> Option<f32> {
    let (mut sum, mut count) = (0.0_f64, 0_u32);
    for body in bodies {
        for nodes in body.shape.corners().iter().filter(|nodes| **nodes != VACANT) {
            let at = nodes.map(|n| body.positions[n.index()]);
            sum += EDGES.iter().map(|[i, j]| f64::from(at[*i].distance(at[*j]))).sum::<f64>();
            count += 6;
        }
    }
    (count > 0).then(|| (sum / f64::from(count)) as f32)
}
