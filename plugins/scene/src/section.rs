//! Planning a resection: the plane that frees the tumour, the organ's section there, and the fan that a blade sweeps about its port.

use bevy_math::{DQuat, DVec3};
use keyhole_tetmesh::{MaterialId, TetMesh};

/// Material of tumours: the second of an organ.
pub const TUMOUR: MaterialId = MaterialId(1);

/// Healthy tissue left around the tumour, m: 4 mm.
pub const MARGIN_M: f64 = 0.004;

/// A plane through an organ in the mesh's own coordinates; what lies on the side of the normal comes free.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// Unit normal, from the organ's body to the piece.
    pub normal: DVec3,
    /// `normal . x` of its points, m.
    pub offset: f64,
}

impl Plane {
    /// Signed distance, m: positive in the piece.
    #[must_use]
    pub fn distance(&self, point: DVec3) -> f64 {
        self.normal.dot(point) - self.offset
    }
}

/// The plane that frees the tumour with [`MARGIN_M`] of healthy tissue: its normal goes from the centroid of the rest to that of the
/// tumour. An organ without tumour is cut at two thirds of its longest side. `None` when the plane leaves nothing on one of its sides.
#[must_use]
pub fn resection_plane(mesh: &TetMesh) -> Option<Plane> {
    let plane = match (centroid(mesh, |m| m != TUMOUR), centroid(mesh, |m| m == TUMOUR)) {
        (Some(body), Some(tumour)) => {
            let normal = (tumour - body).try_normalize()?;
            let nodes = mesh.iter().filter(|(t, _)| mesh.tet(*t).material == TUMOUR).flat_map(|(_, corners)| corners);
            let nearest = nodes.map(|n| normal.dot(mesh.rest(n))).fold(f64::INFINITY, f64::min);
            Plane { normal, offset: nearest - MARGIN_M }
        }
        _ => {
            let (low, high) = bounds(mesh)?;
            let size = high - low;
            let normal = [DVec3::X, DVec3::Y, DVec3::Z].into_iter().max_by(|a, b| a.dot(size).total_cmp(&b.dot(size)))?;
            Plane { normal, offset: normal.dot(low + size * (2.0 / 3.0)) }
        }
    };
    let on = |side: f64| mesh.nodes().any(|n| side * plane.distance(mesh.rest(n)) > 0.0);
    (on(1.0) && on(-1.0)).then_some(plane)
}

/// Lowest and highest corner of the nodes' box, m. `None` for an empty mesh.
#[must_use]
pub fn bounds(mesh: &TetMesh) -> Option<(DVec3, DVec3)> {
    mesh.nodes().map(|n| mesh.rest(n)).map(|p| (p, p)).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
}

/// Centroid by volume of the tetrahedra of some materials, m. `None` when there is none.
#[must_use]
pub fn centroid(mesh: &TetMesh, of: impl Fn(MaterialId) -> bool) -> Option<DVec3> {
    let (mut sum, mut volume) = (DVec3::ZERO, 0.0);
    for (tet, _) in mesh.iter().filter(|(t, _)| of(mesh.tet(*t).material)) {
        let v = mesh.volume(tet);
        sum += v / 4.0 * mesh.points(tet).into_iter().sum::<DVec3>();
        volume += v;
    }
    (volume > 0.0).then(|| sum / volume)
}

/// Where the edges of the mesh cross a plane, m.
#[must_use]
pub fn section(mesh: &TetMesh, plane: &Plane) -> Vec<DVec3> {
    let mut points = Vec::new();
    for (tet, _) in mesh.iter() {
        let p = mesh.points(tet);
        for (i, j) in [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)] {
            let (a, b) = (plane.distance(p[i]), plane.distance(p[j]));
            if (a < 0.0) != (b < 0.0) {
                points.push(p[i].lerp(p[j], a / (a - b)));
            }
        }
    }
    points
}

/// A fan in a plane about a port: where a blade on the shaft's axis has to be to sweep all of a section.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fan {
    /// Middle of the section, m.
    pub centre: DVec3,
    /// From the port to the middle of the section: the blade's direction halfway through, unit.
    pub blade: DVec3,
    /// Along the sweep: unit, in the plane, across `blade`.
    pub sweep: DVec3,
    /// From the port to the middle, m.
    pub port_distance: f64,
    /// Smallest and largest distance of the section from the port, m.
    pub radius: (f64, f64),
    /// Smallest and largest angle of the section about the port, from `blade` towards `sweep`, rad.
    pub angle: (f64, f64),
}

impl Fan {
    /// The fan for a section (points in a plane of this normal), from the side on which the section is narrowest, so that the blade is
    /// short. `None` for a section without extent.
    #[must_use]
    pub fn of(section: &[DVec3], normal: DVec3, port_distance: f64) -> Option<Self> {
        const DIRECTIONS: u32 = 36;
        let across = normal.any_orthonormal_vector();
        let direction = |k: u32| DQuat::from_axis_angle(normal, std::f64::consts::PI * f64::from(k) / f64::from(DIRECTIONS)) * across;
        let width = |d: DVec3| extent(section, d).map_or(f64::INFINITY, |(low, high)| high - low);
        let blade = (0..DIRECTIONS).map(direction).min_by(|a, b| width(*a).total_cmp(&width(*b)))?;
        let sweep = normal.cross(blade);
        let (along, beside) = (extent(section, blade)?, extent(section, sweep)?);
        let height = normal.dot(*section.first()?);
        let centre = blade * (along.0 + along.1) / 2.0 + sweep * (beside.0 + beside.1) / 2.0 + normal * height;
        if along.1 <= along.0 || along.1 - along.0 >= 2.0 * port_distance {
            return None;
        }
        let port = centre - blade * port_distance;
        let polar = section.iter().map(|p| (p.distance(port), (*p - port).dot(sweep).atan2((*p - port).dot(blade))));
        let start = ((f64::INFINITY, f64::NEG_INFINITY), (f64::INFINITY, f64::NEG_INFINITY));
        let (radius, angle) = polar.fold(start, |(r, a), (pr, pa)| ((r.0.min(pr), r.1.max(pr)), (a.0.min(pa), a.1.max(pa))));
        Some(Self { centre, blade, sweep, port_distance, radius, angle })
    }

    /// The port, m.
    #[must_use]
    pub fn port(&self) -> DVec3 {
        self.centre - self.blade * self.port_distance
    }

    /// The point at a distance (m) and an angle (rad) from the port.
    #[must_use]
    pub fn at(&self, radius: f64, angle: f64) -> DVec3 {
        self.port() + radius * (angle.cos() * self.blade + angle.sin() * self.sweep)
    }
}

/// Smallest and largest component of points along a direction. `None` without points.
#[must_use]
pub fn extent(points: &[DVec3], direction: DVec3) -> Option<(f64, f64)> {
    points.iter().map(|p| p.dot(direction)).map(|x| (x, x)).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;
    use crate::ellipsoid::ellipsoid;

    #[test]
    fn the_plane_leaves_the_tumour_with_its_margin_in_the_piece() {
        let mesh = ellipsoid();
        let plane = resection_plane(&mesh).unwrap();
        let tumour = mesh.iter().filter(|(t, _)| mesh.tet(*t).material == TUMOUR).flat_map(|(_, c)| c);
        let nearest = tumour.map(|n| plane.distance(mesh.rest(n))).fold(f64::INFINITY, f64::min);
        assert!((nearest - MARGIN_M).abs() < 1e-12);
        assert!((plane.normal.length() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn an_organ_without_tumour_is_cut_at_two_thirds() {
        let whole = ellipsoid();
        let tets: Vec<[u32; 4]> = whole.iter().map(|(_, c)| c.map(|n| n.0)).collect();
        let mesh = TetMesh::new(whole.rest_positions().to_vec(), &tets, &[]);
        let (low, high) = bounds(&mesh).unwrap();
        let plane = resection_plane(&mesh).unwrap();
        assert_eq!(plane.normal, DVec3::X);
        assert!((plane.offset - (low.x + 2.0 / 3.0 * (high.x - low.x))).abs() < 1e-12);
    }

    #[test]
    fn the_fan_covers_every_point_of_the_section() {
        let mesh = ellipsoid();
        let plane = resection_plane(&mesh).unwrap();
        let points = section(&mesh, &plane);
        let fan = Fan::of(&points, plane.normal, 0.14).unwrap();
        for p in &points {
            assert!(plane.distance(*p).abs() < 1e-12);
            let to = *p - fan.port();
            let (r, a) = (to.length(), to.dot(fan.sweep).atan2(to.dot(fan.blade)));
            assert!(r >= fan.radius.0 && r <= fan.radius.1 && a >= fan.angle.0 && a <= fan.angle.1);
            assert!(fan.at(r, a).distance(*p) < 1e-12);
        }
    }

    #[test]
    fn a_mesh_of_nothing_has_no_plane() {
        assert_eq!(resection_plane(&TetMesh::default()), None);
        assert_eq!(Fan::of(&[], DVec3::Z, 0.1), None);
    }
}
