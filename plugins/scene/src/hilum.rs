//! The hilum: the hollow side of an organ, where its vessels enter and hold it.
//!
//! A kidney, spleen, lung or ovary is convex but for its hilum, so the largest hollow of the surface tells it. How deep a point lies in a
//! hollow is its distance from the convex hull, which is the least distance from any plane that touches the organ from outside. One number
//! for a hollow is the volume below the hull that is near it, so neither a narrow deep cleft of the segmentation nor a wide shallow dent
//! wins alone. Nothing is read from the axes of the mesh: they are those of the patient only as long as nobody has turned it.

use bevy_math::DVec3;
use keyhole_tetmesh::{Boundary, TetMesh};

/// Planes that stand for the convex hull. They are 7 degrees apart, which makes a ball's surface 0.1 % of its radius deep.
const DIRECTIONS: usize = 1000;
/// How far a hollow reaches, as part of the organ's length: the hilar lips of a kidney of 11 cm are 3 to 4 cm apart.
const REACH: f64 = 0.18;
/// Part of the organ's length by which the deepest point of a hollow lies below the hull at least: less is a dent.
const LEAST_DEPTH: f64 = 0.03;
/// Points of the surface that are tried as the middle of the hollow.
const TRIED: usize = 2000;

/// The hollow side of an organ, in the mesh's coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hilum {
    /// The middle of the hollow's floor, m.
    pub point: DVec3,
    /// Out of the hollow, unit.
    pub outward: DVec3,
    /// The hollow's greatest depth below the convex hull, m.
    pub depth: f64,
}

/// The largest hollow of the surface among the points that `may_hold` accepts. `None` where there is none deeper than a dent.
#[must_use]
pub fn hilum(mesh: &TetMesh, may_hold: impl Fn(DVec3) -> bool) -> Option<Hilum> {
    let boundary = Boundary::of(mesh);
    let triangles: Vec<[DVec3; 3]> = boundary.triangles.iter().map(|t| t.map(|n| mesh.rest(n))).collect();
    let corners = || triangles.iter().flatten().copied();
    let (low, high) = corners().map(|p| (p, p)).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))?;
    let length = (high - low).length();
    let planes: Vec<(DVec3, f64)> =
        directions(DIRECTIONS).map(|d| (d, corners().map(|p| p.dot(d)).fold(f64::NEG_INFINITY, f64::max))).collect();
    // Each triangle by its middle: place, depth, the way out, and the volume between it and the hull.
    let hollow: Vec<(DVec3, f64, DVec3, f64)> = triangles
        .iter()
        .map(|t| ((t[0] + t[1] + t[2]) / 3.0, (t[1] - t[0]).cross(t[2] - t[0]).length() / 2.0))
        .filter(|(p, _)| may_hold(*p))
        .filter_map(|(p, area)| {
            let (out, depth) = planes.iter().map(|(d, h)| (*d, h - d.dot(p))).min_by(|a, b| a.1.total_cmp(&b.1))?;
            Some((p, depth, out, area * depth))
        })
        .collect();
    let near = |c: DVec3| hollow.iter().filter(move |h| h.0.distance(c) < REACH * length);
    let size = |c: DVec3| near(c).map(|h| h.3).sum::<f64>();
    let step = hollow.len().div_ceil(TRIED).max(1);
    let (middle, _) = hollow.iter().step_by(step).map(|h| (h.0, size(h.0))).max_by(|a, b| a.1.total_cmp(&b.1))?;
    let depth = near(middle).map(|h| h.1).fold(0.0, f64::max);
    let volume = size(middle);
    if depth < LEAST_DEPTH * length {
        return None;
    }
    let point = near(middle).map(|h| h.0 * h.3).sum::<DVec3>() / volume;
    let outward = near(middle).map(|h| h.2 * h.3).sum::<DVec3>().try_normalize()?;
    Some(Hilum { point, outward, depth })
}

/// Directions spread evenly over the sphere along a spiral (Vogel 1979: the golden angle).
fn directions(count: usize) -> impl Iterator<Item = DVec3> {
    let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    (0..count).map(move |k| {
        let y = 1.0 - (2 * k + 1) as f64 / count as f64;
        let (sin, cos) = (golden * k as f64).sin_cos();
        let r = (1.0 - y * y).sqrt();
        DVec3::new(r * cos, y, r * sin)
    })
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;
    use crate::ellipsoid::ellipsoid;
    use bevy_math::{DQuat, EulerRot};

    /// The ellipsoid with another shape.
    fn shaped(shape: impl Fn(DVec3) -> DVec3) -> TetMesh {
        let mesh = ellipsoid();
        let (tets, materials): (Vec<[u32; 4]>, Vec<_>) = mesh.iter().map(|(t, c)| (c.map(|n| n.0), mesh.tet(t).material)).unzip();
        TetMesh::new(mesh.rest_positions().iter().map(|p| shape(*p)).collect(), &tets, &materials)
    }

    /// As a bean: both ends go the same way, and that side becomes hollow.
    fn bent(p: DVec3) -> DVec3 {
        p + DVec3::Y * 9.0 * p.x * p.x
    }

    #[test]
    fn a_bean_is_hollow_on_its_inner_side_however_it_lies() {
        let turns = [(0.0, 0.0, 0.0), (0.4, -1.9, 2.6), (3.0, 0.2, -0.8)];
        for (x, y, z) in turns {
            let turn = DQuat::from_euler(EulerRot::XYZ, x, y, z);
            let found = hilum(&shaped(|p| turn * bent(p) + DVec3::new(0.3, -0.2, 0.9)), |_| true).unwrap();
            let outward = turn.inverse() * found.outward;
            assert!(outward.angle_between(DVec3::Y).to_degrees() < 10.0, "{outward}");
            let point = turn.inverse() * (found.point - DVec3::new(0.3, -0.2, 0.9));
            assert!(point.distance(DVec3::new(0.0, 0.03, 0.0)) < 0.01, "{point}");
            // The ends' tops touch the hull at the highest point of b sqrt(1 - t2) + 9 a2 t2, t = x / a: 3.5 cm over a floor of 3 cm.
            assert!((0.004..0.010).contains(&found.depth), "{}", found.depth);
        }
    }

    #[test]
    fn a_small_deep_cleft_does_not_win_over_the_hollow() {
        let cleft = |p: DVec3| if p.y < -0.02 && p.x.abs() < 0.006 && p.z.abs() < 0.006 { p * 0.4 } else { p };
        let found = hilum(&shaped(|p| bent(cleft(p))), |_| true).unwrap();
        assert!(found.outward.y > 0.9, "{found:?}");
    }

    #[test]
    fn what_is_convex_has_none() {
        assert_eq!(hilum(&ellipsoid(), |_| true), None);
        assert_eq!(hilum(&TetMesh::default(), |_| true), None);
        assert_eq!(hilum(&shaped(bent), |_| false), None);
    }
}
