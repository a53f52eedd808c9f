//! Whether a point is in a tetrahedron, and where: its weights.

use bevy_math::Vec3A;

/// The weights of the corners of a tetrahedron as affine functions of a point: `w0 = 1 - w1 - w2 - w3`, `w1..3 = A^-1 (p - x0)` with the columns
/// of `A` the edges from corner 0 (Teschner et al. 2003, "Optimized spatial hashing for collision detection of deformable objects", section 3.3).
/// An inverted tetrahedron has them like any other.
#[derive(Clone, Copy, Debug)]
pub struct Weights {
    origin: Vec3A,
    rows: [Vec3A; 3],
}

impl Weights {
    /// The weights of a tetrahedron with these corners (m); `None` where it is flat or not finite.
    #[must_use]
    pub fn of(corners: [Vec3A; 4]) -> Option<Self> {
        let [a, b, c, d] = corners;
        let (u, v, w) = (b - a, c - a, d - a);
        let across = v.cross(w);
        let inverse = u.dot(across).recip();
        // Of a flat one the inverse is infinite; of one with huge or broken corners it is zero or not a number.
        (inverse.is_finite() && inverse != 0.0)
            .then(|| Self { origin: a, rows: [across * inverse, w.cross(u) * inverse, u.cross(v) * inverse] })
    }

    /// The weights at a point (m); they sum to one.
    #[must_use]
    pub fn at(&self, point: Vec3A) -> [f32; 4] {
        let p = point - self.origin;
        let [w1, w2, w3] = self.rows.map(|row| row.dot(p));
        [1.0 - w1 - w2 - w3, w1, w2, w3]
    }

    /// The weights at a point if it is in the tetrahedron, its surface included.
    #[must_use]
    pub fn inside(&self, point: Vec3A) -> Option<[f32; 4]> {
        let w = self.at(point);
        ((w[0] >= 0.0) & (w[1] >= 0.0) & (w[2] >= 0.0) & (w[3] >= 0.0)).then_some(w)
    }

    /// Gradient of the weight of a corner, 1/m: points from the opposite face to the corner.
    #[must_use]
    pub fn gradient(&self, corner: usize) -> Vec3A {
        match corner {
            0 => -(self.rows[0] + self.rows[1] + self.rows[2]),
            i => self.rows[i - 1],
        }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;

    #[test]
    fn the_corners_of_a_tetrahedron_have_the_weights_of_corners_also_when_it_is_inverted() {
        let corners = [Vec3A::new(1.0, 2.0, 3.0), Vec3A::new(2.0, 2.0, 3.0), Vec3A::new(1.0, 4.0, 3.0), Vec3A::new(1.0, 2.0, 3.5)];
        for tet in [corners, [corners[1], corners[0], corners[2], corners[3]]] {
            let weights = Weights::of(tet).unwrap();
            for (i, corner) in tet.into_iter().enumerate() {
                assert_eq!(weights.at(corner), std::array::from_fn(|k| if i == k { 1.0 } else { 0.0 }));
                assert!((weights.gradient(i).dot(corner - tet[(i + 1) % 4]) - 1.0).abs() < 1e-6);
            }
            let middle = (tet[0] + tet[1] + tet[2] + tet[3]) / 4.0;
            assert!(weights.inside(middle).unwrap().iter().all(|w| (w - 0.25).abs() < 1e-6));
            assert!(weights.inside(middle + 2.0 * Vec3A::X).is_none());
        }
        assert!(Weights::of([corners[0], corners[1], corners[2], corners[1]]).is_none(), "flat");
        assert!(Weights::of([corners[0], corners[1], corners[2], Vec3A::splat(f32::NAN)]).is_none());
    }
}
