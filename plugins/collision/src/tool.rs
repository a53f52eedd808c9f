//! Rigid, convex parts of instruments: their shapes, how they move over a tick, and the line through the middle of each.

use crate::convert::{MM, direction_from_parry, from_parry, pose_to_parry, to_parry};
use bevy_math::{Isometry3d, Quat, Vec3};
use parry3d::bounding_volume::BoundingVolume;
use parry3d::math::Pose;
use parry3d::query::{contact, distance};
use parry3d::shape::{Shape, SharedShape};

/// Most points along the middle of a part.
const SPINE: usize = 128;

/// Powers of a covariance after which the longest of three axes stands out.
const POWERS: usize = 32;

/// A convex part of an instrument, in a frame of its own.
#[derive(Clone)]
pub struct ToolPart {
    /// What the part is but for its skin: of a round bar the line in its middle, so that what is near or a little inside still has a clear direction.
    core: SharedShape,
    skin_m: f32,
    spine: Vec<Vec3>,
    radius_m: f32,
    /// Radius of a bar about the spine with all of the part in it, m.
    bar_m: f32,
}

/// Where a part is at the beginning and at the end of a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// At the beginning.
    pub from: Isometry3d,
    /// At the end.
    pub to: Isometry3d,
    /// Length of the tick, s.
    pub dt_s: f32,
}

impl Motion {
    /// No motion.
    #[must_use]
    pub fn still(at: Isometry3d, dt_s: f32) -> Self {
        Self { from: at, to: at, dt_s }
    }

    /// The pose at a part of the tick, 0 to 1: the origin goes straight, the frame turns evenly about it.
    #[must_use]
    pub fn at(&self, part: f32) -> Isometry3d {
        let turn = (self.to.rotation * self.from.rotation.inverse()).to_scaled_axis();
        let rotation = Quat::from_scaled_axis(part * turn) * self.from.rotation;
        Isometry3d::new(self.from.translation + (self.to.translation - self.from.translation) * part, rotation)
    }

    pub(crate) fn pose(&self, part: f32) -> Pose {
        pose_to_parry(self.at(part))
    }

    /// The furthest that a point not further than `reach_m` from the frame's origin goes in a tick, or further, m.
    #[must_use]
    pub fn way_m(&self, reach_m: f32) -> f32 {
        Vec3::from(self.to.translation - self.from.translation).length() + reach_m * self.from.rotation.angle_between(self.to.rotation)
    }

    /// How a point of the world that goes with the frame moves, from where it is when the tick begins, m/s.
    #[must_use]
    pub fn velocity_of(&self, begin: Vec3) -> Vec3 {
        (self.to * (self.from.inverse() * begin) - begin) / self.dt_s
    }
}

impl ToolPart {
    /// A round bar between two points (m).
    #[must_use]
    pub fn capsule(a: Vec3, b: Vec3, radius_m: f32) -> Self {
        let core = SharedShape::segment(to_parry(a), to_parry(b));
        Self { core, skin_m: radius_m, spine: line(a, b, radius_m), radius_m, bar_m: radius_m }
    }

    /// The convex hull of points (m); `None` where they have none: fewer than four, or all in a plane.
    #[must_use]
    pub fn hull(points: &[Vec3]) -> Option<Self> {
        let middle = points.iter().sum::<Vec3>() / points.len() as f32;
        let farthest = |measure: &dyn Fn(Vec3) -> f32| points.iter().copied().max_by(|a, b| measure(*a).total_cmp(&measure(*b)));
        // The axis along which they are spread most: powers of their covariance.
        let mut along = farthest(&|p| p.distance_squared(middle))? - middle;
        for _ in 0..POWERS {
            along = points.iter().map(|p| (*p - middle) * (*p - middle).dot(along)).sum::<Vec3>().try_normalize()?;
        }
        let broad = farthest(&|p| (p - middle).reject_from_normalized(along).length_squared())?;
        let broad = (broad - middle).reject_from_normalized(along).try_normalize()?;
        let extent = |way: Vec3| {
            let all = points.iter().map(|p| (*p - middle).dot(way));
            all.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)))
        };
        // Half as thick as the part is where it is thinnest.
        let across = [broad, along.cross(broad)].map(extent);
        let radius_m = across.iter().map(|(low, high)| 0.5 * (high - low)).fold(f32::INFINITY, f32::min);
        let centre = middle + 0.5 * ((across[0].0 + across[0].1) * broad + (across[1].0 + across[1].1) * along.cross(broad));
        let (low, high) = extent(along);
        let ends = [low + radius_m, high - radius_m].map(|s| if high - low > 2.0 * radius_m { s } else { 0.5 * (low + high) });
        let [a, b] = ends.map(|s| centre + s * along);
        let bar_m = points.iter().map(|p| from_segment(a, b, *p)).fold(0.0, f32::max);
        let points: Vec<_> = points.iter().map(|p| to_parry(*p)).collect();
        let core = SharedShape::convex_hull(&points)?;
        Some(Self { core, skin_m: 0.0, spine: line(a, b, radius_m), radius_m, bar_m })
    }

    /// Points along its middle, not further from each other than half of its thickness unless it is very long, m.
    #[must_use]
    pub fn spine(&self) -> &[Vec3] {
        &self.spine
    }

    /// From the spine to its surface where it is thinnest, m.
    #[must_use]
    pub fn radius_m(&self) -> f32 {
        self.radius_m
    }

    /// A box around all places where the part is during a tick, larger by `margin_m` all round: its lowest and highest corner, m.
    #[must_use]
    pub fn swept_box(&self, motion: &Motion, margin_m: f32) -> (Vec3, Vec3) {
        // On its way from pose to pose a point leaves the straight line by less than its arc is high.
        let (from, to) = (pose_to_parry(motion.from), pose_to_parry(motion.to));
        let turn = motion.from.rotation.angle_between(motion.to.rotation);
        let reach = self.reach_m();
        let bulge = reach * (1.0 - (0.5 * turn).cos());
        let swept = self.core.compute_aabb(&from).merged(&self.core.compute_aabb(&to)).loosened((margin_m + self.skin_m + bulge) * MM);
        (from_parry(swept.mins), from_parry(swept.maxs))
    }

    /// A bar with all places in it where the part is during a tick.
    #[must_use]
    pub fn swept_bar(&self, motion: &Motion) -> SweptBar {
        let (first, last) = (self.spine[0], self.spine[self.spine.len() - 1]);
        SweptBar { ends: [first, last].map(|p| motion.from * p), radius_m: self.bar_m + motion.way_m(self.reach_m()) }
    }

    /// The furthest that any of the part's points is from the frame's origin, or further, m.
    #[must_use]
    pub fn reach_m(&self) -> f32 {
        let local = self.core.compute_local_aabb();
        from_parry(local.mins).abs().max(from_parry(local.maxs).abs()).length() + self.skin_m
    }
}

/// A round bar around all that a part may touch during a tick: a box around a long part that lies askew is mostly empty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SweptBar {
    ends: [Vec3; 2],
    radius_m: f32,
}

impl SweptBar {
    /// Whether a triangle (m) that goes to `then` during the tick is further off than `near_m` all the time. What is not finite does not miss it.
    #[must_use]
    pub fn misses(&self, triangle: [Vec3; 3], then: [Vec3; 3], near_m: f32) -> bool {
        let middle = (triangle[0] + triangle[1] + triangle[2]) / 3.0;
        let around = triangle.iter().map(|p| p.distance(middle)).fold(0.0, f32::max);
        let way = (0..3).map(|i| triangle[i].distance(then[i])).fold(0.0, f32::max);
        // A little more than what is near: as in the touch itself, distances are not all computed alike.
        from_segment(self.ends[0], self.ends[1], middle) > self.radius_m + around + way + 2.0 * near_m
    }
}

/// Distance of a point from the line from `a` to `b`, m.
fn from_segment(a: Vec3, b: Vec3, point: Vec3) -> f32 {
    let along = b - a;
    let length = along.length_squared();
    let part = if length > 0.0 { ((point - a).dot(along) / length).clamp(0.0, 1.0) } else { 0.0 };
    point.distance(a + part * along)
}

/// Two points at which convex things are nearest, or deepest in each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Facing {
    /// On the first, m.
    pub(crate) first: Vec3,
    /// On the second, m.
    pub(crate) second: Vec3,
    /// Unit vector from the first to the second.
    pub(crate) normal: Vec3,
}

/// Something convex with a skin of even thickness.
#[derive(Clone, Copy)]
pub(crate) struct Skinned<'a> {
    pub(crate) core: &'a dyn Shape,
    pub(crate) skin_m: f32,
}

impl ToolPart {
    pub(crate) fn skinned(&self) -> Skinned<'_> {
        Skinned { core: &*self.core, skin_m: self.skin_m }
    }
}

impl<'a> Skinned<'a> {
    /// Without a skin.
    pub(crate) fn bare(core: &'a dyn Shape) -> Self {
        Self { core, skin_m: 0.0 }
    }

    /// The distance between two things, m; zero or less where their skins meet. `None` where it cannot be told.
    pub(crate) fn distance_m(self, at: &Pose, other: Self, other_at: &Pose) -> Option<f32> {
        let cores = distance(at, self.core, other_at, other.core).ok()?.distance / MM;
        Some(cores - self.skin_m - other.skin_m)
    }

    /// Where two things are nearest, if they are not further apart than `within_m`.
    pub(crate) fn facing(self, at: &Pose, other: Self, other_at: &Pose, within_m: f32) -> Option<Facing> {
        let met = contact(at, self.core, other_at, other.core, (within_m + self.skin_m + other.skin_m) * MM).ok().flatten()?;
        let (normal, first, second) = (direction_from_parry(met.normal1), from_parry(met.point1), from_parry(met.point2));
        let found = Facing { first: first + self.skin_m * normal, second: second - other.skin_m * normal, normal };
        (first + second + normal).is_finite().then_some(found)
    }
}

/// Points from `a` to `b`, both included, not further apart than `step_m` while they are not more than [`SPINE`].
fn line(a: Vec3, b: Vec3, step_m: f32) -> Vec<Vec3> {
    let steps = (a.distance(b) / step_m).ceil().clamp(0.0, (SPINE - 1) as f32) as usize;
    (0..=steps).map(|i| a.lerp(b, i as f32 / steps.max(1) as f32)).collect()
}
