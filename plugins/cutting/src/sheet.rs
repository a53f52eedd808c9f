//! The sheet: what the blade's cutting line sweeps in one step, as a strip of triangles in the rest shape, and where it crosses edges
//! and pierces faces.
//!
//! Two strips share the line between them point for point, and every decision is an exact sign, taken with the points in an order that
//! both triangles at a shared edge agree on. So an edge that the sheet crosses is crossed by exactly one triangle of it. Edges and faces are looked at
//! with their corners in the order of their places, so that those which lie on each other, on the lips of a cut, are met alike to the last bit.

use keyhole_tetmesh::DVec3;
use smallvec::SmallVec;
use std::cmp::Ordering;

/// The smallest barycentric weight of a point on a face, and the smallest parameter of a crossing from its end: cut points slide along
/// the edge that far rather than make a sliver. The same for all methods, so that they end in the same mesh.
pub const CLEARANCE: f64 = 0.05;

/// Exact sign of the volume of a, b, c, d: +1 when positive or zero, -1 when negative.
fn sign(a: DVec3, b: DVec3, c: DVec3, d: DVec3) -> i8 {
    let r = |v: DVec3| robust::Coord3D { x: v.x, y: v.y, z: v.z };
    if robust::orient3d(r(a), r(b), r(c), r(d)) > 0.0 { -1 } else { 1 }
}

/// An axis-aligned box.
#[derive(Clone, Copy, Debug)]
pub struct Aabb {
    min: DVec3,
    max: DVec3,
}

impl Aabb {
    /// The box of some points.
    #[must_use]
    pub fn of(points: &[DVec3]) -> Self {
        points.iter().fold(Self { min: DVec3::INFINITY, max: DVec3::NEG_INFINITY }, |b, p| Self { min: b.min.min(*p), max: b.max.max(*p) })
    }

    /// Whether a point is in the box, its border included.
    #[must_use]
    pub fn holds(&self, p: DVec3) -> bool {
        self.overlaps(&Self { min: p, max: p })
    }

    /// Whether two boxes overlap or touch.
    #[must_use]
    pub fn overlaps(&self, other: &Self) -> bool {
        self.min.x <= other.max.x
            && self.min.y <= other.max.y
            && self.min.z <= other.max.z
            && other.min.x <= self.max.x
            && other.min.y <= self.max.y
            && other.min.z <= self.max.z
    }
}

/// Where the sheet crosses an edge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Parameter from the first point given to the second, in [0, 1].
    pub t: f64,
    /// The side of the sheet that the first point lies on: +1 or -1.
    pub side: i8,
    /// Distances of the two points from the plane of the sheet where it is crossed, m.
    pub away: [f64; 2],
}

impl Hit {
    /// The same, from the second point to the first.
    fn turned(self) -> Self {
        let [p, q] = self.away;
        Self { t: 1.0 - self.t, side: -self.side, away: [q, p] }
    }
}

/// One step of the sheet: from the line `before` to the line `now`, which have the same number of points, tip first.
#[derive(Clone, Debug)]
pub struct Strip {
    points: Vec<DVec3>,
    half: usize,
    triangles: Vec<[usize; 3]>,
    boxes: Vec<Aabb>,
    /// By triangle: the box of its [`Strip::rail`].
    rails: Vec<Aabb>,
    bounds: Aabb,
}

impl Strip {
    /// The strip between two lines.
    ///
    /// # Panics
    /// When they differ in their number of points or have fewer than two.
    #[must_use]
    pub fn between(before: &[DVec3], now: &[DVec3]) -> Self {
        assert!(before.len() == now.len() && now.len() >= 2, "both blade lines need the same number of points, two at least");
        let half = now.len();
        let points: Vec<DVec3> = before.iter().chain(now).copied().collect();
        let mut triangles = Vec::with_capacity(2 * half);
        for j in 0..half - 1 {
            triangles.push([j, j + 1, half + j]);
            triangles.push([j + 1, half + j + 1, half + j]);
        }
        let boxes = triangles.iter().map(|t| Aabb::of(&t.map(|i| points[i]))).collect();
        let rails = (0..triangles.len()).map(|i| Aabb::of(&Self::rail_of(i, triangles[i]).map(|j| points[j]))).collect();
        let bounds = Aabb::of(&points);
        Self { points, half, triangles, boxes, rails, bounds }
    }

    /// The present line.
    #[must_use]
    pub fn now(&self) -> &[DVec3] {
        &self.points[self.half..]
    }

    /// The four corners of the strip between points `j` and `j + 1` of the line.
    #[must_use]
    pub fn quad(&self, j: usize) -> [DVec3; 4] {
        [j, j + 1, self.half + j, self.half + j + 1].map(|i| self.points[i])
    }

    /// Whether the line has not moved at all.
    #[must_use]
    pub fn is_still(&self) -> bool {
        self.points[..self.half] == self.points[self.half..]
    }

    /// The triangles whose box overlaps `region`.
    pub fn near(&self, region: &Aabb, found: &mut Vec<usize>) {
        found.clear();
        if !self.bounds.overlaps(region) {
            return;
        }
        found.extend((0..self.triangles.len()).filter(|&i| self.boxes[i].overlaps(region)));
    }

    /// The corners of a triangle.
    #[must_use]
    pub fn corners(&self, triangle: usize) -> [DVec3; 3] {
        self.triangles[triangle].map(|i| self.points[i])
    }

    /// Where the segment from `p` to `q` crosses the given triangles.
    pub fn crossings(&self, p: DVec3, q: DVec3, triangles: &[usize], hits: &mut Vec<Hit>) {
        let bounds = Aabb::of(&[p, q]);
        let turned = by_place(&p, &q).is_gt();
        let [first, second] = if turned { [q, p] } else { [p, q] };
        for &i in triangles {
            if self.boxes[i].overlaps(&bounds)
                && let Some(hit) = self.crossing(first, second, self.triangles[i])
            {
                hits.push(if turned { hit.turned() } else { hit });
            }
        }
    }

    fn crossing(&self, p: DVec3, q: DVec3, triangle: [usize; 3]) -> Option<Hit> {
        let [a, b, c] = triangle.map(|i| self.points[i]);
        let (sp, sq) = (sign(a, b, c, p), sign(a, b, c, q));
        if sp == sq {
            return None;
        }
        let side = |i: usize, j: usize| {
            if i < j { sign(p, q, self.points[i], self.points[j]) } else { -sign(p, q, self.points[j], self.points[i]) }
        };
        let [i, j, k] = triangle;
        let first = side(i, j);
        if side(j, k) != first || side(k, i) != first {
            return None;
        }
        let n = (b - a).cross(c - a);
        let (dp, dq) = (n.dot(p - a).abs(), n.dot(q - a).abs());
        let t = in_steps(if dp + dq > 0.0 { dp / (dp + dq) } else { 0.5 });
        let length = n.length();
        let away = if length > 0.0 { [dp / length, dq / length] } else { [t, 1.0 - t].map(|s| s * p.distance(q)) };
        Some(Hit { t, side: sp, away })
    }

    /// Distance of a point from the given triangles, m.
    #[must_use]
    pub fn distance(&self, p: DVec3, triangles: &[usize]) -> f64 {
        triangles.iter().map(|&i| distance_to_triangle(p, self.corners(i))).fold(f64::INFINITY, f64::min)
    }

    /// Where the segment that a triangle has on one of the two lines goes through a face with the given box.
    #[must_use]
    pub fn rail_through(&self, triangle: usize, face: [DVec3; 3], bounds: &Aabb) -> Option<[f64; 3]> {
        if !self.rails[triangle].overlaps(bounds) {
            return None;
        }
        let [p, q] = Self::rail_of(triangle, self.triangles[triangle]).map(|i| self.points[i]);
        pierce(face, p, q)
    }

    /// Whether the segment that a triangle has on one of the two lines is on the present one.
    #[must_use]
    pub fn is_rail_now(triangle: usize) -> bool {
        !triangle.is_multiple_of(2)
    }

    fn rail_of(triangle: usize, [i, j, k]: [usize; 3]) -> [usize; 2] {
        if Self::is_rail_now(triangle) { [k, j] } else { [i, j] }
    }

    /// The paths of tip and heel in this step.
    #[must_use]
    pub fn ends(&self) -> [[DVec3; 2]; 2] {
        let last = self.half - 1;
        [[self.points[0], self.points[self.half]], [self.points[last], self.points[self.half + last]]]
    }

    /// Area of the strip inside a tetrahedron, m2, over the given triangles.
    #[must_use]
    pub fn area_inside(&self, tet: [DVec3; 4], triangles: &[usize]) -> f64 {
        let planes = keyhole_tetmesh::FACES.map(|[i, j, k]| Plane { point: tet[i], normal: (tet[j] - tet[i]).cross(tet[k] - tet[i]) });
        triangles.iter().map(|&i| clipped_area(self.corners(i), &planes)).sum()
    }
}

/// Where the segment from `p` to `q` pierces the triangle: barycentric weights of its corners.
#[must_use]
pub fn pierce(face: [DVec3; 3], p: DVec3, q: DVec3) -> Option<[f64; 3]> {
    let mut order = [0, 1, 2];
    order.sort_by(|i, j| by_place(&face[*i], &face[*j]));
    let [a, b, c] = order.map(|i| face[i]);
    if sign(a, b, c, p) == sign(a, b, c, q) {
        return None;
    }
    let volume = |u: DVec3, v: DVec3| (q - p).dot((u - p).cross(v - p));
    let s = [sign(p, q, b, c), sign(p, q, c, a), sign(p, q, a, b)];
    if s[0] != s[1] || s[1] != s[2] {
        return None;
    }
    let mut w = [0.0; 3];
    for (corner, volume) in order.into_iter().zip([volume(b, c), volume(c, a), volume(a, b)]) {
        w[corner] = volume.abs();
    }
    let sum = sum_of(w);
    (sum > 0.0).then(|| w.map(|x| x / sum))
}

/// The point of a face with the given weights of its corners.
#[must_use]
pub fn weighted(face: [DVec3; 3], w: [f64; 3]) -> DVec3 {
    let [a, b, c] = [0, 1, 2].map(|i| face[i] * w[i]);
    DVec3::new(sum_of([a.x, b.x, c.x]), sum_of([a.y, b.y, c.y]), sum_of([a.z, b.z, c.z]))
}

/// The sum of three numbers, the same in whatever order they are given.
fn sum_of(mut terms: [f64; 3]) -> f64 {
    terms.sort_by(f64::total_cmp);
    terms[0] + terms[1] + terms[2]
}

/// A parameter in [0, 1] in steps so fine that nothing is lost and `1 - t` is exact: seen from the other end of its edge it is the same point.
#[must_use]
pub fn in_steps(t: f64) -> f64 {
    const STEPS: f64 = (1_u64 << 52) as f64;
    (t * STEPS).round() / STEPS
}

/// An order of points that does not depend on what they are called.
fn by_place(a: &DVec3, b: &DVec3) -> Ordering {
    a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)).then(a.z.total_cmp(&b.z))
}

/// Barycentric weights moved inside by [`CLEARANCE`].
#[must_use]
pub fn clear_of_border(w: [f64; 3]) -> [f64; 3] {
    let w = w.map(|x| x.max(CLEARANCE));
    let sum = sum_of(w);
    w.map(|x| x / sum)
}

/// Whether a point lies in a positive tetrahedron, its border included.
#[must_use]
pub fn contains(tet: [DVec3; 4], p: DVec3) -> bool {
    keyhole_tetmesh::FACES.iter().all(|&[i, j, k]| sign(tet[i], tet[j], tet[k], p) < 0 || on_plane(tet[i], tet[j], tet[k], p))
}

fn on_plane(a: DVec3, b: DVec3, c: DVec3, d: DVec3) -> bool {
    let r = |v: DVec3| robust::Coord3D { x: v.x, y: v.y, z: v.z };
    robust::orient3d(r(a), r(b), r(c), r(d)) == 0.0
}

/// Distance of a point from a triangle, m.
fn distance_to_triangle(p: DVec3, [a, b, c]: [DVec3; 3]) -> f64 {
    let n = (b - a).cross(c - a);
    let sides = [(a, b), (b, c), (c, a)];
    if n != DVec3::ZERO && sides.iter().all(|&(u, v)| n.dot((v - u).cross(p - u)) >= 0.0) {
        return n.dot(p - a).abs() / n.length();
    }
    let to_side = |&(u, v): &(DVec3, DVec3)| {
        let along = v - u;
        let s = if along == DVec3::ZERO { 0.0 } else { ((p - u).dot(along) / along.length_squared()).clamp(0.0, 1.0) };
        p.distance(u + along * s)
    };
    sides.iter().map(to_side).fold(f64::INFINITY, f64::min)
}

/// The plane of a face, its normal out of the tetrahedron.
struct Plane {
    point: DVec3,
    normal: DVec3,
}

impl Plane {
    /// Positive beyond the plane.
    fn height(&self, p: DVec3) -> f64 {
        self.normal.dot(p - self.point)
    }
}

/// Area of a triangle inside a positive tetrahedron, by clipping (Sutherland & Hodgman 1974).
fn clipped_area(triangle: [DVec3; 3], planes: &[Plane; 4]) -> f64 {
    // Most triangles are wholly beyond one face or inside all four.
    let mut crossed: SmallVec<[&Plane; 4]> = SmallVec::new();
    for plane in planes {
        match triangle.iter().filter(|p| plane.height(**p) > 0.0).count() {
            0 => {}
            3 => return 0.0,
            _ => crossed.push(plane),
        }
    }
    if crossed.is_empty() {
        return (triangle[1] - triangle[0]).cross(triangle[2] - triangle[0]).length() / 2.0;
    }
    let mut polygon: SmallVec<[DVec3; 8]> = triangle.into_iter().collect();
    for plane in crossed {
        let mut kept: SmallVec<[DVec3; 8]> = SmallVec::new();
        let Some(&last) = polygon.last() else { return 0.0 };
        let (mut p, mut hp) = (last, plane.height(last));
        for &q in &polygon {
            let hq = plane.height(q);
            if (hp < 0.0 && hq > 0.0) || (hp > 0.0 && hq < 0.0) {
                kept.push(p + (q - p) * (hp / (hp - hq)));
            }
            if hq <= 0.0 {
                kept.push(q);
            }
            (p, hp) = (q, hq);
        }
        polygon = kept;
        if polygon.len() < 3 {
            return 0.0;
        }
    }
    let fan = (1..polygon.len() - 1).map(|m| (polygon[m] - polygon[0]).cross(polygon[m + 1] - polygon[0]));
    fan.fold(DVec3::ZERO, |sum, n| sum + n).length() / 2.0
}
