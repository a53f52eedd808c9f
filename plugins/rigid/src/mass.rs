//! Mass, centre of mass and inertia: of bars, of the inside of a closed surface, and of points.

use bevy_math::{DMat3, DVec3};

/// Mass and its first two moments.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mass {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Centre of mass, m.
    pub centre: DVec3,
    /// Inertia about the centre of mass, kg m2.
    pub inertia: DMat3,
}

impl Mass {
    /// Of round bars of one density (kg/m3) and radius (m) between the points (m), end to end; where they meet they are cut off square.
    #[must_use]
    pub fn of_bars(points: &[DVec3], radius_m: f64, density_kg_m3: f64) -> Self {
        let bars = points.windows(2).map(|ends| {
            let along = ends[1] - ends[0];
            let length = along.length();
            let mass_kg = density_kg_m3 * std::f64::consts::PI * radius_m * radius_m * length;
            let centre = (ends[0] + ends[1]) / 2.0;
            // Second moment of a cylinder: l2/12 along its axis, r2/4 across.
            let axis = outer(along / length.max(f64::MIN_POSITIVE));
            let second = (axis * (length * length / 12.0) + (DMat3::IDENTITY - axis) * (radius_m * radius_m / 4.0)) * mass_kg;
            Self { mass_kg, centre, inertia: inertia(second) }
        });
        Self::sum(bars.collect::<Vec<_>>())
    }

    /// Of the inside of a closed surface of triangles, counter-clockwise from outside, by the sum over the tetrahedra from one of its points.
    #[must_use]
    pub fn of_inside(vertices: &[DVec3], triangles: &[[u32; 3]], density_kg_m3: f64) -> Self {
        let Some(from) = vertices.first().copied() else { return Self::default() };
        let (mut volume, mut first, mut second) = (0.0, DVec3::ZERO, DMat3::ZERO);
        for t in triangles {
            let [a, b, c] = t.map(|v| vertices[v as usize] - from);
            let six = a.dot(b.cross(c));
            volume += six / 6.0;
            first += (a + b + c) * (six / 24.0);
            // The second moment of a tetrahedron with one corner at zero: V/20 (sum of corner outer products + outer product of their sum).
            second += (outer(a) + outer(b) + outer(c) + outer(a + b + c)) * (six / 120.0);
        }
        let centre = if volume > 0.0 { first / volume } else { DVec3::ZERO };
        let about_centre = second - outer(centre) * volume;
        Self { mass_kg: density_kg_m3 * volume, centre: from + centre, inertia: inertia(about_centre * density_kg_m3) }
    }

    /// Of points with masses (kg) at positions (m).
    #[must_use]
    pub fn of_points(points: impl Iterator<Item = (f64, DVec3)> + Clone) -> Self {
        let mass_kg: f64 = points.clone().map(|(m, _)| m).sum();
        let first: DVec3 = points.clone().map(|(m, x)| x * m).sum();
        let centre = if mass_kg > 0.0 { first / mass_kg } else { DVec3::ZERO };
        let second = points.fold(DMat3::ZERO, |sum, (m, x)| sum + outer(x - centre) * m);
        Self { mass_kg, centre, inertia: inertia(second) }
    }

    fn sum(parts: Vec<Self>) -> Self {
        let whole = Self::of_points(parts.iter().map(|p| (p.mass_kg, p.centre)));
        parts.iter().fold(whole, |sum, p| Self { inertia: sum.inertia + p.inertia, ..sum })
    }
}

/// The inertia tensor that belongs to a second moment.
fn inertia(second: DMat3) -> DMat3 {
    let trace = second.x_axis.x + second.y_axis.y + second.z_axis.z;
    DMat3::from_diagonal(DVec3::splat(trace)) - second
}

fn outer(v: DVec3) -> DMat3 {
    DMat3::from_cols(v * v.x, v * v.y, v * v.z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn near(a: DMat3, b: DMat3, scale: f64) -> bool {
        (0..3).all(|i| (a.col(i) - b.col(i)).abs().max_element() < 1e-12 * scale)
    }

    proptest! {
        /// A box anywhere, by its surface: m (b2 + c2) / 12.
        #[test]
        fn a_box_has_the_inertia_of_a_box(size in (0.1f64..3.0, 0.1f64..3.0, 0.1f64..3.0), at in (-3f64..3.0, -3f64..3.0, -3f64..3.0)) {
            let (size, at) = (DVec3::from(size), DVec3::from(at));
            let vertices: Vec<DVec3> =
                (0..8).map(|i| at + size * (DVec3::new((i & 1).into(), (i >> 1 & 1).into(), (i >> 2).into()) - 0.5)).collect();
            let quads = [[0u32, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
            let triangles: Vec<[u32; 3]> = quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect();
            let mass = Mass::of_inside(&vertices, &triangles, 7.0);
            let expected = 7.0 * size.element_product();
            let s = size * size;
            let inertia = DMat3::from_diagonal(DVec3::new(s.y + s.z, s.z + s.x, s.x + s.y) * expected / 12.0);
            prop_assert!((mass.mass_kg - expected).abs() < 1e-12 * expected.max(1.0));
            prop_assert!(mass.centre.distance(at) < 1e-11);
            prop_assert!(near(mass.inertia, inertia, 1e3));
        }
    }

    /// A ring of wire about Z: half of m r2 about X and Y, m r2 about Z, each with the bar's own share, which a thin wire does not have.
    #[test]
    fn a_ring_of_wire_has_the_inertia_of_a_ring() {
        let points: Vec<DVec3> = (0..=720).map(|i| on_circle(f64::from(i) / 720.0 * std::f64::consts::TAU)).collect();
        let mass = Mass::of_bars(&points, 1e-4, 1.0);
        let unit = mass.mass_kg;
        assert!((mass.mass_kg / (std::f64::consts::PI * 1e-8 * std::f64::consts::TAU) - 1.0).abs() < 1e-5);
        assert!(mass.centre.length() < 1e-12);
        assert!(near(mass.inertia, DMat3::from_diagonal(DVec3::new(0.5, 0.5, 1.0)) * unit, unit * 2e7));
    }

    fn on_circle(angle: f64) -> DVec3 {
        DVec3::new(angle.cos(), angle.sin(), 0.0)
    }
}
