//! Where blood lies that has flowed out of a vessel, and how much of it a suction takes up.
//!
//! Blood flies from its opening as what is thrown does and lies where it comes down on solid anatomy; the time of its flight is left out. What comes down near the rim
//! of a pool runs into it. A suction whose mouth is in reach of a pool takes up as much as it can let through, and never more than there is.

use bevy_math::Vec3;
use keyhole_whiteboard::{BloodPool, StaticSurface};

/// Blood that comes down so near to a pool's rim runs into it, m: a little more than a drop of it is wide.
const JOINS_M: f32 = 0.006;
/// Least cosine between the normals of places whose blood runs together.
const ALIKE: f32 = 0.9;
/// Longest flight, s: it falls three metres.
const LONGEST_S: f32 = 0.8;
/// Straight pieces of a flight: in each of them it falls less than 1 mm off the parabola.
const PIECES: usize = 40;

/// Where blood comes down that leaves `from` (m) with this velocity (m/s), and the normal of the surface there, against its way. `None` where it hits nothing.
#[must_use]
pub fn landing(surfaces: &[&StaticSurface], from: Vec3, velocity: Vec3, gravity: Vec3) -> Option<(Vec3, Vec3)> {
    let at = |piece: usize| {
        let t = LONGEST_S * piece as f32 / PIECES as f32;
        from + t * (velocity + 0.5 * t * gravity)
    };
    let way: Vec<Vec3> = (0..=PIECES).map(at).collect();
    let (low, high) = way.iter().fold((from, from), |(l, h), p| (l.min(*p), h.max(*p)));
    let corners = |surface: &StaticSurface, t: &[u32; 3]| t.map(|i| surface.vertices[i as usize]);
    let near = |[a, b, c]: &[Vec3; 3]| a.min(*b).min(*c).cmple(high).all() && a.max(*b).max(*c).cmpge(low).all();
    let triangles: Vec<[Vec3; 3]> =
        surfaces.iter().flat_map(|s| s.triangles.iter().map(|t| corners(s, t))).filter(|corners| near(corners)).collect();
    way.windows(2).find_map(|ends| {
        let hits = triangles.iter().filter_map(|triangle| crossing(triangle, ends[0], ends[1]));
        hits.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(part, normal)| (ends[0].lerp(ends[1], part), normal))
    })
}

/// The part of a straight way after which it goes through a triangle, and the unit normal against it.
fn crossing([a, b, c]: &[Vec3; 3], from: Vec3, to: Vec3) -> Option<(f32, Vec3)> {
    let (way, normal) = (to - from, (*b - *a).cross(*c - *a));
    let speed = normal.dot(way);
    let part = normal.dot(*a - from) / speed;
    if speed == 0.0 || !(0.0..=1.0).contains(&part) {
        return None;
    }
    let p = from + part * way;
    let inside = [(*a, *b), (*b, *c), (*c, *a)].into_iter().all(|(u, v)| (v - u).cross(p - u).dot(normal) >= 0.0);
    inside.then(|| (part, -normal.normalize() * speed.signum()))
}

/// Blood comes down: it runs into the nearest pool that it reaches, which moves towards it by its weight, or is a pool of its own.
pub fn collect(pools: &mut Vec<BloodPool>, at: Vec3, normal: Vec3, ml: f64) {
    let reaches = |p: &&mut BloodPool| p.normal.dot(normal) > ALIKE && p.at.distance(at) < p.size_m().0 + JOINS_M;
    match pools.iter_mut().filter(reaches).min_by(|a, b| a.at.distance(at).total_cmp(&b.at.distance(at))) {
        Some(pool) => {
            // Along its own surface.
            let aside = (at - pool.at).reject_from_normalized(pool.normal);
            pool.ml += ml;
            pool.at += aside * (ml / pool.ml) as f32;
        }
        None => pools.push(BloodPool { at, normal, ml }),
    }
}

/// A suction with its mouth here takes up to `most_ml` from what is in reach, the nearest first. Gives how much it took, ml; pools that are empty are gone.
pub fn aspirate(pools: &mut Vec<BloodPool>, mouth: Vec3, reach_m: f32, most_ml: f64) -> f64 {
    let mut near: Vec<(f32, usize)> =
        pools.iter().enumerate().map(|(i, p)| (p.distance_m(mouth), i)).filter(|(d, _)| *d <= reach_m).collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut left = most_ml;
    for (_, i) in near {
        let pool = &mut pools[i];
        let taken = left.min(pool.ml);
        pool.ml -= taken;
        left -= taken;
    }
    pools.retain(|p| p.ml > 0.0);
    most_ml - left
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A square of 2 m about the origin at this height, m.
    fn floor(y: f32) -> StaticSurface {
        let vertices = [[-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [1.0, -1.0]].map(|[x, z]| Vec3::new(x, y, z)).to_vec();
        StaticSurface { vertices, triangles: vec![[0, 1, 2], [0, 2, 3]] }
    }

    /// Thrown sideways from a height h it comes down after sqrt(2 h / g), on the upper of two floors.
    #[test]
    fn blood_comes_down_where_what_is_thrown_does() {
        let (upper, lower) = (floor(0.0), floor(-0.01));
        let gravity = Vec3::NEG_Y * 9.81;
        let (at, normal) = landing(&[&lower, &upper], Vec3::Y * 0.02, Vec3::X * 0.5, gravity).unwrap();
        let expected = 0.5 * (2.0f32 * 0.02 / 9.81).sqrt();
        assert!(at.distance(Vec3::X * expected) < 1e-3 && normal == Vec3::Y, "{at} instead of {expected}");
        assert_eq!(landing(&[&upper], Vec3::Y * 0.02 + 5.0 * Vec3::X, Vec3::ZERO, gravity), None);
        assert_eq!(landing(&[], Vec3::Y * 0.02, Vec3::ZERO, gravity), None);
    }

    proptest! {
        /// Whatever comes down and is taken up: what came is what lies and what was taken, nothing is taken out of reach, and never more than the suction lets through.
        #[test]
        fn what_came_down_lies_or_was_taken(
            steps in prop::collection::vec((-0.05f32..0.05, -0.05f32..0.05, 0.0f64..0.5, -0.05f32..0.05, 0.0f64..0.4), 1..60),
        ) {
            let (mut pools, mut came, mut taken) = (Vec::new(), 0.0, 0.0);
            for (x, z, ml, mouth, most) in steps {
                if ml > 0.0 {
                    collect(&mut pools, Vec3::new(x, 0.0, z), Vec3::Y, ml);
                }
                came += ml;
                let mouth = Vec3::new(mouth, 0.002, 0.0);
                let reachable: f64 = pools.iter().filter(|p| p.distance_m(mouth) <= 0.003).map(|p| p.ml).sum();
                let took = aspirate(&mut pools, mouth, 0.003, most);
                prop_assert!((took - most.min(reachable)).abs() < 1e-12, "{took} of {reachable}, at most {most}");
                taken += took;
                prop_assert!(pools.iter().all(|p| p.ml > 0.0 && p.at.y == 0.0));
            }
            let lies: f64 = pools.iter().map(|p| p.ml).sum();
            prop_assert!((came - lies - taken).abs() < 1e-9 * came.max(1.0), "{came} {lies} {taken}");
        }
    }
}
