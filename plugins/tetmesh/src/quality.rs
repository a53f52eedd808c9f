//! Shape of tetrahedra: volume, edge ratio, dihedral angles, altitudes, and their statistics over a mesh.

use crate::mesh::TetMesh;
use crate::topology::{EDGES, FACES};
use glam::DVec3;

/// Signed volume, m3.
#[must_use]
pub fn volume(p: [DVec3; 4]) -> f64 {
    (p[1] - p[0]).dot((p[2] - p[0]).cross(p[3] - p[0])) / 6.0
}

/// Whether the tetrahedron is positive, decided exactly.
#[must_use]
pub fn is_positive(p: [DVec3; 4]) -> bool {
    let c = |v: DVec3| robust::Coord3D { x: v.x, y: v.y, z: v.z };
    // robust's orient3d is positive when d lies below the plane of a, b, c seen counterclockwise: the opposite of our sign.
    robust::orient3d(c(p[0]), c(p[1]), c(p[2]), c(p[3])) < 0.0
}

/// Shortest edge / longest edge, the paper's aspect ratio: 1 is best.
#[must_use]
pub fn edge_ratio(p: [DVec3; 4]) -> f64 {
    let lengths = EDGES.map(|[i, j]| p[i].distance_squared(p[j]));
    let min = lengths.iter().copied().fold(f64::INFINITY, f64::min);
    let max = lengths.iter().copied().fold(0.0, f64::max);
    if max > 0.0 { (min / max).sqrt() } else { 0.0 }
}

/// The six dihedral angles at the edges [`EDGES`], radians.
#[must_use]
pub fn dihedral_angles(p: [DVec3; 4]) -> [f64; 6] {
    let normals = FACES.map(|[i, j, k]| (p[j] - p[i]).cross(p[k] - p[i]));
    EDGES.map(|[i, j]| {
        // The faces at an edge are those opposite to the two other corners.
        let [m, n] = EDGES.iter().copied().find(|[m, n]| ![*m, *n].contains(&i) && ![*m, *n].contains(&j)).unwrap_or([0, 1]);
        let (a, b) = (normals[m], normals[n]);
        a.cross(b).length().atan2(-a.dot(b))
    })
}

/// Smallest altitude, m.
#[must_use]
pub fn min_altitude(p: [DVec3; 4]) -> f64 {
    let v = volume(p).abs();
    let area = FACES.iter().map(|&[i, j, k]| (p[j] - p[i]).cross(p[k] - p[i]).length()).fold(0.0, f64::max);
    if area > 0.0 { 6.0 * v / area } else { 0.0 }
}

/// Statistics over all tetrahedra of a mesh; angles in degrees.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Quality {
    /// Smallest dihedral angle.
    pub min_dihedral_deg: f64,
    /// First percentile of each tetrahedron's smallest dihedral angle.
    pub p1_dihedral_deg: f64,
    /// Median of each tetrahedron's smallest dihedral angle.
    pub median_dihedral_deg: f64,
    /// Largest dihedral angle.
    pub max_dihedral_deg: f64,
    /// Mean edge ratio.
    pub mean_edge_ratio: f64,
    /// Smallest edge ratio.
    pub min_edge_ratio: f64,
}

/// Statistics of a mesh; all zero when it is empty.
#[must_use]
pub fn quality(mesh: &TetMesh) -> Quality {
    of_tets(mesh.iter().map(|(t, _)| mesh.points(t)))
}

/// Statistics of any tetrahedra, given by their points in metres.
pub fn of_tets(tets: impl Iterator<Item = [DVec3; 4]>) -> Quality {
    let mut smallest = Vec::new();
    let (mut largest, mut ratio_sum, mut ratio_min) = (0.0_f64, 0.0, f64::INFINITY);
    for p in tets {
        let angles = dihedral_angles(p);
        smallest.push(angles.iter().copied().fold(f64::INFINITY, f64::min));
        largest = angles.iter().copied().fold(largest, f64::max);
        let ratio = edge_ratio(p);
        ratio_sum += ratio;
        ratio_min = ratio_min.min(ratio);
    }
    if smallest.is_empty() {
        return Quality::default();
    }
    smallest.sort_unstable_by(f64::total_cmp);
    let n = smallest.len();
    Quality {
        min_dihedral_deg: smallest[0].to_degrees(),
        p1_dihedral_deg: smallest[n / 100].to_degrees(),
        median_dihedral_deg: smallest[n / 2].to_degrees(),
        max_dihedral_deg: largest.to_degrees(),
        mean_edge_ratio: ratio_sum / n as f64,
        min_edge_ratio: ratio_min,
    }
}
