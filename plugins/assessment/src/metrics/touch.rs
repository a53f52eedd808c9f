//! Tools that run into each other.

use bevy_math::DVec3;
use parry3d::math::{Pose, Vector};
use parry3d::query::details::distance_segment_segment;
use parry3d::shape::Segment;

/// Counts how often something begins to touch.
#[derive(Clone, Copy, Debug)]
pub struct TouchCounter {
    /// Samples without touch after which the next touch is a new one.
    apart: u32,
    /// Samples since the last touch; `None` before the first.
    since: Option<u32>,
    count: u32,
}

impl TouchCounter {
    /// Nothing has touched yet. Two touches that are less than `apart` samples apart are one: shafts that slide along each other chatter.
    #[must_use]
    pub fn new(apart: u32) -> Self {
        Self { apart, since: None, count: 0 }
    }

    /// Takes a sample.
    pub fn push(&mut self, touching: bool) {
        if touching {
            if self.since.is_none_or(|since| since >= self.apart) {
                self.count += 1;
            }
            self.since = Some(0);
        } else {
            self.since = self.since.map(|since| since.saturating_add(1));
        }
    }

    /// How often.
    #[must_use]
    pub fn count(&self) -> u32 {
        self.count
    }
}

/// Whether two shafts touch, each from its port to its tip (m), with the sum of their radii.
#[must_use]
pub fn shafts_touch(one: [DVec3; 2], other: [DVec3; 2], radii_m: f64) -> bool {
    let segment = |[a, b]: [DVec3; 2]| Segment::new(vector(a), vector(b));
    f64::from(distance_segment_segment(&Pose::IDENTITY, &segment(one), &segment(other))) <= radii_m
}

fn vector(v: DVec3) -> Vector {
    Vector::from_array(v.as_vec3().to_array())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chatter_is_one_touch() {
        let mut counter = TouchCounter::new(3);
        for sample in "..##.#..#...#....#".chars() {
            counter.push(sample == '#');
        }
        // The third gap is the first of three samples.
        assert_eq!(counter.count(), 3);
    }

    /// Two shafts cross at a right angle, 8 mm apart, with 5 mm between their axes when they touch.
    #[test]
    fn shafts_touch_where_they_cross() {
        let along = [DVec3::new(-0.1, 0.0, 0.0), DVec3::new(0.1, 0.0, 0.0)];
        let across = |z: f64, y: f64| [DVec3::new(0.05, y, z), DVec3::new(0.05, 0.3, z)];
        assert!(!shafts_touch(along, across(0.008, -0.1), 0.005));
        assert!(shafts_touch(along, across(0.0049, -0.1), 0.005));
        // The tip stops short of it: 3 and 4 mm off is 5 mm away.
        assert!(shafts_touch(along, across(0.003, 0.0039), 0.005) && !shafts_touch(along, across(0.003, 0.0041), 0.005));
    }
}
