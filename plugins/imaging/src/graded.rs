//! A coarser core: away from every surface the cells of the lattice double, and double again.
//!
//! Cells are joined to leaves of an octree, two leaves that touch differing by one level at most. Between leaves of one size stand the
//! tetrahedra of the body-centred lattice, halved where an edge of their face is one of smaller leaves too; between a leaf and a smaller
//! one stand half pyramids on the smaller side and quarters of lattice tetrahedra on the larger (Labelle and Shewchuk 2007, section 3.2).
//! Their dihedral angles lie in [45, 120] degrees. All leaves near a surface have the lattice's own cell, so the proved bound of the
//! stencils stands.

use crate::lattice::{Lattice, Point};
use rayon::prelude::*;
use rustc_hash::FxHashSet;

/// Cells around a leaf that must be as good as its own: their centres are corners of its tetrahedra.
const ROOM: usize = 1;
/// Cells from one side of that neighbourhood to the other.
const WIDE: usize = 2 * ROOM + 1;

/// Levels of the leaves: the cell of index i lies in one of `2^level[i]` cells along each side, aligned to a multiple of that.
pub(crate) struct Leaves {
    level: Vec<u8>,
}

impl Leaves {
    /// The largest leaves, of at most `levels` doublings, in which every point is `plain` and of one `class`.
    pub fn new(lattice: &Lattice, levels: u8, plain: impl Fn(Point) -> bool + Sync, class: impl Fn(Point) -> u32 + Sync) -> Self {
        let dims = lattice.cells;
        let count = dims.iter().product::<usize>();
        let mut level = vec![0; count];
        if levels == 0 {
            return Self { level };
        }
        let of: Vec<Option<u32>> = (0..count).into_par_iter().map(|cell| one_class(lattice, cell, &plain, &class)).collect();
        let at = |i: [usize; 3]| i[0] + dims[0] * (i[1] + dims[1] * i[2]);
        // Cells whose whole neighbourhood is of one class; those near the lattice's end are none.
        let mut good: Vec<bool> = (0..count)
            .into_par_iter()
            .map(|cell| {
                let i = index(cell, dims);
                let inner = (0..3).all(|a| i[a] >= ROOM && i[a] + ROOM < dims[a]);
                let near = |k: usize| at(std::array::from_fn(|a| i[a] + k / WIDE.pow(a as u32) % WIDE - ROOM));
                inner && of[cell].is_some() && (0..WIDE.pow(3)).all(|k| of[near(k)] == of[cell])
            })
            .collect();
        let mut blocks = dims;
        for l in 1..=levels {
            let finer = blocks;
            blocks = finer.map(|n| n / 2);
            let count = blocks.iter().product::<usize>();
            // A leaf of the first level needs its own cells only; the others need all that touch them too, so that sizes step by one.
            let reach = if l == 1 { 0..2 } else { -1..3 };
            let next: Vec<bool> = (0..count)
                .into_par_iter()
                .map(|block| {
                    let i = index(block, blocks);
                    let child = |o: [i64; 3]| {
                        let c: [i64; 3] = std::array::from_fn(|a| 2 * i[a] as i64 + o[a]);
                        let there = (0..3).all(|a| c[a] >= 0 && (c[a] as usize) < finer[a]);
                        there && good[c[0] as usize + finer[0] * (c[1] as usize + finer[1] * c[2] as usize)]
                    };
                    let r = || reach.clone();
                    r().all(|z| r().all(|y| r().all(|x| child([x, y, z]))))
                })
                .collect();
            let size = 1_usize << l;
            for (block, _) in next.iter().enumerate().filter(|(_, g)| **g) {
                let i = index(block, blocks);
                for k in 0..size.pow(3) {
                    level[at([i[0] * size + k % size, i[1] * size + k / size % size, i[2] * size + k / size / size])] = l;
                }
            }
            good = next;
        }
        Self { level }
    }

    /// Whether a cell is a leaf of its own.
    pub fn is_fine(&self, cell: usize) -> bool {
        self.level[cell] == 0
    }

    /// The tetrahedra at leaves larger than a cell, by their lattice points; orientation is not determined.
    pub fn tets(&self, lattice: &Lattice) -> Vec<[Point; 4]> {
        let dims = lattice.cells;
        // First cell and level of each leaf.
        let leaves: Vec<([i32; 3], u8)> = (0..self.level.len())
            .map(|cell| (index(cell, dims), self.level[cell]))
            .filter(|(i, l)| i.iter().all(|v| v % (1 << l) == 0))
            .map(|(i, l)| (i.map(|v| v as i32), l))
            .collect();
        let mut corners: FxHashSet<[i32; 3]> = FxHashSet::default();
        for (i, l) in &leaves {
            let size = 1 << l;
            corners.extend((0..8).map(|k| [i[0] + (k & 1) * size, i[1] + (k >> 1 & 1) * size, i[2] + (k >> 2) * size]));
        }
        let mut out = Vec::new();
        // Twice the cell coordinates name lattice points.
        let corner = |i: [i32; 3]| lattice.at(i.map(|v| 2 * v));
        let centre = |i: [i32; 3], l: u8| lattice.at(i.map(|v| 2 * v + (1 << l)));
        for &(i, l) in &leaves {
            let size = 1_i32 << l;
            for axis in 0..3 {
                let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                for side in [-1, 1] {
                    let mut beyond = i;
                    beyond[axis] += if side > 0 { size } else { -1 };
                    let Some(other) = self.level_at(beyond, dims) else { continue };
                    let mut base = i;
                    base[axis] += if side > 0 { size } else { 0 };
                    let on_face = |du: i32, dv: i32| {
                        let mut p = base;
                        p[u] += du;
                        p[v] += dv;
                        p
                    };
                    if other == l && l > 0 && side > 0 {
                        let mut next = i;
                        next[axis] += size;
                        let ring = [(0, 0), (size, 0), (size, size), (0, size)];
                        for k in 0..4 {
                            let (p, q) = (on_face(ring[k].0, ring[k].1), on_face(ring[(k + 1) % 4].0, ring[(k + 1) % 4].1));
                            let middle: [i32; 3] = std::array::from_fn(|a| (p[a] + q[a]) / 2);
                            if corners.contains(&middle) {
                                push(&mut out, [centre(i, l), centre(next, l), corner(p), corner(middle)]);
                                push(&mut out, [centre(i, l), centre(next, l), corner(middle), corner(q)]);
                            } else {
                                push(&mut out, [centre(i, l), centre(next, l), corner(p), corner(q)]);
                            }
                        }
                    } else if other == l + 1 {
                        let double = 2 * size;
                        let large: [i32; 3] = beyond.map(|v| v - v.rem_euclid(double));
                        // Of this leaf's face, one corner is the middle of the larger face, and the opposite one a corner of it.
                        let (au, av) = ((i[u] - large[u]) / size, (i[v] - large[v]) / size);
                        let (mu, mv) = (size * (1 - au), size * (1 - av));
                        let (m, k) = (on_face(mu, mv), on_face(size - mu, size - mv));
                        for e in [on_face(size - mu, mv), on_face(mu, size - mv)] {
                            push(&mut out, [centre(i, l), corner(m), corner(e), corner(k)]);
                            push(&mut out, [centre(large, l + 1), corner(m), corner(e), corner(k)]);
                        }
                    }
                }
            }
        }
        out
    }

    fn level_at(&self, i: [i32; 3], dims: [usize; 3]) -> Option<u8> {
        let there = (0..3).all(|a| i[a] >= 0 && (i[a] as usize) < dims[a]);
        there.then(|| self.level[i[0] as usize + dims[0] * (i[1] as usize + dims[1] * i[2] as usize)])
    }
}

/// Leaves stand inside the lattice, so their points are there.
fn push(out: &mut Vec<[Point; 4]>, tet: [Option<Point>; 4]) {
    if let [Some(a), Some(b), Some(c), Some(d)] = tet {
        out.push([a, b, c, d]);
    }
}

fn index(cell: usize, dims: [usize; 3]) -> [usize; 3] {
    [cell % dims[0], cell / dims[0] % dims[1], cell / (dims[0] * dims[1])]
}

/// The class of a cell's corners and centre, `None` when they are not all plain and of one class.
fn one_class(lattice: &Lattice, cell: usize, plain: &impl Fn(Point) -> bool, class: &impl Fn(Point) -> u32) -> Option<u32> {
    let i = index(cell, lattice.cells).map(|v| 2 * v as i32);
    let corners = (0..8).map(|k| [i[0] + 2 * (k & 1), i[1] + 2 * (k >> 1 & 1), i[2] + 2 * (k >> 2)]);
    let mut points = corners.chain([i.map(|v| v + 1)]).filter_map(|d| lattice.at(d));
    let first = points.next().filter(|p| plain(*p)).map(class)?;
    points.all(|p| plain(p) && class(p) == first).then_some(first)
}
