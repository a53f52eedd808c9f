//! Which points of tissue are where the pads are.

use bevy_math::{DVec3, Vec3};
use keyhole_tetmesh::{NodeId, TetMesh};
use keyhole_whiteboard::TissuePoint;

/// For each of some points of the world (m) the point of the deformed mesh that is there: that of the first tetrahedron that has it. `positions` are by node slot, m.
#[must_use]
pub fn tissue_at(mesh: &TetMesh, positions: &[Vec3], points: &[Vec3]) -> Vec<Option<TissuePoint>> {
    let mut found: Vec<Option<TissuePoint>> = vec![None; points.len()];
    let bounds = |points: &[Vec3]| points.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), p| (low.min(*p), high.max(*p)));
    let (low, high) = bounds(points);
    for (_, corners) in mesh.iter() {
        let at = corners.map(|n| positions[n.index()]);
        let (least, most) = bounds(&at);
        if least.cmpgt(high).any() || most.cmplt(low).any() {
            continue;
        }
        for (point, found) in points.iter().zip(&mut found).filter(|(p, f)| f.is_none() && p.cmpge(least).all() && p.cmple(most).all()) {
            *found = weights(at, *point).map(|w| corners.into_iter().zip(w).collect());
        }
    }
    found
}

/// Whether a point's nodes are still the corners of one tetrahedron: a cut may have gone between them.
#[must_use]
pub fn is_whole(mesh: &TetMesh, point: &TissuePoint) -> bool {
    let [(first, _), rest @ ..] = point.as_slice() else { return false };
    let has_all = |corners: [NodeId; 4]| rest.iter().all(|(n, _)| corners.contains(n));
    mesh.contains_node(*first) && mesh.topology().around_node(*first).iter().any(|t| has_all(mesh.corners(*t)))
}

/// How many times as long as at rest the longest drawn edge between a point's nodes is; zero for a point of one node. `positions` are by node slot, m.
#[must_use]
pub fn stretch(mesh: &TetMesh, positions: &[Vec3], point: &TissuePoint) -> f32 {
    let ratio = |a: NodeId, b: NodeId| positions[a.index()].distance(positions[b.index()]) / mesh.rest(a).distance(mesh.rest(b)) as f32;
    let pairs = point.iter().enumerate().flat_map(|(i, (a, _))| point[i + 1..].iter().map(|(b, _)| (*a, *b)));
    pairs.map(|(a, b)| ratio(a, b)).fold(0.0, f32::max)
}

/// Where a point of tissue is, m.
#[must_use]
pub fn position(point: &TissuePoint, positions: &[Vec3]) -> Vec3 {
    point.iter().map(|(n, w)| positions[n.index()] * *w).sum()
}

/// Barycentric coordinates of a point in a tetrahedron that has it; `None` outside, and for one that is inverted or flat.
fn weights(corners: [Vec3; 4], point: Vec3) -> Option<[f32; 4]> {
    let [a, b, c, d] = corners.map(Vec3::as_dvec3);
    let p = point.as_dvec3();
    let volume = |a: DVec3, b: DVec3, c: DVec3, d: DVec3| (b - a).dot((c - a).cross(d - a));
    let whole = volume(a, b, c, d);
    let parts = [volume(p, b, c, d), volume(a, p, c, d), volume(a, b, p, d), volume(a, b, c, p)];
    (whole > 0.0 && parts.iter().all(|v| *v >= 0.0)).then(|| parts.map(|v| (v / whole) as f32))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;
    use keyhole_tetmesh::DVec3;

    /// Two tetrahedra that share a face, moved and stretched.
    #[test]
    fn a_point_is_found_where_the_tissue_has_gone() {
        let rest = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 1.0, 1.0]].map(DVec3::from_array).to_vec();
        let mut mesh = TetMesh::new(rest.clone(), &[[0, 1, 2, 3], [4, 3, 2, 1]], &[]);
        let moved: Vec<Vec3> = rest.iter().map(|p| p.as_vec3() * Vec3::new(2.0, 1.0, 0.5) + Vec3::X).collect();
        let inside = |weights: [f32; 5]| moved.iter().zip(weights).map(|(p, w)| *p * w).sum::<Vec3>();
        let points = [inside([0.4, 0.3, 0.2, 0.1, 0.0]), inside([0.0, 0.1, 0.2, 0.3, 0.4]), Vec3::ZERO];
        let found = tissue_at(&mesh, &moved, &points);
        for (point, found) in points.iter().zip(&found[..2]) {
            let found = found.as_ref().unwrap();
            assert!(position(found, &moved).distance(*point) < 1e-6);
            assert!((found.iter().map(|(_, w)| w).sum::<f32>() - 1.0).abs() < 1e-6);
            assert!(is_whole(&mesh, found));
        }
        assert_eq!(found[2], None);
        // Along x it is drawn to twice its length; the second tetrahedron has no edge along x alone: sqrt(4 + 1) of sqrt(2) is its longest.
        let drawn = |i: usize| stretch(&mesh, &moved, found[i].as_ref().unwrap());
        assert!((drawn(0) - 2.0).abs() < 1e-6, "{}", drawn(0));
        assert!((drawn(1) - 2.5_f32.sqrt()).abs() < 1e-6, "{}", drawn(1));
        let second = mesh.iter().nth(1).unwrap().0;
        mesh.remove_tet(second);
        assert!(is_whole(&mesh, found[0].as_ref().unwrap()) && !is_whole(&mesh, found[1].as_ref().unwrap()));
    }
}
