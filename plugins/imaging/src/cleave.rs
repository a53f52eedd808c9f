//! The border of a part within an organ as faces of the mesh: every tetrahedron ends up on one side of it.
//!
//! The lattice is cut once more, by the field of the part, and both sides are kept: nodes near a crossing move onto it, the other crossed
//! edges are cut, and the stencils of isosurface stuffing fill each side (Labelle and Shewchuk 2007; keeping both sides of a
//! surface is the two-material case of J. Bronson, J. Levine, R. Whitaker, "Lattice Cleaving", IMR 2012). Far from the organ's surface the
//! nodes are those of the lattice and the proved bound holds on both sides, with the parity rule turned over on the outer one: so the two
//! stencils of a tetrahedron agree on the diagonal of the quadrilateral between them.
//!
//! Near the organ's surface tetrahedra are no lattice tetrahedra any more. There a cut that would leave an angle outside
//! [`PROVED_DEGREES`] is taken back: a node at it counts as lying on the border without being moved. The border is then off by part of a
//! cell at that node, which the report tells, and every angle stays inside the bounds whatever the field is.

use crate::stencil::{self, Vertex};
use crate::stuffing::{ALPHA_LONG, ALPHA_SHORT, PROVED_DEGREES, root};
use crate::topology;
use glam::DVec3;
use keyhole_tetmesh::quality;
use rustc_hash::{FxHashMap, FxHashSet};
use std::collections::BTreeSet;

/// On edges that are no lattice edges a node moves when the crossing is closer than this part of the edge.
const ALPHA_OTHER: f64 = 0.3;
/// The corners of a tetrahedron's edges.
const EDGES: [[usize; 2]; 6] = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];

/// Tetrahedra with materials, on their way through the parts.
#[derive(Clone, Debug, Default)]
pub struct Parted {
    /// Nodes.
    pub nodes: Vec<DVec3>,
    /// Positive tetrahedra.
    pub tets: Vec<[u32; 4]>,
    /// Material of each.
    pub materials: Vec<u16>,
    /// Twice the lattice coordinates, in cells, of nodes that are points of the lattice.
    pub lattice: Vec<Option<[i32; 3]>>,
    /// Nodes that count as lying on a border without having been moved there.
    pub pinned: usize,
}

/// Gives `material` to the region where `field` is positive and cuts the mesh along its border.
pub fn cleave(mesh: &mut Parted, field: &(dyn Fn(DVec3) -> f64 + Sync), material: u16) {
    let values: Vec<f64> = mesh.nodes.iter().map(|p| field(*p)).collect();
    let job = Job::new(mesh, field, values);
    let mut pinned: BTreeSet<u32> = BTreeSet::new();
    loop {
        let cut = job.attempt(&pinned);
        if cut.blame.is_empty() {
            let side = |s: i8, old: u16| if s > 0 { material } else { old };
            let materials = cut.tets.iter().map(|(_, from, s)| side(*s, mesh.materials[*from as usize])).collect();
            let tets = cut.tets.iter().map(|(t, ..)| *t).collect();
            let mut lattice = mesh.lattice.clone();
            lattice.resize(cut.nodes.len(), None);
            *mesh = Parted { nodes: cut.nodes, tets, materials, lattice, pinned: mesh.pinned + pinned.len() };
            return;
        }
        // Every node blamed was cut or moved, so it was not pinned: each round pins more, and a mesh whose nodes are all pinned is whole.
        pinned.extend(cut.blame);
    }
}

/// What stays the same from attempt to attempt.
struct Job<'a> {
    mesh: &'a Parted,
    field: &'a (dyn Fn(DVec3) -> f64 + Sync),
    values: Vec<f64>,
    /// Crossing of each edge whose ends (inside, outside) lie on different sides, as part of the way.
    crossings: FxHashMap<(u32, u32), f64>,
    /// Crossed edges in the order of the nodes, each from both of its ends.
    around: Vec<(u32, u32)>,
    /// Tetrahedra at each node: those of node n are `at[first[n]..first[n + 1]]`.
    first: Vec<u32>,
    at: Vec<u32>,
    on_surface: Vec<bool>,
    surface_edges: FxHashSet<(u32, u32)>,
}

/// A cut mesh, and the nodes to be pinned before the next attempt.
struct Attempt {
    nodes: Vec<DVec3>,
    /// Nodes, the tetrahedron it was cut from, its side.
    tets: Vec<([u32; 4], u32, i8)>,
    blame: BTreeSet<u32>,
}

impl<'a> Job<'a> {
    fn new(mesh: &'a Parted, field: &'a (dyn Fn(DVec3) -> f64 + Sync), values: Vec<f64>) -> Self {
        let mut crossings = FxHashMap::default();
        let mut around = Vec::new();
        let mut first = vec![0; mesh.nodes.len() + 1];
        for t in &mesh.tets {
            for n in t {
                first[*n as usize + 1] += 1;
            }
            for [i, j] in EDGES {
                let (p, q) = if values[t[i] as usize] > values[t[j] as usize] { (t[i], t[j]) } else { (t[j], t[i]) };
                let (vp, vq) = (values[p as usize], values[q as usize]);
                if vp > 0.0 && vq < 0.0 && !crossings.contains_key(&(p, q)) {
                    let (a, b) = (mesh.nodes[p as usize], mesh.nodes[q as usize]);
                    crossings.insert((p, q), root(|s| field(a.lerp(b, s)), vp, vq));
                    around.extend([(p, q), (q, p)]);
                }
            }
        }
        around.sort_unstable();
        for i in 1..first.len() {
            first[i] += first[i - 1];
        }
        let mut slot = first.clone();
        let mut at = vec![0; mesh.tets.len() * 4];
        for (i, t) in mesh.tets.iter().enumerate() {
            for n in t {
                at[slot[*n as usize] as usize] = i as u32;
                slot[*n as usize] += 1;
            }
        }
        let (mut on_surface, mut surface_edges) = (vec![false; mesh.nodes.len()], FxHashSet::default());
        for f in topology::boundary(&mesh.tets) {
            for k in 0..3 {
                on_surface[f[k] as usize] = true;
                surface_edges.insert(pair(f[k], f[(k + 1) % 3]));
            }
        }
        Self { mesh, field, values, crossings, around, first, at, on_surface, surface_edges }
    }

    fn star(&self, n: u32) -> &[u32] {
        &self.at[self.first[n as usize] as usize..self.first[n as usize + 1] as usize]
    }

    /// Moves, cuts and fills with these nodes pinned.
    fn attempt(&self, pinned: &BTreeSet<u32>) -> Attempt {
        let mut signs: Vec<i8> = self.values.iter().map(|v| i8::from(*v > 0.0) - i8::from(*v < 0.0)).collect();
        pinned.iter().for_each(|n| signs[*n as usize] = 0);
        let mut nodes = self.mesh.nodes.clone();
        self.warp(&mut signs, &mut nodes);
        let mut out = Attempt { nodes, tets: Vec::with_capacity(self.mesh.tets.len() * 5 / 4), blame: BTreeSet::new() };
        let mut node_of_cut: FxHashMap<(u32, u32), u32> = FxHashMap::default();
        for (index, tet) in self.mesh.tets.iter().enumerate() {
            self.fill(index as u32, *tet, &signs, &mut node_of_cut, &mut out);
        }
        out
    }

    /// Nodes near a crossing move onto it where that keeps the angles around them; those on the organ's surface only along it.
    fn warp(&self, signs: &mut [i8], nodes: &mut [DVec3]) {
        let mut i = 0;
        while i < self.around.len() {
            let p = self.around[i].0;
            let mut end = i;
            let mut best: Option<(f64, DVec3)> = None;
            while end < self.around.len() && self.around[end].0 == p {
                let n = self.around[end].1;
                end += 1;
                if signs[p as usize] * signs[n as usize] >= 0 || (self.on_surface[p as usize] && !self.surface_edges.contains(&pair(p, n)))
                {
                    continue;
                }
                let t = if signs[p as usize] > 0 { self.crossings[&(p, n)] } else { 1.0 - self.crossings[&(n, p)] };
                let (a, b) = (self.mesh.nodes[p as usize], self.mesh.nodes[n as usize]);
                let alpha = match self.kind(p, n) {
                    Kind::Long => ALPHA_LONG,
                    Kind::Short => ALPHA_SHORT,
                    Kind::Other => ALPHA_OTHER,
                };
                let length = t * a.distance(b);
                if t < alpha && best.is_none_or(|(d, _)| length < d) {
                    best = Some((length, a.lerp(b, t)));
                }
            }
            if let Some((_, to)) = best {
                let from = std::mem::replace(&mut nodes[p as usize], to);
                if self.star(p).iter().all(|t| sound(self.mesh.tets[*t as usize].map(|n| nodes[n as usize]))) {
                    signs[p as usize] = 0;
                } else {
                    nodes[p as usize] = from;
                }
            }
            i = end;
        }
    }

    /// One tetrahedron: whole, or each of its sides by the stencils.
    fn fill(&self, index: u32, tet: [u32; 4], signs: &[i8], node_of_cut: &mut FxHashMap<(u32, u32), u32>, out: &mut Attempt) {
        let s = tet.map(|n| signs[n as usize]);
        let (any_in, any_out) = (s.contains(&1), s.contains(&-1));
        if !(any_in && any_out) {
            let at = tet.map(|n| out.nodes[n as usize]);
            let side = match (any_in, any_out) {
                (true, _) => 1,
                (_, true) => -1,
                _ => i8::from((self.field)((at[0] + at[1] + at[2] + at[3]) / 4.0) > 0.0) * 2 - 1,
            };
            if !sound(at) {
                // Only moves can have spoiled it: the mesh was sound before.
                out.blame.extend(tet.iter().copied().filter(|n| out.nodes[*n as usize] != self.mesh.nodes[*n as usize]));
            }
            out.tets.push((tet, index, side));
            return;
        }
        let Some(level) = self.between(tet, s) else {
            out.blame.insert(self.nearest_to_cut(tet, s));
            return;
        };
        let mut spoilt = false;
        for side in [1, -1] {
            let of_side = s.map(|v| v * side);
            let diagonal = |p: usize, q: usize, n: usize| self.diagonal_from_first(tet, p, q, n, side);
            stencil::keep(of_side, diagonal, level[usize::from(side < 0)], |kept| {
                let mut corners = kept.map(|v| match v {
                    Vertex::Corner(c) => tet[c],
                    Vertex::Cut(a, b) => {
                        let (p, n) = if s[a] > 0 { (tet[a], tet[b]) } else { (tet[b], tet[a]) };
                        *node_of_cut.entry((p, n)).or_insert_with(|| {
                            // An end that has moved lies on the border and has no crossing: these two are where they were.
                            let (a, b) = (out.nodes[p as usize], out.nodes[n as usize]);
                            out.nodes.push(a.lerp(b, self.crossings[&(p, n)]));
                            out.nodes.len() as u32 - 1
                        })
                    }
                });
                let at = |c: [u32; 4]| c.map(|n| out.nodes[n as usize]);
                if quality::volume(at(corners)) < 0.0 {
                    corners.swap(2, 3);
                }
                spoilt |= !sound(at(corners));
                out.tets.push((corners, index, side));
            });
        }
        if spoilt {
            out.blame.insert(self.nearest_to_cut(tet, s));
        }
    }

    /// For a tetrahedron with two corners on each side: which diagonal the quadrilateral between the sides has, told to each side's
    /// stencil in its own terms. `None` when the faces leave no diagonal that both sides can have.
    fn between(&self, tet: [u32; 4], s: [i8; 4]) -> Option<[Option<bool>; 2]> {
        let of = |side: i8| {
            let mut found = (0..4).filter(|i| s[*i] == side);
            (found.next(), found.next(), found.next())
        };
        let ((Some(p), Some(q), None), (Some(m), Some(n), None)) = (of(1), of(-1)) else {
            // One or three corners on a side: a prism of three columns may be cyclic.
            for side in [1, -1] {
                if let (Some(p), Some(q), Some(r)) = of(side)
                    && let (Some(n), ..) = of(-side)
                {
                    let d = |a, b| self.diagonal_from_first(tet, a, b, n, side);
                    if d(p, q) == d(q, r) && d(q, r) == d(r, p) {
                        return None;
                    }
                }
            }
            return Some([None, None]);
        };
        // Whether it joins the cut points of p-m and q-n; `None` when a side does not care.
        let wish = |first: bool, second: bool| (first != second).then_some(second);
        let inner = wish(self.diagonal_from_first(tet, p, q, m, 1), self.diagonal_from_first(tet, p, q, n, 1));
        let outer = wish(self.diagonal_from_first(tet, m, n, p, -1), self.diagonal_from_first(tet, m, n, q, -1));
        match (inner, outer) {
            (Some(a), Some(b)) if a != b => None,
            (a, b) => {
                let joins = a.or(b).unwrap_or(true);
                Some([Some(joins); 2])
            }
        }
    }

    /// The end of a crossed edge of a tetrahedron that is nearest to its crossing.
    fn nearest_to_cut(&self, tet: [u32; 4], s: [i8; 4]) -> u32 {
        let mut best = (f64::INFINITY, tet[0]);
        for (i, j) in (0..4).flat_map(|i| (0..4).map(move |j| (i, j))) {
            if s[i] > 0 && s[j] < 0 {
                let t = self.crossings[&(tet[i], tet[j])];
                let length = self.mesh.nodes[tet[i] as usize].distance(self.mesh.nodes[tet[j] as usize]);
                for (d, n) in [(t * length, tet[i]), ((1.0 - t) * length, tet[j])] {
                    if d < best.0 || (d == best.0 && n < best.1) {
                        best = (d, n);
                    }
                }
            }
        }
        best.1
    }

    /// As in stuffing for faces of the lattice; otherwise the diagonal starts at the node that comes first in the mesh.
    fn diagonal_from_first(&self, tet: [u32; 4], p: usize, q: usize, n: usize, side: i8) -> bool {
        let [p, q, n] = [tet[p], tet[q], tet[n]];
        match [self.kind(p, q), self.kind(q, n), self.kind(p, n)] {
            [_, Kind::Long, Kind::Short] => true,
            [_, Kind::Short, Kind::Long] => false,
            [Kind::Long, Kind::Short, Kind::Short] => {
                let (Some(dp), Some(dn)) = (self.mesh.lattice[p as usize], self.mesh.lattice[n as usize]) else { return p < q };
                let even = (0..3).filter(|a| dn[*a] < dp[*a]).count() % 2 == 0;
                even == (side > 0)
            }
            _ => p < q,
        }
    }

    /// What kind of edge two nodes span.
    fn kind(&self, p: u32, q: u32) -> Kind {
        let (Some(a), Some(b)) = (self.mesh.lattice[p as usize], self.mesh.lattice[q as usize]) else { return Kind::Other };
        let mut d: [i32; 3] = std::array::from_fn(|k| (a[k] - b[k]).abs());
        d.sort_unstable();
        match d {
            [0, 0, 2] => Kind::Long,
            [1, 1, 1] => Kind::Short,
            _ => Kind::Other,
        }
    }
}

/// Kinds of edges.
enum Kind {
    /// Of the lattice, between two corners or two centres.
    Long,
    /// Of the lattice, between a corner and a centre.
    Short,
    /// Any other.
    Other,
}

/// Whether a tetrahedron is positive with its angles inside the bounds.
fn sound(p: [DVec3; 4]) -> bool {
    if quality::volume(p) <= 0.0 {
        return false;
    }
    let angles = quality::dihedral_angles(p);
    angles.iter().all(|a| (PROVED_DEGREES[0]..=PROVED_DEGREES[1]).contains(&a.to_degrees()))
}

fn pair(a: u32, b: u32) -> (u32, u32) {
    (a.min(b), a.max(b))
}
