//! Instruments against the surface of tissue: convex parts that move rigidly over a tick, each against the triangles of the surface.
//!
//! Nodes alone would let a shaft slip between them, and a look at the end of the tick would let a fast one pass a flap unseen. A part that is near a
//! triangle when the tick begins touches it there; a further one is swept, turning as it goes, and touches it where and when it arrives. What comes
//! of either is the plane that the part pushes before it.

use crate::convert::{from_parry, pose_to_parry, to_parry};
use bevy_math::{Isometry3d, Vec3};
use parry3d::bounding_volume::BoundingVolume;
use parry3d::math::Pose;
use parry3d::query::{NonlinearRigidMotion, cast_shapes_nonlinear, contact};
use parry3d::shape::{SharedShape, Triangle};

/// Least cosine between the way that a part pushes and the way into the tissue through a triangle: 84 degrees.
const FACING: f32 = 0.1;

/// A convex part of an instrument, in a frame of its own.
#[derive(Clone)]
pub struct ToolPart {
    shape: SharedShape,
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

/// A part and a triangle of tissue that touch during a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Touch {
    /// Weights of the triangle's corners at the point that is touched; they sum to one.
    pub weights: [f32; 3],
    /// Unit vector from the part to the tissue.
    pub normal: Vec3,
    /// How far the tissue's point is behind the part's surface when the tick begins, m; negative while it is not yet touched.
    pub depth_m: f32,
    /// The part's point when the tick begins, m.
    pub surface_m: Vec3,
    /// Its mean velocity over the tick, m/s.
    pub velocity_m_s: Vec3,
}

impl ToolPart {
    /// A round bar between two points (m).
    #[must_use]
    pub fn capsule(a: Vec3, b: Vec3, radius_m: f32) -> Self {
        Self { shape: SharedShape::capsule(to_parry(a), to_parry(b), radius_m) }
    }

    /// The convex hull of points (m); `None` where they have none: fewer than four, or all in a plane.
    #[must_use]
    pub fn hull(points: &[Vec3]) -> Option<Self> {
        let points: Vec<_> = points.iter().map(|p| to_parry(*p)).collect();
        SharedShape::convex_hull(&points).map(|shape| Self { shape })
    }

    /// A box around all places where the part is during a tick, larger by `margin_m` all round: its lowest and highest corner, m.
    #[must_use]
    pub fn swept_box(&self, motion: &Motion, margin_m: f32) -> (Vec3, Vec3) {
        // On its way from pose to pose a point leaves the straight line by less than its arc is high.
        let (from, to) = (pose_to_parry(motion.from), pose_to_parry(motion.to));
        let turn = motion.from.rotation.angle_between(motion.to.rotation);
        let reach = self.reach_m();
        let bulge = reach * (1.0 - (0.5 * turn).cos());
        let swept = self.shape.compute_aabb(&from).merged(&self.shape.compute_aabb(&to)).loosened(margin_m + bulge);
        (from_parry(swept.mins), from_parry(swept.maxs))
    }

    /// Where the part touches a triangle of tissue (m, counter-clockwise from outside) that is taken to be at rest. A part within `near_m` of it when the
    /// tick begins touches it from where it is.
    #[must_use]
    pub fn touch(&self, motion: &Motion, triangle: [Vec3; 3], near_m: f32) -> Option<Touch> {
        let outward = (triangle[1] - triangle[0]).cross(triangle[2] - triangle[0]).try_normalize()?;
        let shape = Triangle::from(triangle.map(to_parry));
        let (from, to) = (pose_to_parry(motion.from), pose_to_parry(motion.to));
        let rest = Pose::default();
        let near = contact(&from, &*self.shape, &rest, &shape, near_m).ok().flatten();
        let (local, normal, touched) = match near {
            Some(near) => (from.inverse_transform_point(near.point1), from_parry(near.normal1), from_parry(near.point2)),
            None => {
                let turn = motion.to.rotation * motion.from.rotation.inverse();
                let moving = NonlinearRigidMotion {
                    start: from,
                    local_center: to_parry(Vec3::ZERO),
                    linvel: to_parry((motion.to.translation - motion.from.translation).into()),
                    angvel: to_parry(turn.to_scaled_axis()),
                };
                let still = NonlinearRigidMotion { angvel: to_parry(Vec3::ZERO), linvel: to_parry(Vec3::ZERO), start: rest, ..moving };
                let hit = cast_shapes_nonlinear(&moving, &*self.shape, &still, &shape, 0.0, 1.0, true).ok().flatten()?;
                let then = moving.position_at_time(hit.time_of_impact);
                (hit.witness1, from_parry(then.transform_vector(hit.normal1)), from_parry(hit.witness2))
            }
        };
        // A part behind a triangle, on its way out of the tissue, does not push it; of one that it grazes the neighbours tell better.
        if normal.dot(outward) > -FACING || !touched.is_finite() {
            return None;
        }
        let (begin, end) = (from_parry(from.transform_point(local)), from_parry(to.transform_point(local)));
        Some(Touch {
            weights: weights_in(triangle, touched)?,
            normal,
            depth_m: (begin - touched).dot(normal),
            surface_m: begin,
            velocity_m_s: (end - begin) / motion.dt_s,
        })
    }

    /// The furthest that any of the part's points is from the frame's origin, or further, m.
    fn reach_m(&self) -> f32 {
        let local = self.shape.compute_local_aabb();
        from_parry(local.mins).abs().max(from_parry(local.maxs).abs()).length()
    }
}

/// The weights of a triangle's corners at a point of it, none negative. `None` of a triangle without area.
fn weights_in([a, b, c]: [Vec3; 3], point: Vec3) -> Option<[f32; 3]> {
    let (u, v, p) = (b - a, c - a, point - a);
    let (uu, uv, vv) = (u.dot(u), u.dot(v), v.dot(v));
    let inverse = (uu * vv - uv * uv).recip();
    if !inverse.is_finite() {
        return None;
    }
    let w = [(vv * p.dot(u) - uv * p.dot(v)) * inverse, (uu * p.dot(v) - uv * p.dot(u)) * inverse];
    let clipped = [1.0 - w[0] - w[1], w[0], w[1]].map(|w| w.max(0.0));
    let sum: f32 = clipped.iter().sum();
    (sum > 0.0).then(|| clipped.map(|w| w / sum))
}
