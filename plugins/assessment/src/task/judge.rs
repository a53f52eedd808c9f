//! Whether goals are met: plain functions over plain data.

use crate::task::goal::{Circle, Span};
use bevy_math::{DVec3, Vec3};
use keyhole_tetmesh::{FACES, OuterPlanes, TetMesh};
use std::f64::consts::{PI, TAU};

/// Speed of its middle below which a thing is at rest, m/s.
pub const REST_M_S: f64 = 0.005;

/// Largest cosine between two ways in which jaws push what they hold between them: 120 degrees.
const OPPOSITE: f32 = -0.5;

/// Whether something that is pushed in these ways, unit vectors, by one instrument is between its jaws: two of them are opposite to each other.
#[must_use]
pub fn is_between(ways: &[Vec3]) -> bool {
    ways.iter().enumerate().any(|(at, a)| ways[..at].iter().any(|b| a.dot(*b) < OPPOSITE))
}

/// Whether points (m), those of a ring, lie around a line: seen along the line no half turn about it is without a point, and their middle is between its ends.
///
/// What has no hole cannot be around a solid peg, so that this tells a ring on a peg from one beside it or above it.
#[must_use]
pub fn is_round(points: &[DVec3], peg: Span) -> bool {
    let [from, to] = peg;
    let length = from.distance(to);
    let Some(axis) = (to - from).try_normalize() else { return false };
    if points.is_empty() {
        return false;
    }
    let middle = (points.iter().sum::<DVec3>() / points.len() as f64 - from).dot(axis);
    if !(0.0..=length).contains(&middle) {
        return false;
    }
    let (across, up) = axis.any_orthonormal_pair();
    let mut turns: Vec<f64> = points.iter().map(|p| (*p - from).dot(up).atan2((*p - from).dot(across))).collect();
    turns.sort_unstable_by(f64::total_cmp);
    let last_to_first = turns[0] + TAU - turns[turns.len() - 1];
    let widest = turns.windows(2).map(|pair| pair[1] - pair[0]).fold(last_to_first, f64::max);
    widest < PI
}

/// Whether a point (m) is in the box between its lowest and its highest corner, its border included.
#[must_use]
pub fn is_inside(point: DVec3, [min, max]: Span) -> bool {
    point.cmpge(min).all() && point.cmple(max).all()
}

/// How far the rim of a piece is off a circle at most, m: the largest distance, in the circle's plane and in the rest shape, of the vertices of the surface that was cut from
/// the circle's line. `skin` is that of the organ before it was cut. `None` where nothing of the piece was cut, or its middle is outside of the circle.
#[must_use]
pub fn off_circle_m(piece: &TetMesh, skin: &OuterPlanes, circle: &Circle) -> Option<f64> {
    let radial = |p: DVec3| {
        let out = p - circle.centre;
        (out - circle.normal * out.dot(circle.normal)).length()
    };
    let (mut sum, mut count) = (DVec3::ZERO, 0.0);
    for node in piece.nodes() {
        sum += piece.rest(node);
        count += 1.0;
    }
    if count == 0.0 || radial(sum / count) > circle.radius_m {
        return None;
    }
    let mut most: Option<f64> = None;
    for (tet, corners) in piece.iter() {
        for (face, local) in FACES.iter().enumerate() {
            if piece.topology().neighbour(tet, face).is_some() || skin.is_outer(piece, tet, face) {
                continue;
            }
            for node in local.map(|i| corners[i]) {
                let off = (radial(piece.rest(node)) - circle.radius_m).abs();
                most = Some(most.map_or(off, |m| m.max(off)));
            }
        }
    }
    most
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PEG: Span = [DVec3::ZERO, DVec3::new(0.0, 0.02, 0.0)];

    /// A ring of 12 mm, its middle at a place, tilted about X.
    fn ring(middle: DVec3, tilt_rad: f64) -> Vec<DVec3> {
        (0..24)
            .map(|i| {
                let (sin, cos) = (f64::from(i) * TAU / 24.0).sin_cos();
                middle + 0.012 * DVec3::new(cos, sin * tilt_rad.sin(), sin * tilt_rad.cos())
            })
            .collect()
    }

    #[test]
    fn a_ring_is_round_a_peg_or_beside_it_or_above_it() {
        assert!(is_round(&ring(DVec3::new(0.002, 0.005, -0.003), 0.3), PEG));
        assert!(!is_round(&ring(DVec3::new(0.013, 0.005, 0.0), 0.0), PEG), "beside");
        assert!(!is_round(&ring(DVec3::new(0.0, 0.021, 0.0), 0.0), PEG), "above");
        assert!(!is_round(&[], PEG) && !is_round(&ring(DVec3::ZERO, 0.0), [DVec3::ZERO; 2]));
    }

    #[test]
    fn jaws_push_from_opposite_sides() {
        let tilted = Vec3::new(0.3, -1.0, 0.0).normalize();
        assert!(is_between(&[Vec3::Y, Vec3::X, tilted]));
        assert!(!is_between(&[Vec3::Y, Vec3::X, Vec3::Z]) && !is_between(&[Vec3::Y]) && !is_between(&[]));
    }

    proptest! {
        /// A level ring is round the peg exactly where the peg's axis is inside the polygon of its points.
        #[test]
        fn a_ring_is_round_what_is_inside_it(x in -0.02f64..0.02, z in -0.02f64..0.02) {
            let points = ring(DVec3::new(x, 0.01, z), 0.0);
            let side = |i: usize| {
                let (a, b) = (points[i], points[(i + 1) % 24]);
                a.x * b.z - a.z * b.x
            };
            let inside = (0..24).all(|i| side(i) > 0.0);
            prop_assert_eq!(is_round(&points, PEG), inside);
        }
    }

    /// A square of 20 mm, two tetrahedra of it cut off by a line at 4 mm from the middle of a circle of 5 mm: the ends of the cut are `sqrt(4^2 + y^2)` from the middle.
    #[test]
    fn a_rim_is_as_far_off_as_its_farthest_vertex() {
        // Two prisms would do; one tetrahedron whose face in the plane x = 4 mm was cut is enough.
        let nodes = [[0.0, 0.0, 0.0], [4.0, -3.0, 0.0], [4.0, 3.0, 0.0], [4.0, 0.0, 1.0], [9.0, 0.0, 0.0]].map(|p| DVec3::from(p) * 1e-3);
        let whole = TetMesh::new(nodes.to_vec(), &[[0, 1, 2, 3], [4, 2, 1, 3]], &[]);
        let skin = OuterPlanes::of(&whole);
        let piece = TetMesh::new(nodes[..4].to_vec(), &[[0, 1, 2, 3]], &[]);
        let circle = Circle { centre: DVec3::ZERO, normal: DVec3::Z, radius_m: 0.0045 };
        // (4, 3) is 5 mm from the middle, 0.5 mm off; (4, 0) is 4 mm from it, 0.5 mm off too.
        assert!((off_circle_m(&piece, &skin, &circle).unwrap() - 0.0005).abs() < 1e-9);
        let circle = Circle { radius_m: 0.0048, ..circle };
        assert!((off_circle_m(&piece, &skin, &circle).unwrap() - 0.0008).abs() < 1e-9);
        assert_eq!(off_circle_m(&whole, &skin, &circle), None, "nothing was cut");
        let elsewhere = Circle { centre: DVec3::new(0.0, 0.02, 0.0), ..circle };
        assert_eq!(off_circle_m(&piece, &skin, &elsewhere), None);
    }
}
