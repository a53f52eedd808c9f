//! What is kept of one lattice tetrahedron: the stencils of isosurface stuffing (Labelle and Shewchuk 2007, figure 3).
//!
//! Signs are those of the field at the corners after warping: 1 inside, 0 on the surface, -1 outside. A face with two corners inside and
//! one outside leaves a quadrilateral, and its diagonal must be the same seen from both tetrahedra at the face:
//! a face whose cut edges are one long and one short takes the diagonal at the cut point of the long one; a face whose cut edges are both
//! short takes it by the parity rule.

/// A corner of what is kept: a corner of the lattice tetrahedron, or the cut point on one of its edges (inside, outside).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Vertex {
    Corner(usize),
    Cut(usize, usize),
}

use Vertex::{Corner, Cut};

/// Calls `emit` for every tetrahedron that is kept. Orientation is not determined. `from_first(p, q, n)` tells, for a face with `p` and
/// `q` inside and `n` outside, whether the diagonal starts at `p` (and ends at the cut point of `q`-`n`). `between` tells, where two corners
/// are inside and two outside, whether the quadrilateral between them has the diagonal from the first inside's cut to the first outside
/// to the second's to the second; without it the stencil takes one that its faces allow.
pub(crate) fn keep(
    signs: [i8; 4],
    from_first: impl Fn(usize, usize, usize) -> bool,
    between: Option<bool>,
    mut emit: impl FnMut([Vertex; 4]),
) {
    let mut inside = [0; 4];
    let mut on = [0; 4];
    let mut outside = [0; 4];
    let (mut i, mut z, mut o) = (0, 0, 0);
    for (v, s) in signs.into_iter().enumerate() {
        match s {
            1 => (inside[i], i) = (v, i + 1),
            0 => (on[z], z) = (v, z + 1),
            _ => (outside[o], o) = (v, o + 1),
        }
    }
    match (i, o) {
        (0, _) => {}
        (_, 0) => emit([Corner(0), Corner(1), Corner(2), Corner(3)]),
        (1, _) => {
            let p = inside[0];
            emit(std::array::from_fn(|v| if signs[v] < 0 { Cut(p, v) } else { Corner(v) }));
        }
        (2, 1) => {
            let ([p, q], n, apex) = ([inside[0], inside[1]], outside[0], Corner(on[0]));
            if from_first(p, q, n) {
                emit([Corner(p), Corner(q), Cut(q, n), apex]);
                emit([Corner(p), Cut(q, n), Cut(p, n), apex]);
            } else {
                emit([Corner(p), Corner(q), Cut(p, n), apex]);
                emit([Corner(q), Cut(q, n), Cut(p, n), apex]);
            }
        }
        (2, _) => {
            let ([p, q], [m, n]) = ([inside[0], inside[1]], [outside[0], outside[1]]);
            let (dm, dn) = (from_first(p, q, m), from_first(p, q, n));
            // The quadrilateral on the surface is this tetrahedron's own: it takes the diagonal that the two others leave possible.
            prism([Corner(p), Cut(p, m), Cut(p, n)], [Corner(q), Cut(q, m), Cut(q, n)], [dm, between.unwrap_or(!dm), !dn], emit);
        }
        _ => {
            let ([p, q, r], n) = ([inside[0], inside[1], inside[2]], outside[0]);
            let diagonals = [from_first(p, q, n), from_first(q, r, n), from_first(r, p, n)];
            prism([Corner(p), Corner(q), Corner(r)], [Cut(p, n), Cut(q, n), Cut(r, n)], diagonals, emit);
        }
    }
}

/// Three tetrahedra of a prism with columns `a[i]`-`b[i]`. `diagonals[i]` tells whether the quadrilateral of the columns `i` and `i + 1`
/// has the diagonal `a[i]`-`b[i + 1]`; the three must not all be the same.
fn prism(a: [Vertex; 3], b: [Vertex; 3], diagonals: [bool; 3], mut emit: impl FnMut([Vertex; 4])) {
    debug_assert!(diagonals != [true; 3] && diagonals != [false; 3], "a cyclic prism has no tetrahedra");
    // "a[i]-b[j] is a diagonal" orders the columns, i before j. The first has two such diagonals, the last none.
    let mut before = [0; 3];
    for (i, d) in diagonals.into_iter().enumerate() {
        before[if d { (i + 1) % 3 } else { i }] += 1;
    }
    let mut order = [0; 3];
    for (column, rank) in before.into_iter().enumerate() {
        order[rank] = column;
    }
    let [i, j, k] = order;
    emit([a[i], a[j], a[k], b[k]]);
    emit([a[i], a[j], b[j], b[k]]);
    emit([a[i], b[i], b[j], b[k]]);
}
