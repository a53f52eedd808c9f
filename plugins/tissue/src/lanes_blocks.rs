//! Elements in lanes of eight for position-based dynamics: parts of some hundred elements, in each of which eight elements without a common node are
//! solved at once, on a copy of the part's nodes that stays in the nearest cache.
//!
//! With `e_i` the edges from node 0 and `g_ij = grad N_i . grad N_j`, what both neo-Hookean constraints need takes no deformation gradient:
//! `D_i = sum_j g_ij e_j` is the gradient of `|F|^2 / 2` by node `i`, `|F|^2 = sum e_i . D_i`; `H_i` is the gradient of `det F`, a cross product of two edges by six rest
//! volumes. The 2x2 block (Ton-That, Kry, Andrews 2022) is solved with `H` less its part along `D`: a sum of squares where a determinant would
//! be a difference, for at rest the two gradients are parallel.

mod vectors;

use crate::colouring::Colouring;
use crate::element::Element;
use crate::lanes::{Eight, Kernel, LANES, Lane, NEAR, Nodes, at, index, put};
use crate::lanes_parts::Parts;
use crate::motion::Shared;
use crate::xpbd::Constraints;
use keyhole_tetmesh::{EDGES, NodeId, TetMesh, TopologyDelta};
use vectors::*;

/// Elements of a part that are about right: its nodes stay in the nearest cache, and a few thousand elements have work for two threads.
const TARGET: usize = 640;

/// How much more an inverted element yields to pressure. Pressure makes needles of inverted elements, which stay: of 24 beams scrambled at random 14 came back
/// to rest with 20 substeps and 7 with 60 where the yield was the same; of 16 with three times the yield, 14 and 8.
const INVERTED: f32 = 3.0;

/// Eight elements without a common node.
#[derive(Clone, Debug, PartialEq)]
struct Batch {
    /// Neo-Hookean: `g_ij` by rows of the upper triangle (1/m2), `1 / 6V` (1/m3), `1 / (mu V)` (1/J), `mu / lambda`. Springs: the rest lengths in the order of
    /// [`EDGES`] (m), `1 / 6V`, the compliances of the strains of length and of volume (1/J).
    rows: [Eight; 9],
    /// Corners, as [`index`]es of places in the part.
    nodes: [[u16; LANES]; 4],
}

/// A part as it is solved.
#[derive(Clone, Debug, Default)]
struct Pack {
    /// Node slots, from place 1 on: place 0 is nowhere, for lanes without an element.
    nodes: Vec<u32>,
    batches: Vec<Batch>,
}

/// All elements of an organ.
#[derive(Clone, Debug, Default)]
pub(crate) struct Blocks {
    constraints: Constraints,
    parts: Parts,
    packs: Vec<Pack>,
}

impl Blocks {
    /// The elements of a body. Those of one colour come one after the other, so that lanes are full.
    pub(crate) fn new(elements: &[Element], colouring: &Colouring, constraints: Constraints) -> Self {
        let all: Vec<u32> = (0..elements.len() as u32).filter(|t| !elements[*t as usize].is_empty()).collect();
        let incidence = Incidence::of(elements, &all);
        let around = |tet: u32, near: &mut Vec<u32>| {
            for node in elements[tet as usize].nodes {
                near.extend_from_slice(incidence.around(node));
            }
        };
        let mut blocks = Self { constraints, parts: Parts::new(&all, TARGET, &around), packs: Vec::new() };
        let every: Vec<usize> = (0..blocks.parts.len()).collect();
        blocks.pack(every, elements, colouring, &around);
        blocks
    }

    /// The constraints that it was made for.
    pub(crate) fn constraints(&self) -> Constraints {
        self.constraints
    }

    /// Carries it over a topology change; elements, colours and mesh are those after it.
    pub(crate) fn adopt(&mut self, mesh: &TetMesh, elements: &[Element], colouring: &Colouring, delta: &TopologyDelta) {
        let around = |tet: u32, near: &mut Vec<u32>| {
            for node in elements[tet as usize].nodes {
                near.extend(mesh.topology().around_node(NodeId(node)).iter().map(|t| t.0));
            }
        };
        let gone: Vec<u32> = delta.removed.iter().map(|t| t.0).collect();
        let come: Vec<u32> = delta.added.iter().map(|a| a.tet.0).collect();
        let reshaped: Vec<u32> = delta.reshaped(mesh.topology()).iter().map(|t| t.0).collect();
        let touched = self.parts.adopt(&gone, &come, &reshaped, &around);
        self.pack(touched, elements, colouring, &around);
    }

    /// Packs these parts anew, in lanes.
    fn pack(&mut self, mut wanted: Vec<usize>, elements: &[Element], colouring: &Colouring, around: &impl Fn(u32, &mut Vec<u32>)) {
        while let Some(part) = wanted.pop() {
            self.packs.resize_with(self.parts.len().max(self.packs.len()), Pack::default);
            match Pack::of(self.parts.items(part), elements, colouring, self.constraints) {
                Some(pack) => self.packs[part] = pack,
                None => {
                    // More nodes than a kernel can have at hand: elements that hardly hang together.
                    let more = self.parts.cut(part, self.parts.items(part).len() / 2, around);
                    self.parts.recolour(part, around);
                    for part in &more {
                        self.parts.recolour(*part, around);
                    }
                    wanted.push(part);
                    wanted.extend(more);
                }
            }
        }
        self.packs.resize_with(self.parts.len(), Pack::default);
    }

    /// Number of colours of the parts.
    pub(crate) fn colours(&self) -> usize {
        self.parts.colours().len()
    }

    /// Number of parts of a colour.
    pub(crate) fn parts(&self, colour: usize) -> usize {
        self.parts.colours()[colour].len()
    }

    /// Solves the elements of the `i`th part of a colour once, for a substep of `h` s.
    pub(crate) fn solve(&self, colour: usize, i: usize, h: f32, shared: &Shared, near: &mut Nodes) {
        let pack = &self.packs[self.parts.colours()[colour][i] as usize];
        crate::lanes::run(Sweep { pack, constraints: self.constraints, inverse_h2: 1.0 / (h * h), shared, near });
    }
}

/// The elements around each node.
struct Incidence {
    starts: Vec<u32>,
    tets: Vec<u32>,
}

impl Incidence {
    fn of(elements: &[Element], all: &[u32]) -> Self {
        let nodes = all.iter().flat_map(|t| elements[*t as usize].nodes).max().map_or(0, |n| n as usize + 1);
        let mut starts = vec![0_u32; nodes + 2];
        let corners = || all.iter().flat_map(|t| elements[*t as usize].nodes.map(|n| (n as usize, *t)));
        corners().for_each(|(n, _)| starts[n + 2] += 1);
        for n in 2..starts.len() {
            starts[n] += starts[n - 1];
        }
        let mut tets = vec![0; 4 * all.len()];
        for (n, t) in corners() {
            tets[starts[n + 1] as usize] = t;
            starts[n + 1] += 1;
        }
        Self { starts, tets }
    }

    fn around(&self, node: u32) -> &[u32] {
        &self.tets[self.starts[node as usize] as usize..self.starts[node as usize + 1] as usize]
    }
}

/// Batches of a part at most.
const BATCHES: usize = 512;

impl Pack {
    /// A part in lanes: every element goes to the first batch that has room and none of its nodes. Nothing when it has more nodes than [`NEAR`] less one.
    fn of(items: &[u32], elements: &[Element], colouring: &Colouring, constraints: Constraints) -> Option<Self> {
        let mut nodes: Vec<u32> = items.iter().flat_map(|t| elements[*t as usize].nodes).collect();
        nodes.sort_unstable();
        nodes.dedup();
        if nodes.len() >= NEAR || items.len() > LANES * BATCHES / 2 {
            return None;
        }
        let mut order: Vec<u32> = items.to_vec();
        order.sort_unstable_by_key(|t| (colouring.of(*t), *t));
        let mut used = vec![[0_u64; BATCHES / 64]; nodes.len() + 1];
        let mut full = [0_u64; BATCHES / 64];
        let mut taken: Vec<usize> = Vec::new();
        let mut batches: Vec<Batch> = Vec::new();
        for tet in order {
            let element = &elements[tet as usize];
            let at = element.nodes.map(|n| nodes.partition_point(|m| *m < n) + 1);
            let busy = |w: usize| at.iter().fold(full[w], |b, n| b | used[*n][w]);
            let word = (0..full.len()).find(|w| busy(*w) != u64::MAX)?;
            let batch = 64 * word + busy(word).trailing_ones() as usize;
            if batch == batches.len() {
                batches.push(Batch::vacant(constraints));
                taken.push(0);
            }
            batches[batch].set(taken[batch], element, at.map(index), constraints);
            taken[batch] += 1;
            if taken[batch] == LANES {
                full[word] |= 1 << (batch % 64);
            }
            for n in at {
                used[n][word] |= 1 << (batch % 64);
            }
        }
        Some(Self { nodes, batches })
    }
}

impl Batch {
    /// Lanes that move nothing.
    fn vacant(constraints: Constraints) -> Self {
        let mut rows = [Eight::default(); 9];
        match constraints {
            Constraints::NeoHookean => (rows[7], rows[8]) = (Eight([1.0; LANES]), Eight([1.0; LANES])),
            Constraints::DistanceVolume => (rows[7], rows[8]) = (Eight([1.0; LANES]), Eight([f32::INFINITY; LANES])),
        }
        Self { rows, nodes: [[0; LANES]; 4] }
    }

    fn set(&mut self, lane: usize, element: &Element, at: [u16; 4], constraints: Constraints) {
        for (row, value) in self.rows.iter_mut().zip(constants(element, constraints)) {
            row.0[lane] = value as f32;
        }
        for (nodes, n) in self.nodes.iter_mut().zip(at) {
            nodes[lane] = n;
        }
    }
}

/// What a lane needs of an element: see [`Batch::rows`].
fn constants(element: &Element, constraints: Constraints) -> [f64; 9] {
    let (mu, lambda, volume) = (f64::from(element.material.mu), f64::from(element.material.lambda), f64::from(element.volume));
    let sixth = 1.0 / (6.0 * volume);
    match constraints {
        Constraints::NeoHookean => {
            let rows = element.inverse_rest.as_dmat3().transpose();
            let (a, b, c) = (rows.x_axis, rows.y_axis, rows.z_axis);
            [a.dot(a), a.dot(b), a.dot(c), b.dot(b), b.dot(c), c.dot(c), sixth, 1.0 / (mu * volume), mu / lambda]
        }
        Constraints::DistanceVolume => {
            let rest = element.inverse_rest.as_dmat3().inverse();
            let corner = [bevy_math::DVec3::ZERO, rest.x_axis, rest.y_axis, rest.z_axis];
            let [a, b, c, d, e, f] = EDGES.map(|[i, j]| corner[i].distance(corner[j]));
            let bulk = lambda - mu / 3.0;
            let stiffness = (bulk - 5.0 * mu / 3.0) * volume;
            // Below Poisson's ratio 1/4 the springs are all there is.
            let soft = if stiffness > 0.0 { 1.0 / stiffness } else { f64::INFINITY };
            [a, b, c, d, e, f, sixth, 6.0 / (15.0 * mu * volume), soft]
        }
    }
}

/// All batches of a part, once.
struct Sweep<'a> {
    pack: &'a Pack,
    constraints: Constraints,
    inverse_h2: f32,
    shared: &'a Shared,
    near: &'a mut Nodes,
}

impl Kernel for Sweep<'_> {
    #[inline(always)]
    fn run<L: Lane>(self, token: L::Token) {
        let Self { pack, constraints, inverse_h2, shared, near } = self;
        put(near, 0, [0.0; 4]);
        for (place, node) in pack.nodes.iter().enumerate() {
            put(near, index(place + 1), shared.get(*node as usize));
        }
        let inverse_h2 = L::splat(token, inverse_h2);
        match constraints {
            Constraints::NeoHookean => {
                let inverted = L::splat(token, INVERTED);
                for batch in &pack.batches {
                    neo_hookean::<L>(token, batch, inverse_h2, inverted, near);
                }
            }
            Constraints::DistanceVolume => {
                for batch in &pack.batches {
                    springs::<L>(token, batch, inverse_h2, near);
                }
            }
        }
        for (place, node) in pack.nodes.iter().enumerate() {
            shared.set(*node as usize, at(near, index(place + 1)));
        }
    }
}

#[inline(always)]
fn gather<L: Lane>(token: L::Token, batch: &Batch, near: &Nodes) -> [[L; 4]; 4] {
    [
        L::gather(token, near, &batch.nodes[0]),
        L::gather(token, near, &batch.nodes[1]),
        L::gather(token, near, &batch.nodes[2]),
        L::gather(token, near, &batch.nodes[3]),
    ]
}

#[inline(always)]
fn scatter<L: Lane>(batch: &Batch, x: [Vector<L>; 4], w: [L; 4], near: &mut Nodes) {
    L::scatter([x[0][0], x[0][1], x[0][2], w[0]], near, &batch.nodes[0]);
    L::scatter([x[1][0], x[1][1], x[1][2], w[1]], near, &batch.nodes[1]);
    L::scatter([x[2][0], x[2][1], x[2][2], w[2]], near, &batch.nodes[2]);
    L::scatter([x[3][0], x[3][1], x[3][2], w[3]], near, &batch.nodes[3]);
}

/// Gradients of the determinant by nodes 1, 2 and 3.
#[inline(always)]
fn hydrostatic<L: Lane>(e: [Vector<L>; 3], sixth: L) -> [Vector<L>; 3] {
    [times(cross(e[1], e[2]), sixth), times(cross(e[2], e[0]), sixth), times(cross(e[0], e[1]), sixth)]
}

#[inline(always)]
fn neo_hookean<L: Lane>(token: L::Token, batch: &Batch, inverse_h2: L, inverted: L, near: &mut Nodes) {
    let rows = &batch.rows;
    let x = gather::<L>(token, batch, near);
    let w = [x[0][3], x[1][3], x[2][3], x[3][3]];
    let e = [minus(x[1], x[0]), minus(x[2], x[0]), minus(x[3], x[0])];
    let (aa, ab, ac) = (L::load(token, &rows[0]), L::load(token, &rows[1]), L::load(token, &rows[2]));
    let (bb, bc, cc) = (L::load(token, &rows[3]), L::load(token, &rows[4]), L::load(token, &rows[5]));
    // At node 0 the gradients are minus the sums; signs are minded where nodes move.
    let da = along(e[0], aa, along(e[1], ab, times(e[2], ac)));
    let db = along(e[0], ab, along(e[1], bb, times(e[2], bc)));
    let dc = along(e[0], ac, along(e[1], bc, times(e[2], cc)));
    let d = [sum(da, sum(db, dc)), da, db, dc];
    let squares = dot(e[0], da) + dot(e[1], db) + dot(e[2], dc);
    let [ga, gb, gc] = hydrostatic(e, L::load(token, &rows[6]));
    let g = [sum(ga, sum(gb, gc)), ga, gb, gc];
    let ratio = dot(e[0], ga);
    let (dd, dg) = (weighted(w, d, d), weighted(w, d, g));
    // Compliances: `|F|` has its gradient `D / |F|`, so what it yields by is multiplied by `|F|^2`.
    let soft = L::load(token, &rows[7]) * inverse_h2;
    let yields = soft * squares;
    // Nothing but a collapsed element has 0 here, and then there is nothing to divide.
    let one = L::splat(token, 1.0);
    let inverse = one.over((dd + yields).max(L::splat(token, f32::MIN_POSITIVE)));
    let t = dg * inverse;
    let r = [less(d[0], t, g[0]), less(d[1], t, g[1]), less(d[2], t, g[2]), less(d[3], t, g[3])];
    let stretch = L::load(token, &rows[8]);
    let give = stretch * soft * (inverted + (one - inverted).where_positive(ratio));
    let schur = give + (t * t).mul_add(yields, weighted(w, r, r));
    let lh = t.mul_add(squares, one + stretch - ratio).over(schur);
    let ld = squares * inverse;
    let new = [
        less(less(d[0], ld, times(r[0], lh)), w[0], place(x[0])),
        along(less(d[1], ld, times(r[1], lh)), w[1], place(x[1])),
        along(less(d[2], ld, times(r[2], lh)), w[2], place(x[2])),
        along(less(d[3], ld, times(r[3], lh)), w[3], place(x[3])),
    ];
    scatter(batch, new, w, near);
}

/// The six edges one after the other, then the volume.
#[inline(always)]
fn springs<L: Lane>(token: L::Token, batch: &Batch, inverse_h2: L, near: &mut Nodes) {
    let rows = &batch.rows;
    let x = gather::<L>(token, batch, near);
    let w = [x[0][3], x[1][3], x[2][3], x[3][3]];
    let mut x = [place(x[0]), place(x[1]), place(x[2]), place(x[3])];
    let soft = L::load(token, &rows[7]) * inverse_h2;
    for k in 0..6 {
        let [i, j] = EDGES[k];
        let length = L::load(token, &rows[k]);
        let way = apart(x[j], x[i]);
        let now = dot(way, way).sqrt();
        let weight = (soft * length).mul_add(length, w[i] + w[j]) * now;
        let step = times(way, (length - now).over(weight).where_positive(now));
        x[i] = less(step, w[i], x[i]);
        x[j] = along(step, w[j], x[j]);
    }
    let e = [apart(x[1], x[0]), apart(x[2], x[0]), apart(x[3], x[0])];
    let [ga, gb, gc] = hydrostatic(e, L::load(token, &rows[6]));
    let g = [sum(ga, sum(gb, gc)), ga, gb, gc];
    let step = (L::splat(token, 1.0) - dot(e[0], ga)).over(weighted(w, g, g) + L::load(token, &rows[8]) * inverse_h2);
    let new =
        [less(g[0], step * w[0], x[0]), along(g[1], step * w[1], x[1]), along(g[2], step * w[2], x[2]), along(g[3], step * w[3], x[3])];
    scatter(batch, new, w, near);
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests;
