//! Throws: how two strands go around each other, and what that holds.
//!
//! Gauss's integral over both strands counts it: `1 / (4 pi)` of the solid angles under which one is seen to cross the other. A crossing is a
//! half at most, a strand once around another is one. It changes evenly with the strands, but by one when they go through each
//! other. Nothing keeps these from it; what they lose by it is added to the integral, which then says how often they would go around each other. Where that is
//! a loop and both strands are pulled, a throw is tied.

use crate::chain::Eye;
use bevy_math::DVec3;
use keyhole_whiteboard::Knot;

/// Around by this much is a loop; a crossing is at most a half.
pub const LOOPED: f64 = 0.75;
/// A change by more than this within a tick is one of strands through each other: that is one, give or take what they moved.
pub const THROUGH: f64 = 0.5;

/// How often two open polylines (m) go around each other, right-handed positive (Klenin and Langowski, "Computation of writhe in modeling of
/// supercoiled DNA", Biopolymers 54, 2000, method 1a).
#[must_use]
pub fn winding(a: &[DVec3], b: &[DVec3]) -> f64 {
    let mut sum = 0.0;
    for p in a.windows(2) {
        for q in b.windows(2) {
            sum += solid_angle(p[0], p[1], q[0], q[1]);
        }
    }
    sum / (4.0 * std::f64::consts::PI)
}

/// Signed solid angle of the directions in which one segment is seen to cross the other, both ways, sr.
fn solid_angle(p0: DVec3, p1: DVec3, q0: DVec3, q1: DVec3) -> f64 {
    let [r13, r14, r23, r24] = [q0 - p0, q1 - p0, q0 - p1, q1 - p1];
    let corners = [r13.cross(r14), r14.cross(r24), r24.cross(r23), r23.cross(r13)].map(DVec3::normalize_or_zero);
    let area: f64 = (0..4).map(|k| corners[k].dot(corners[(k + 1) % 4]).clamp(-1.0, 1.0).asin()).sum();
    let side = (q1 - q0).cross(p1 - p0).dot(r13);
    if side > 0.0 {
        area
    } else if side < 0.0 {
        -area
    } else {
        0.0
    }
}

/// Where two polylines come nearest: index and part of the segment of each, and the distance, m.
#[must_use]
pub fn nearest(a: &[DVec3], b: &[DVec3]) -> Option<([(usize, f64); 2], f64)> {
    let mut best: Option<([(usize, f64); 2], f64)> = None;
    for (i, p) in a.windows(2).enumerate() {
        for (j, q) in b.windows(2).enumerate() {
            let (s, t) = closest(p[0], p[1], q[0], q[1]);
            let distance = p[0].lerp(p[1], s).distance(q[0].lerp(q[1], t));
            if best.is_none_or(|(_, d)| distance < d) {
                best = Some(([(i, s), (j, t)], distance));
            }
        }
    }
    best
}

/// Parts of two segments where they are nearest (Ericson, "Real-Time Collision Detection", 5.1.9).
fn closest(p0: DVec3, p1: DVec3, q0: DVec3, q1: DVec3) -> (f64, f64) {
    let (d, e, r) = (p1 - p0, q1 - q0, p0 - q0);
    let (a, f, b, c, g) = (d.length_squared(), e.length_squared(), d.dot(e), d.dot(r), e.dot(r));
    let part = |value: f64, of: f64| if of > 0.0 { (value / of).clamp(0.0, 1.0) } else { 0.0 };
    let across = a * f - b * b;
    // Parallel segments are as near everywhere along each other.
    let s = if across > f64::EPSILON * a * f { ((b * g - c * f) / across).clamp(0.0, 1.0) } else { 0.0 };
    let t = part(b * s + g, f);
    (part(b * t - c, a), t)
}

/// How much a knot holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnotLaw {
    /// `f` in `f (q^n - 1)`: what `n` turns hold of each strand, N.
    pub scale_n: f64,
    /// `q`.
    pub growth: f64,
    /// What it takes to run a single throw down its strands, each turn and each strand, N.
    pub run_n: f64,
}

impl KnotLaw {
    /// Difference of tension that so many turns hold of each strand when they are pulled tight, N.
    #[must_use]
    pub fn most_n(&self, turns: u32) -> f64 {
        self.scale_n * (self.growth.powi(turns as i32) - 1.0)
    }

    /// What a knot holds, and what it takes to tighten it, N. A throw holds as much as both its ends have been pulled with, to what one turn holds at most; more turns hold
    /// in proportion more. A single throw runs down when its ends are pulled, one that lies on another does not.
    #[must_use]
    pub fn drags(&self, knot: &Knot) -> [f64; 2] {
        let hold = f64::from(knot.hold_n);
        [hold, if knot.throws.len() > 1 { hold.max(self.run_n) } else { self.run_n * f64::from(knot.turns()) }]
    }

    /// What a knot holds after both its ends were pulled with this tension, N.
    #[must_use]
    pub fn tightened(&self, knot: &Knot, pull_n: f64, before_turns: u32) -> f64 {
        let (one, most) = (self.most_n(1), self.most_n(knot.turns()));
        let tight_before = f64::from(knot.hold_n) / self.most_n(before_turns).max(f64::MIN_POSITIVE);
        most * (pull_n / one).max(tight_before).clamp(0.0, 1.0)
    }
}

/// The tension with which both ends of a knot are pulled, N: the smaller of the tensions beyond its two eyes.
#[must_use]
pub fn pull_n(tail: &Eye, needle: &Eye) -> f64 {
    tail.tension_n[0].min(needle.tension_n[1]).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    fn helix(turns: f64, radius: f64, pitch: f64) -> Vec<DVec3> {
        let at = |i: i32| {
            let t = f64::from(i) / 200.0;
            DVec3::new(radius * (turns * TAU * t).cos(), radius * (turns * TAU * t).sin(), pitch * turns * (t - 0.5))
        };
        (0..=200).map(at).collect()
    }

    #[test]
    fn the_winding_counts_turns_and_their_hand() {
        let line = [DVec3::new(0.0, 0.0, -10.0), DVec3::new(0.0, 0.0, 10.0)];
        for turns in [1.0, 2.0, 3.0] {
            let right = helix(turns, 0.1, 0.3);
            let mirrored: Vec<DVec3> = right.iter().map(|p| DVec3::new(p.x, -p.y, p.z)).collect();
            let (w, m) = (winding(&right, &line), winding(&mirrored, &line));
            assert!((w - turns).abs() < 0.02 && (m + turns).abs() < 0.02, "{turns} turns: {w}, {m}");
            assert!((winding(&line, &right) - w).abs() < 1e-12, "it does not matter whose it is");
        }
    }

    #[test]
    fn a_crossing_is_a_half_at_most_and_going_through_changes_it_by_one() {
        let line = [DVec3::new(0.0, 0.0, -1.0), DVec3::new(0.0, 0.0, 1.0)];
        let across = |y: f64| winding(&[DVec3::new(-1.0, y, 0.0), DVec3::new(1.0, y, 0.0)], &line);
        for y in [1e-6, 1e-3, 0.1] {
            assert!(across(y).abs() <= 0.5 && (across(y) + across(-y)).abs() < 1e-12);
        }
        assert!(((across(1e-6) - across(-1e-6)).abs() - 1.0).abs() < 1e-4);
    }

    #[test]
    fn polylines_are_nearest_where_they_are() {
        let a = [DVec3::ZERO, DVec3::X, DVec3::new(2.0, 1.0, 0.0)];
        let b = [DVec3::new(1.5, 0.0, 3.0), DVec3::new(1.5, 0.5, 0.25), DVec3::new(1.5, 0.5, 4.0)];
        let Some(([(i, s), (j, t)], d)) = nearest(&a, &b) else { panic!("two lines") };
        assert_eq!(i, 1);
        assert!((s - 0.5).abs() < 1e-9 && (d - 0.25).abs() < 1e-9, "{s} {d}");
        assert!((j == 0 && t == 1.0) || (j == 1 && t == 0.0));
    }

    /// Loop security of polyfilament 2-0: 10 N with two turns, 18 N with three (doi 10.3390/jcm12196418); a loop has two strands.
    #[test]
    fn the_law_of_the_knot_goes_through_what_was_measured() {
        let law = crate::SutureSettings::default().knot;
        assert!((2.0 * law.most_n(2) - 10.0).abs() < 0.1 && (2.0 * law.most_n(3) - 18.0).abs() < 0.1);
    }
}
