//! Implicit shapes: functions that are about the distance to a surface in mm, negative inside, with a box around the inside.

use glam::{DQuat, DVec3};

/// A shape that can be sampled.
pub trait Shape: Sync + Send {
    /// About the distance to the surface, mm, negative inside: exact in sign.
    fn distance(&self, p: DVec3) -> f64;
    /// A box that holds the inside.
    fn bounds(&self) -> (DVec3, DVec3);
}

/// Smooth minimum (I. Quilez, polynomial): equal to `min` where the two differ by more than `k`.
#[must_use]
pub fn smooth_min(a: f64, b: f64, k: f64) -> f64 {
    let h = (k - (a - b).abs()).max(0.0) / k;
    a.min(b) - h * h * k / 4.0
}

/// An ellipsoid, turned.
#[derive(Clone, Copy, Debug)]
pub struct Ellipsoid {
    /// Centre, mm.
    pub centre: DVec3,
    /// Half axes, mm.
    pub radii: DVec3,
    /// From its own axes to the patient's.
    pub turn: DQuat,
}

impl Ellipsoid {
    /// With its axes along the patient's.
    #[must_use]
    pub fn new(centre: DVec3, radii: DVec3) -> Self {
        Self { centre, radii, turn: DQuat::IDENTITY }
    }
}

impl Shape for Ellipsoid {
    fn distance(&self, p: DVec3) -> f64 {
        let q = self.turn.inverse() * (p - self.centre);
        let (unit, gradient) = ((q / self.radii).length(), (q / (self.radii * self.radii)).length());
        // First-order distance; at the centre the gradient is no help.
        if gradient > 0.0 { unit * (unit - 1.0) / gradient } else { -self.radii.min_element() }
    }

    fn bounds(&self) -> (DVec3, DVec3) {
        let r = DVec3::splat(self.radii.max_element());
        (self.centre - r, self.centre + r)
    }
}

/// A chain of round cones through points, each with its radius: vessels, ribs.
#[derive(Clone, Debug, Default)]
pub struct Tube {
    /// Centre and radius, mm.
    pub points: Vec<(DVec3, f64)>,
}

impl Tube {
    /// A smooth tube through control points: centripetal-free Catmull-Rom, `steps` pieces between two of them.
    #[must_use]
    pub fn through(control: &[(DVec3, f64)], steps: usize) -> Self {
        let mut points = Vec::new();
        for i in 0..control.len().saturating_sub(1) {
            let at = |k: isize| control[(i as isize + k).clamp(0, control.len() as isize - 1) as usize];
            let (p0, p1, p2, p3) = (at(-1), at(0), at(1), at(2));
            for s in 0..steps {
                let t = s as f64 / steps as f64;
                let spline = (p1.0 * 2.0
                    + (p2.0 - p0.0) * t
                    + (p0.0 * 2.0 - p1.0 * 5.0 + p2.0 * 4.0 - p3.0) * t * t
                    + (p1.0 * 3.0 - p0.0 - p2.0 * 3.0 + p3.0) * t * t * t)
                    / 2.0;
                points.push((spline, p1.1 + (p2.1 - p1.1) * t));
            }
        }
        points.extend(control.last());
        Self { points }
    }
}

impl Shape for Tube {
    fn distance(&self, p: DVec3) -> f64 {
        let mut best = f64::INFINITY;
        for pair in self.points.windows(2) {
            let [(a, ra), (b, rb)] = [pair[0], pair[1]];
            let ab = b - a;
            let t = ((p - a).dot(ab) / ab.length_squared()).clamp(0.0, 1.0);
            best = best.min(p.distance(a + ab * t) - (ra + (rb - ra) * t));
        }
        best
    }

    fn bounds(&self) -> (DVec3, DVec3) {
        self.points.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), (p, r)| (low.min(*p - *r), high.max(*p + *r)))
    }
}

/// Several shapes as one, blended where they are closer than `blend` mm.
pub struct Union {
    shapes: Vec<(Box<dyn Shape>, DVec3, DVec3)>,
    blend: f64,
}

impl Union {
    /// Of these shapes.
    #[must_use]
    pub fn new(shapes: Vec<Box<dyn Shape>>, blend: f64) -> Self {
        let boxed = shapes.into_iter().map(|s| {
            let (low, high) = s.bounds();
            (s, low, high)
        });
        Self { shapes: boxed.collect(), blend }
    }
}

impl Shape for Union {
    fn distance(&self, p: DVec3) -> f64 {
        let mut best = f64::INFINITY;
        for (shape, low, high) in &self.shapes {
            // A shape whose box is further away than the best by the blend changes nothing.
            let away = p.distance_squared(p.clamp(*low, *high));
            if best.is_infinite() {
                best = shape.distance(p);
            } else if away < (best + self.blend).max(0.0).powi(2) || away == 0.0 {
                best = smooth_min(best, shape.distance(p), self.blend);
            }
        }
        best
    }

    fn bounds(&self) -> (DVec3, DVec3) {
        let room = DVec3::splat(self.blend);
        let all = self.shapes.iter().map(|(_, a, b)| (*a, *b));
        all.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), (a, b)| (low.min(a - room), high.max(b + room)))
    }
}

/// One shape without another.
pub struct Difference<A, B> {
    /// What is kept.
    pub of: A,
    /// What is taken away.
    pub without: B,
    /// Width of the rounded edge, mm.
    pub blend: f64,
}

impl<A: Shape, B: Shape> Shape for Difference<A, B> {
    fn distance(&self, p: DVec3) -> f64 {
        -smooth_min(-self.of.distance(p), self.without.distance(p), self.blend)
    }

    fn bounds(&self) -> (DVec3, DVec3) {
        self.of.bounds()
    }
}

/// A kidney: an ellipsoid bent so that its poles lean to the spine, with the hilum hollowed out of its inner border.
#[derive(Clone, Copy, Debug)]
pub struct Kidney {
    /// Centre, mm.
    pub centre: DVec3,
    /// Half axes: across, front to back, along, mm.
    pub radii: DVec3,
    /// 1 when the inner border looks to the patient's left (a right kidney), -1 when to the right.
    pub medial: f64,
    /// Sideways shift of the poles, mm.
    pub bend: f64,
}

impl Kidney {
    /// From the patient's frame to that of the straight ellipsoid.
    fn straight(&self, p: DVec3) -> DVec3 {
        let q = p - self.centre;
        // The upper pole leans to the spine and backwards.
        let lean = DQuat::from_rotation_y(self.medial * 0.16) * DQuat::from_rotation_x(0.10);
        let q = lean.inverse() * q;
        let t = q.z / self.radii.z;
        DVec3::new(q.x - self.medial * self.bend * t * t, q.y, q.z)
    }

    /// The middle of the hilum, mm.
    #[must_use]
    pub fn hilum(&self) -> DVec3 {
        self.centre + DVec3::new(self.medial * self.radii.x * 0.75, 0.0, 0.0)
    }
}

impl Shape for Kidney {
    fn distance(&self, p: DVec3) -> f64 {
        let q = self.straight(p);
        let body = Ellipsoid::new(DVec3::ZERO, self.radii).distance(q);
        let mouth = DVec3::new(self.medial * self.radii.x * 1.05, 0.0, 0.0);
        let sinus = Ellipsoid::new(mouth, DVec3::new(0.62 * self.radii.x, 0.36 * self.radii.y, 0.30 * self.radii.z)).distance(q);
        -smooth_min(-body, sinus, 5.0)
    }

    fn bounds(&self) -> (DVec3, DVec3) {
        let r = self.radii * 1.15 + DVec3::splat(self.bend + 4.0);
        (self.centre - r, self.centre + r)
    }
}
