//! Instruments against what is as hard as they are: each other, and solid anatomy. What comes of it is where a part stands at the end of the tick: on
//! which side of the other's surface it belongs, and by how much it is not there.

use crate::anatomy::SolidSurface;
use crate::convert::to_parry;
use crate::sweep::first_touch;
use crate::tool::{Facing, Motion, Skinned, ToolPart};
use bevy_math::{Isometry3d, Vec3};
use parry3d::shape::Triangle;

/// Least cosine between a triangle's normal and the way that it pushes a part.
const FACING: f32 = 0.1;
/// Least cosine between the directions at the beginning and at the end of a tick at which nothing has passed through the other.
const SAME_SIDE: f32 = 0.5;
/// Cosine above which two contacts near each other are one.
const ALIKE: f32 = 0.98;
/// Most contacts of a part with a surface.
const MOST: usize = 8;
/// How near is touching, of things that come from further away, as a part of the margin.
const TOUCHING: f32 = 0.01;

/// Where a part of an instrument is against something hard, at the end of the tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Meeting {
    /// The part's point, m.
    pub point: Vec3,
    /// Unit vector from the other thing to the part.
    pub normal: Vec3,
    /// How far the part is in the other, m; negative while it is still away from it.
    pub depth_m: f32,
}

impl Meeting {
    /// As the other part sees it.
    #[must_use]
    pub fn mirrored(self) -> Self {
        Self { point: self.point + self.normal * self.depth_m, normal: -self.normal, depth_m: self.depth_m }
    }
}

/// Something convex that moves, and how far its points are from the origin of its frame.
#[derive(Clone, Copy)]
struct Mover<'a> {
    shape: Skinned<'a>,
    motion: &'a Motion,
    reach_m: f32,
}

impl Mover<'_> {
    /// Where a point of the world that goes with it is at the end, if it is here at a part of the tick.
    fn carry(&self, point: Vec3, part: f32) -> Vec3 {
        self.motion.to * (self.motion.at(part).inverse() * point)
    }
}

/// Where a part is against a part of another instrument, if they come nearer than `margin_m`.
#[must_use]
pub fn part_against_part(a: (&ToolPart, &Motion), b: (&ToolPart, &Motion), margin_m: f32) -> Option<Meeting> {
    let ((low, high), (other_low, other_high)) = (a.0.swept_box(a.1, margin_m), b.0.swept_box(b.1, 0.0));
    if low.cmpgt(other_high).any() || high.cmplt(other_low).any() {
        return None;
    }
    let [a, b] = [a, b].map(|(part, motion)| Mover { shape: part.skinned(), motion, reach_m: part.reach_m() });
    meet(a, b, margin_m, |_, normal| normal)
}

/// Where a part is against a surface, if it comes nearer than `margin_m`; of contacts next to each other the deepest. A part is led out from not deeper
/// than `reach_m`.
pub fn part_against_surface(part: &ToolPart, motion: &Motion, surface: &SolidSurface, margin_m: f32, reach_m: f32) -> Vec<Meeting> {
    let (low, high) = part.swept_box(motion, margin_m);
    let own = Mover { shape: part.skinned(), motion, reach_m: part.reach_m() };
    let rest = Motion::still(Isometry3d::IDENTITY, motion.dt_s);
    // Of two triangles that a part is near, each at their edge, one is in the other's way; the surface as a whole tells which way is out.
    let side = |point: Vec3, normal: Vec3| {
        let nearest = surface.nearest(point, reach_m.max(margin_m)).filter(|n| n.normal.dot(normal) > SAME_SIDE);
        nearest.map_or(normal, |n| n.normal)
    };
    let mut found = Vec::new();
    for corners in surface.triangles_in(low, high) {
        let Some(outward) = (corners[1] - corners[0]).cross(corners[2] - corners[0]).try_normalize() else { continue };
        let triangle = Triangle::from(corners.map(to_parry));
        let met = meet(own, Mover { shape: Skinned::bare(&triangle), motion: &rest, reach_m: 0.0 }, margin_m, side);
        found.extend(met.filter(|m| m.normal.dot(outward) > FACING));
    }
    // Where nothing tells from which side the part came, its middle goes the shortest way.
    let lost = !found.iter().any(|m| m.depth_m > 0.0);
    for local in part.spine().iter().filter(|_| lost) {
        let at = motion.to * *local;
        if let Some(nearest) = surface.nearest(at, reach_m).filter(|n| n.distance_m < 0.0) {
            let point = at - nearest.normal * part.radius_m();
            found.push(Meeting { point, normal: nearest.normal, depth_m: part.radius_m() - nearest.distance_m });
        }
    }
    found.sort_by(|a, b| b.depth_m.total_cmp(&a.depth_m));
    let mut kept: Vec<Meeting> = Vec::new();
    for meeting in found {
        let alike = |k: &Meeting| k.normal.dot(meeting.normal) > ALIKE && k.point.distance(meeting.point) < 4.0 * part.radius_m();
        if kept.len() < MOST && !kept.iter().any(alike) {
            kept.push(meeting);
        }
    }
    kept
}

/// Two things that move, at the end of the tick. Where they have passed through each other, or the first would come out on another side of the second
/// than it went in, the side counts on which they touched first: `side` is asked for it, with the first's point then, and the way out there.
fn meet(a: Mover, b: Mover, margin_m: f32, side: impl Fn(Vec3, Vec3) -> Vec3) -> Option<Meeting> {
    let facing = |part: f32, within_m: f32| a.shape.facing(&a.motion.pose(part), b.shape, &b.motion.pose(part), within_m);
    let carried = |met: Facing, part: f32| {
        let (point, other) = (a.carry(met.first, part), b.carry(met.second, part));
        let normal = side(met.first, -met.normal);
        Meeting { point, normal, depth_m: (other - point).dot(normal) }
    };
    let end = facing(1.0, margin_m);
    let met = match (facing(0.0, margin_m), end) {
        (Some(begin), Some(end)) if begin.normal.dot(end.normal) > SAME_SIDE => carried(end, 1.0),
        (Some(begin), _) => carried(begin, 0.0),
        (None, _) => {
            let way_m = a.motion.way_m(a.reach_m) + b.motion.way_m(b.reach_m);
            let apart = |t: f32| a.shape.distance_m(&a.motion.pose(t), b.shape, &b.motion.pose(t));
            match first_touch(way_m, TOUCHING * margin_m, apart) {
                Some(part) => carried(facing(part, margin_m)?, part),
                None => carried(end?, 1.0),
            }
        }
    };
    (met.depth_m > -margin_m && met.point.is_finite()).then_some(met)
}
