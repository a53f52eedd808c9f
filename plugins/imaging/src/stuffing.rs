//! Isosurface stuffing: tetrahedra with proved dihedral angles inside the zero level of a field.
//!
//! F. Labelle, J. R. Shewchuk, "Isosurface Stuffing: Fast Tetrahedral Meshes with Good Dihedral Angles", SIGGRAPH 2007. Lattice points
//! close to a cut point move onto it, the other edges are cut, and a stencil keeps what is inside. With the parity rule every dihedral angle lies in
//! [10.7, 164.8] degrees, as theirs do, whatever the field is and wherever the points go that move: the thresholds are not theirs but the pair for
//! which that holds (`stuffing_bound.rs` goes through all stencils; with 0.24999 and 0.41189 it finds 9.3 degrees, and so did a field).
//!
//! The core may be coarser ([`Stuffer::with_core`]).
//!
//! Added to the paper: a point on the surface where two sheets meet is not moved, so that the boundary is a closed 2-manifold; cavities that
//! the lattice closed are opened again where the wall is thinnest, and filled where it is thick; bodies that only the lattice tore off are
//! dropped and counted.

use crate::graded::Leaves;
use crate::lattice::{Lattice, Point};
use crate::passage;
use crate::stencil::{self, Vertex};
use crate::topology;
use glam::DVec3;
use rayon::prelude::*;
use rustc_hash::{FxHashMap, FxHashSet};
use std::collections::BTreeMap;

/// A long edge's end moves when the cut point is closer than this part of the edge.
pub const ALPHA_LONG: f64 = 0.284;
/// The same for short edges.
pub const ALPHA_SHORT: f64 = 0.398;
/// The interval of dihedral angles, degrees: Labelle and Shewchuk's (2007, table 1) to the digits published.
pub const PROVED_DEGREES: [f64; 2] = [10.7, 164.8];
/// Part of an edge that a passage takes at its own end.
const PASSAGE: f64 = 0.42;
/// Rounds of putting pinched points back. Each round fixes at least one point; scans need one or two.
const ROUNDS: usize = 64;
/// Steps of the search for a cut point: the Illinois method gains more than a digit a step.
const CUT_STEPS: usize = 12;

/// The field of a body: positive inside, in any unit that grows with distance.
pub type Field<'f> = &'f (dyn Fn(DVec3) -> f64 + Sync);

/// Which of several separate bodies are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Keep {
    /// The one with the largest volume.
    Largest,
    /// All.
    All,
}

/// Tetrahedra in the frame of the field.
#[derive(Clone, Debug, Default)]
pub struct Stuffed {
    /// Nodes.
    pub nodes: Vec<DVec3>,
    /// Positive tetrahedra.
    pub tets: Vec<[u32; 4]>,
    /// Twice the coordinates in the lattice, in cells, of nodes that are points of it.
    pub lattice: Vec<Option<[i32; 3]>>,
    /// Volume of separate bodies that were dropped.
    pub dropped_volume: f64,
    /// Volume of enclosed voids that were filled.
    pub filled_volume: f64,
    /// Cavities that the lattice had closed and that were opened again.
    pub opened: usize,
    /// Lattice points that were not moved to the surface because two sheets would have met there.
    pub unpinched: usize,
    /// Where those are, and where cavities were opened or filled: walls and gaps that the lattice hardly resolves.
    pub narrow: Vec<DVec3>,
}

/// What becomes of cavities that the lattice closed.
#[derive(Clone, Copy, PartialEq)]
enum Voids {
    Open,
    Fill,
}

/// Signs of the lattice points, and those that stay where they are.
struct Signs {
    signs: Vec<i8>,
    settled: BTreeMap<Point, i8>,
    opened: usize,
    filled: usize,
}

/// Why a field could not be stuffed.
#[derive(Clone, Debug, PartialEq)]
pub enum Unstuffed {
    /// No lattice point is inside.
    Nothing,
    /// The boundary is still pinched here.
    Pinched(DVec3),
    /// The body reaches the edge of the lattice here: the box is too small.
    Open(DVec3),
}

/// A field sampled once on a lattice, to be stuffed at several levels.
pub struct Stuffer<'f> {
    field: Field<'f>,
    lattice: Lattice,
    values: Vec<f64>,
    /// Doublings of the cell in the core, and what tells the sides of surfaces within the body apart.
    core: Option<(u8, Classes<'f>)>,
}

/// A number for each point within a body that differs on the two sides of every surface in it.
pub type Classes<'f> = &'f (dyn Fn(DVec3) -> u32 + Sync);

impl<'f> Stuffer<'f> {
    /// Samples a field on a lattice of cells of size `a` around the box, which must hold the body with a cell to spare.
    #[must_use]
    pub fn new(field: Field<'f>, min: DVec3, max: DVec3, a: f64) -> Self {
        let lattice = Lattice::around(min, max, a);
        let values = (0..lattice.len() as Point).into_par_iter().map(|p| field(lattice.position(p))).collect();
        Self { field, lattice, values, core: None }
    }

    /// Lets the cells double up to `levels` times away from the surface and from where `classes` differ.
    #[must_use]
    pub fn with_core(mut self, levels: u8, classes: Classes<'f>) -> Self {
        self.core = (levels > 0).then_some((levels, classes));
        self
    }

    /// Fills the region where `field + level` is positive.
    ///
    /// # Errors
    /// When the lattice does not resolve the region.
    pub fn stuff(&self, level: f64, keep: Keep) -> Result<Stuffed, Unstuffed> {
        match self.stuff_with(level, keep, Voids::Open) {
            // A passage that pinches the surface elsewhere does more harm than a filled cavity.
            Err(Unstuffed::Pinched(_)) => self.stuff_with(level, keep, Voids::Fill),
            done => done,
        }
    }

    fn stuff_with(&self, level: f64, keep: Keep, voids: Voids) -> Result<Stuffed, Unstuffed> {
        let Signs { signs, mut settled, opened, filled } = self.signs(level, voids)?;
        let mut unpinched = 0;
        // A lattice point stands for half a cell.
        let filled_volume = filled as f64 * self.lattice.a.powi(3) / 2.0;
        for _ in 0..ROUNDS {
            let raw = self.cut_and_warp(level, signs.clone(), &settled);
            let (levels, classes): (u8, Classes) = self.core.unwrap_or((0, &|_| 0));
            let inside = |p: Point| raw.signs[p as usize] > 0 && !raw.moved.contains_key(&p);
            let leaves = Leaves::new(&self.lattice, levels, inside, |p| classes(self.lattice.position(p)));
            let (mut mesh, points) = raw.into_mesh(&self.lattice, &leaves);
            let points = drop_small(&mut mesh, points, keep);
            let pinched = topology::pinched(&mesh.nodes, &mesh.tets);
            if pinched.is_empty() {
                mesh.unpinched = unpinched;
                mesh.filled_volume = filled_volume;
                mesh.opened = opened;
                mesh.narrow = settled.keys().map(|p| self.lattice.position(*p)).collect();
                mesh.lattice = points.iter().map(|p| p.map(|p| self.lattice.doubled(p))).collect();
                return if mesh.tets.is_empty() { Err(Unstuffed::Nothing) } else { Ok(mesh) };
            }
            let before = settled.len();
            let mut place = DVec3::ZERO;
            for node in pinched {
                place = mesh.nodes[node as usize];
                if let Some(point) = points[node as usize] {
                    settled.entry(point).or_insert(if self.values[point as usize] + level >= 0.0 { 1 } else { -1 });
                }
            }
            unpinched += settled.len() - before;
            if settled.len() == before {
                return Err(Unstuffed::Pinched(place));
            }
        }
        Err(Unstuffed::Pinched(self.lattice.origin))
    }

    /// The signs of the lattice points; cavities are opened or filled, and the points that does it with are settled: they stay where they
    /// are.
    fn signs(&self, level: f64, voids: Voids) -> Result<Signs, Unstuffed> {
        let mut signs: Vec<i8> = self.values.iter().map(|v| sign(v + level)).collect();
        if signs.iter().all(|s| *s <= 0) {
            return Err(Unstuffed::Nothing);
        }
        let mut reached = vec![false; signs.len()];
        let mut stack = Vec::new();
        for p in 0..signs.len() as Point {
            if self.lattice.neighbours(p).count() < 14 {
                if signs[p as usize] >= 0 {
                    return Err(Unstuffed::Open(self.lattice.position(p)));
                }
                reached[p as usize] = true;
                stack.push(p);
            }
        }
        self.flood(&signs, &mut reached, stack);
        let mut out = Signs { signs: Vec::new(), settled: BTreeMap::new(), opened: 0, filled: 0 };
        for p in 0..signs.len() {
            if signs[p] >= 0 || reached[p] {
                continue;
            }
            let mut void = vec![p as Point];
            let mut seen: FxHashSet<Point> = void.iter().copied().collect();
            let mut next = 0;
            while next < void.len() {
                let near: Vec<Point> = self.lattice.neighbours(void[next]).map(|(n, _)| n).filter(|n| signs[*n as usize] < 0).collect();
                void.extend(near.into_iter().filter(|n| seen.insert(*n)));
                next += 1;
            }
            let passage = match voids {
                Voids::Open => passage::through_wall(&self.lattice, &void, &reached, |p| (self.field)(p) + level),
                Voids::Fill => None,
            };
            if let Some(wall) = passage {
                for p in wall {
                    signs[p as usize] = -1;
                    reached[p as usize] = true;
                    out.settled.insert(p, -1);
                }
                void.iter().for_each(|p| reached[*p as usize] = true);
                self.flood(&signs, &mut reached, void);
                out.opened += 1;
            } else {
                out.filled += void.len();
                for p in void {
                    signs[p as usize] = 1;
                    out.settled.insert(p, 1);
                }
            }
        }
        out.signs = signs;
        Ok(out)
    }

    /// Marks all outside points that hang together with those of the stack.
    fn flood(&self, signs: &[i8], reached: &mut [bool], mut stack: Vec<Point>) {
        while let Some(p) = stack.pop() {
            for (n, _) in self.lattice.neighbours(p) {
                if signs[n as usize] < 0 && !reached[n as usize] {
                    reached[n as usize] = true;
                    stack.push(n);
                }
            }
        }
    }

    fn cut_and_warp(&self, level: f64, mut signs: Vec<i8>, settled: &BTreeMap<Point, i8>) -> Cut {
        for (p, s) in settled {
            signs[*p as usize] = *s;
        }
        let lattice = &self.lattice;
        let edges: Vec<(Point, Point)> = (0..lattice.len() as Point)
            .into_par_iter()
            .filter(|p| signs[*p as usize] > 0)
            .flat_map_iter(|p| lattice.neighbours(p).filter(|(n, _)| signs[*n as usize] < 0).map(move |(n, _)| (p, n)))
            .collect();
        // Part of the way from the inside to the outside end.
        let cuts: Vec<f64> = edges
            .par_iter()
            .map(|&(p, n)| {
                if settled.get(&n) == Some(&-1) && !settled.contains_key(&p) {
                    // A passage is no wider than it must be for its points not to be drawn onto the surface.
                    return 1.0 - PASSAGE;
                }
                if settled.contains_key(&p) || settled.contains_key(&n) {
                    return 0.5;
                }
                let ends = [(p, lattice.position(p)), (n, lattice.position(n))];
                let [vp, vn] = [p, n].map(|e| self.values[e as usize] + level);
                root(|t| (self.field)(ends[0].1.lerp(ends[1].1, t)) + level, vp, vn)
            })
            .collect();
        let index: FxHashMap<(Point, Point), u32> = edges.iter().enumerate().map(|(i, e)| (*e, i as u32)).collect();

        let mut moved: FxHashMap<Point, DVec3> = FxHashMap::default();
        let mut ends: Vec<Point> = edges.iter().flat_map(|(p, n)| [*p, *n]).collect();
        ends.sort_unstable();
        ends.dedup();
        for &p in &ends {
            let mut nearest: Option<(f64, DVec3)> = None;
            for (n, long) in lattice.neighbours(p) {
                if signs[n as usize] * signs[p as usize] >= 0 {
                    continue;
                }
                let inside = signs[p as usize] > 0;
                // Every edge between opposite signs has been listed, and signs only ever turn to zero since.
                let Some(&i) = index.get(&if inside { (p, n) } else { (n, p) }) else { continue };
                let t = if inside { cuts[i as usize] } else { 1.0 - cuts[i as usize] };
                let (alpha, length) = if long { (ALPHA_LONG, 1.0) } else { (ALPHA_SHORT, 0.75_f64.sqrt()) };
                if t < alpha && nearest.is_none_or(|(d, _)| t * length < d) {
                    nearest = Some((t * length, lattice.position(p).lerp(lattice.position(n), t)));
                }
            }
            if let Some((_, to)) = nearest {
                moved.insert(p, to);
                signs[p as usize] = 0;
            }
        }
        Cut { signs, index, edges, cuts, moved }
    }
}

/// A warped lattice with its remaining cut points.
struct Cut {
    signs: Vec<i8>,
    index: FxHashMap<(Point, Point), u32>,
    edges: Vec<(Point, Point)>,
    cuts: Vec<f64>,
    moved: FxHashMap<Point, DVec3>,
}

impl Cut {
    /// The kept tetrahedra, and the lattice point of each node that is one.
    fn into_mesh(self, lattice: &Lattice, leaves: &Leaves) -> (Stuffed, Vec<Option<Point>>) {
        let mut mesh = Stuffed::default();
        let mut points = Vec::new();
        let mut node_of_point: Vec<u32> = vec![u32::MAX; self.signs.len()];
        let mut node_of_cut: Vec<u32> = vec![u32::MAX; self.edges.len()];
        for tet in lattice.tets(|cell| leaves.is_fine(cell)).chain(leaves.tets(lattice)) {
            let signs = tet.map(|p| self.signs[p as usize]);
            if signs.iter().all(|s| *s <= 0) {
                continue;
            }
            let diagonal = |p: usize, q: usize, n: usize| diagonal_from_first(lattice, tet, p, q, n);
            stencil::keep(signs, diagonal, None, |kept| {
                let mut nodes = kept.map(|v| {
                    let (slot, point) = match v {
                        Vertex::Corner(c) => (&mut node_of_point[tet[c] as usize], Some(tet[c])),
                        Vertex::Cut(p, n) => (&mut node_of_cut[self.index[&(tet[p], tet[n])] as usize], None),
                    };
                    if *slot == u32::MAX {
                        *slot = mesh.nodes.len() as u32;
                        points.push(point);
                        mesh.nodes.push(match v {
                            Vertex::Corner(c) => self.moved.get(&tet[c]).copied().unwrap_or_else(|| lattice.position(tet[c])),
                            Vertex::Cut(p, n) => {
                                let t = self.cuts[self.index[&(tet[p], tet[n])] as usize];
                                lattice.position(tet[p]).lerp(lattice.position(tet[n]), t)
                            }
                        });
                    }
                    *slot
                });
                if keyhole_tetmesh::quality::volume(nodes.map(|n| mesh.nodes[n as usize])) < 0.0 {
                    nodes.swap(2, 3);
                }
                mesh.tets.push(nodes);
            });
        }
        (mesh, points)
    }
}

/// The diagonal of the quadrilateral on face (`p`, `q` inside, `n` outside): whether it goes from `p` to the cut point of `q`-`n`.
///
/// With one cut edge long it ends at that edge's cut point. With both short, `p`-`q` is a long edge of one lattice and `n` of the other:
/// the diagonal starts at the end from which an even number of coordinates decrease towards `n` (the parity rule), which differs from `p`
/// to `q` and between the two faces at `p`-`q` of every tetrahedron.
pub(crate) fn diagonal_from_first(lattice: &Lattice, tet: [Point; 4], p: usize, q: usize, n: usize) -> bool {
    let [dp, dq, dn] = [p, q, n].map(|v| lattice.doubled(tet[v]));
    let same_lattice = |a: [i32; 3], b: [i32; 3]| (a[0] ^ b[0]) & 1 == 0;
    if same_lattice(dq, dn) {
        true
    } else if same_lattice(dp, dn) {
        false
    } else {
        (0..3).filter(|a| dn[*a] < dp[*a]).count() % 2 == 0
    }
}

/// Zero of a function of the way from 0 (positive) to 1 (negative): Illinois' false position.
pub(crate) fn root(f: impl Fn(f64) -> f64, at_zero: f64, at_one: f64) -> f64 {
    let (mut t0, mut f0, mut t1, mut f1) = (0.0, at_zero, 1.0, at_one);
    let mut side = 0;
    for _ in 0..CUT_STEPS {
        let t = t0 + (t1 - t0) * f0 / (f0 - f1);
        let v = f(t);
        if v.abs() <= 1e-6 * (at_zero - at_one) {
            return t;
        }
        if v > 0.0 {
            (t0, f0) = (t, v);
            if side == 1 {
                f1 /= 2.0;
            }
            side = 1;
        } else {
            (t1, f1) = (t, v);
            if side == -1 {
                f0 /= 2.0;
            }
            side = -1;
        }
    }
    t0 + (t1 - t0) * f0 / (f0 - f1)
}

fn sign(v: f64) -> i8 {
    i8::from(v > 0.0) - i8::from(v < 0.0)
}

/// Drops all but the largest face-connected body, and nodes that nothing uses.
fn drop_small(mesh: &mut Stuffed, points: Vec<Option<Point>>, keep: Keep) -> Vec<Option<Point>> {
    let (of_tet, count) = topology::bodies(&mesh.tets);
    if keep == Keep::Largest && count > 1 {
        let mut volumes = vec![0.0; count];
        for (t, b) in mesh.tets.iter().zip(&of_tet) {
            volumes[*b as usize] += keyhole_tetmesh::quality::volume(t.map(|n| mesh.nodes[n as usize]));
        }
        let largest = (0..count).rev().max_by(|a, b| volumes[*a].total_cmp(&volumes[*b])).unwrap_or(0);
        mesh.dropped_volume = volumes.iter().sum::<f64>() - volumes[largest];
        let mut i = 0;
        mesh.tets.retain(|_| {
            i += 1;
            of_tet[i - 1] as usize == largest
        });
    }
    let mut used = vec![false; mesh.nodes.len()];
    mesh.tets.iter().flatten().for_each(|n| used[*n as usize] = true);
    let mut new = vec![0; used.len()];
    let mut next = 0;
    for (n, u) in used.iter().enumerate() {
        new[n] = next;
        next += u32::from(*u);
    }
    mesh.tets.iter_mut().flatten().for_each(|n| *n = new[*n as usize]);
    let mut n = 0;
    mesh.nodes.retain(|_| {
        n += 1;
        used[n - 1]
    });
    points.into_iter().zip(used).filter(|(_, u)| *u).map(|(p, _)| p).collect()
}
