//! The bound of [`crate::stuffing`]: all stencils with every corner on the surface moved as far as it may be, in all fourteen directions, each independent of
//! the others.

use crate::lattice::{Lattice, Point};
use crate::stencil::{self, Vertex};
use crate::stuffing::{ALPHA_LONG, ALPHA_SHORT, PROVED_DEGREES, diagonal_from_first};
use glam::DVec3;
use keyhole_tetmesh::quality;

/// Where a moving corner and a cut point are tried between their limits.
const MOVES: [f64; 3] = [0.0, 0.5, 1.0];

/// Rounding of the published digits, degrees.
const DIGITS: f64 = 0.05;

/// The places where what is kept may have its corners.
fn places(lattice: &Lattice, tet: [Point; 4], vertex: Vertex, signs: [i8; 4], alphas: [f64; 2]) -> Vec<DVec3> {
    let at = |c: usize| lattice.position(tet[c]);
    let alpha = |long: bool| if long { alphas[0] } else { alphas[1] };
    match vertex {
        Vertex::Corner(c) if signs[c] != 0 => vec![at(c)],
        Vertex::Corner(c) => {
            let along = lattice.neighbours(tet[c]).flat_map(|(n, long)| MOVES[1..].iter().map(move |m| (n, m * alpha(long))));
            std::iter::once(at(c)).chain(along.map(|(n, t)| at(c).lerp(lattice.position(n), t))).collect()
        }
        Vertex::Cut(p, n) => {
            let long = lattice.neighbours(tet[p]).any(|(q, long)| q == tet[n] && long);
            MOVES.iter().map(|m| at(p).lerp(at(n), alpha(long) + m * (1.0 - 2.0 * alpha(long)))).collect()
        }
    }
}

/// Smallest and largest dihedral angle of all stencils, degrees.
fn bound(alphas: [f64; 2]) -> [f64; 2] {
    let lattice = Lattice::around(DVec3::splat(-2.0), DVec3::splat(2.0), 1.0);
    let middle = |t: &[Point; 4]| t.iter().map(|p| lattice.position(*p)).sum::<DVec3>().length();
    let tet = lattice.tets(|_| true).min_by(|a, b| middle(a).total_cmp(&middle(b))).unwrap_or_default();
    let mut found = [180.0_f64, 0.0_f64];
    for code in 0..81 {
        let signs = [0, 1, 2, 3].map(|i| (code / 3_i32.pow(i) % 3 - 1) as i8);
        stencil::keep(
            signs,
            |p, q, n| diagonal_from_first(&lattice, tet, p, q, n),
            None,
            |kept| {
                let [a, b, c, d] = kept.map(|v| places(&lattice, tet, v, signs, alphas));
                for a in &a {
                    for b in &b {
                        for c in &c {
                            for d in &d {
                                let angles = quality::dihedral_angles([*a, *b, *c, *d]).map(f64::to_degrees);
                                found[0] = angles.into_iter().fold(found[0], f64::min);
                                found[1] = angles.into_iter().fold(found[1], f64::max);
                            }
                        }
                    }
                }
            },
        );
    }
    found
}

#[test]
fn every_stencil_keeps_the_bound_wherever_its_corners_move() {
    let [least, most] = bound([ALPHA_LONG, ALPHA_SHORT]);
    assert!(least >= PROVED_DEGREES[0] - DIGITS && most <= PROVED_DEGREES[1] + DIGITS, "[{least}, {most}] degrees");
    // The thresholds of the paper hold the bound only as long as the moves of neighbours depend on each other.
    assert!(bound([0.249_99, 0.411_89])[0] < 9.5);
}
