//! Instruments against the surface of tissue: convex parts that move rigidly over a tick, each against the triangles of the surface.
//!
//! Nodes alone would let a shaft slip between them, and a look at the end of the tick would let a fast one pass a flap unseen. A part that is near a
//! triangle when the tick begins touches it there; a further one is swept, turning as it goes, against the triangle that moves on as it does, and
//! touches it where and when they meet. What comes of either is the plane that the part pushes before it.

use crate::convert::to_parry;
use crate::sweep::first_touch;
use crate::tool::{Motion, Skinned, ToolPart};
use bevy_math::Vec3;
use parry3d::math::Pose;
use parry3d::shape::Triangle;

/// Least cosine between the way that a part pushes and the way into the tissue through a triangle: 84 degrees.
const FACING: f32 = 0.1;

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
    /// Where the part touches a triangle of tissue (m, counter-clockwise from outside) that goes from `triangle` to `then` during the tick. A part within
    /// `near_m` of it when the tick begins touches it from where it is.
    #[must_use]
    pub fn touch(&self, motion: &Motion, triangle: [Vec3; 3], then: [Vec3; 3], near_m: f32) -> Option<Touch> {
        let rest = Pose::default();
        let at = |part: f32| std::array::from_fn(|i| triangle[i].lerp(then[i], part));
        let shape = |corners: [Vec3; 3]| Triangle::from(corners.map(to_parry));
        let near = self.skinned().facing(&motion.pose(0.0), Skinned::bare(&shape(triangle)), &rest, near_m);
        let part = match near {
            Some(_) => 0.0,
            None => {
                let own = (0..3).map(|i| triangle[i].distance(then[i])).fold(0.0, f32::max);
                let way_m = motion.way_m(self.reach_m()) + own;
                first_touch(way_m, near_m, |t| self.skinned().distance_m(&motion.pose(t), Skinned::bare(&shape(at(t))), &rest))?
            }
        };
        let corners: [Vec3; 3] = at(part);
        // A little further than what is near: distance and contact are not computed alike.
        let met = match near {
            Some(near) => near,
            None => self.skinned().facing(&motion.pose(part), Skinned::bare(&shape(corners)), &rest, 2.0 * near_m)?,
        };
        let (normal, touched) = (met.normal, met.second);
        let outward = (corners[1] - corners[0]).cross(corners[2] - corners[0]).try_normalize()?;
        // A part behind a triangle, on its way out of the tissue, does not push it; of one that it grazes the neighbours tell better.
        if normal.dot(outward) > -FACING {
            return None;
        }
        let weights = weights_in(corners, touched)?;
        let begin = motion.from * (motion.at(part).inverse() * met.first);
        let tissue: Vec3 = (0..3).map(|i| weights[i] * triangle[i]).sum();
        Some(Touch { weights, normal, depth_m: (begin - tissue).dot(normal), surface_m: begin, velocity_m_s: motion.velocity_of(begin) })
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
