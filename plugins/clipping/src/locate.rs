//! Points of tissue: where they are, and which tetrahedron has them.

use bevy_math::{DVec3, Vec3};
use keyhole_tetmesh::{NodeId, TetId, TetMesh};
use keyhole_whiteboard::TissuePoint;

/// Barycentric coordinates of a point in a tetrahedron: positive inside. `None` of one that is inverted or flat.
#[must_use]
pub fn weights(corners: [DVec3; 4], p: DVec3) -> Option<[f64; 4]> {
    let [a, b, c, d] = corners;
    let volume = |a: DVec3, b: DVec3, c: DVec3, d: DVec3| (b - a).dot((c - a).cross(d - a));
    let whole = volume(a, b, c, d);
    (whole > 0.0).then(|| [volume(p, b, c, d), volume(a, p, c, d), volume(a, b, p, d), volume(a, b, c, p)].map(|v| v / whole))
}

/// Part of a tetrahedron by which a point may be outside of it and still be its: a point on a face between two children of a cut is, by rounding, in none.
const OUTSIDE: f64 = 1e-4;

/// Of some tetrahedra the one whose rest shape has a point (m), and the point in it.
#[must_use]
pub fn at_rest(mesh: &TetMesh, tets: impl Iterator<Item = TetId>, point: Vec3) -> Option<(TetId, TissuePoint)> {
    let p = point.as_dvec3();
    let mut best: Option<(f64, TetId, [f64; 4])> = None;
    for tet in tets {
        let corners = mesh.points(tet);
        let (low, high) = corners.iter().fold((corners[0], corners[0]), |(low, high), c| (low.min(*c), high.max(*c)));
        let margin = (high - low) * OUTSIDE;
        if p.cmplt(low - margin).any() || p.cmpgt(high + margin).any() {
            continue;
        }
        let Some(found) = weights(corners, p) else { continue };
        let least = found.iter().copied().fold(f64::INFINITY, f64::min);
        if least > best.map_or(-OUTSIDE, |b| b.0) {
            best = Some((least, tet, found));
        }
        if least > 0.0 {
            break;
        }
    }
    best.map(|(_, tet, found)| (tet, mesh.corners(tet).into_iter().zip(found.map(|w| w as f32)).collect()))
}

/// Whether a point's nodes are still the corners of one tetrahedron: a cut may have gone between them.
#[must_use]
pub fn is_whole(mesh: &TetMesh, point: &TissuePoint) -> bool {
    let [(first, _), rest @ ..] = point.as_slice() else { return false };
    let has_all = |corners: [NodeId; 4]| rest.iter().all(|(n, _)| corners.contains(n));
    mesh.contains_node(*first) && mesh.topology().around_node(*first).iter().any(|t| has_all(mesh.corners(*t)))
}

/// Where a point of tissue is among these positions (m); `None` where it has a node that is not there.
#[must_use]
pub fn position(point: &TissuePoint, positions: &[Vec3]) -> Option<Vec3> {
    point.iter().map(|(n, w)| positions.get(n.index()).map(|x| *x * *w)).sum()
}

/// Where a point of tissue is in the rest shape, m.
#[must_use]
pub fn rest(mesh: &TetMesh, point: &TissuePoint) -> Vec3 {
    point.iter().map(|(n, w)| mesh.rest(*n) * f64::from(*w)).sum::<DVec3>().as_vec3()
}
