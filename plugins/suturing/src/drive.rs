//! The needle through tissue: its tip makes holes, its wire holds them until the thread does.

use crate::tissue::Tissue;
use bevy_math::{DVec3, Isometry3d, Vec3};
use keyhole_tetmesh::TetId;
use keyhole_whiteboard::{Bite, Hole, HoleKind, Needle, TissuePoint};
use smallvec::smallvec;

/// Samples of the tip's way in a radius of the needle.
const SAMPLES: f32 = 16.0;
/// Halvings of a sample's way to the place of a hole: to a 2^-20th of it.
const HALVINGS: usize = 20;

/// A pose part of the way from one to another.
#[must_use]
pub fn between(from: &Isometry3d, to: &Isometry3d, part: f32) -> Isometry3d {
    Isometry3d::new(from.translation.lerp(to.translation, part), from.rotation.slerp(to.rotation, part))
}

/// Angle from the swage of the point of the needle that is nearest to a place (m), rad: negative behind the swage, beyond its arc ahead of the tip.
#[must_use]
pub fn nearest_angle(needle: &Needle, pose: &Isometry3d, place: DVec3) -> f64 {
    use std::f64::consts::TAU;
    let local = pose.inverse().transform_point(place.as_vec3());
    let angle = f64::from(local.y).atan2(f64::from(local.x)).rem_euclid(TAU);
    let arc = f64::from(needle.arc_rad);
    // Half way through the gap between tip and swage it becomes nearer to the swage.
    if angle > arc + (TAU - arc) / 2.0 { angle - TAU } else { angle }
}

/// Moves the tip from one pose of the needle to another through the organs as they are: goes in where it comes to tissue with its point ahead, and out where that ends; drawn
/// back out it has not been there. `thread_m` is the length of the thread. Needs the bites from the tail to the needle.
pub fn pierce(
    needle: &Needle,
    [from, to]: [&Isometry3d; 2],
    thread_m: f32,
    organs: &[Tissue],
    bites: &mut Vec<Bite>,
    near: &mut Vec<TetId>,
) {
    let tip = |part: f32| needle.point(&between(from, to, part), needle.arc_rad);
    let (first, last) = (tip(0.0), tip(1.0));
    let ahead = (last - first).dot(needle.forward(to, needle.arc_rad)) > 0.0;
    let steps = (first.distance(last) / needle.radius_m * SAMPLES).ceil().clamp(1.0, 256.0) as usize;
    for organ in organs {
        let reach = Vec3::splat(first.distance(last));
        organ.near((first.min(last) - reach).as_dvec3(), (first.max(last) + reach).as_dvec3(), near);
        if near.is_empty() {
            continue;
        }
        let inside = |part: f32| organ.at(tip(part).as_dvec3(), near);
        let mut was = inside(0.0);
        for step in 0..steps {
            let (mut low, mut high) = (step as f32 / steps as f32, (step + 1) as f32 / steps as f32);
            let now = inside(high);
            if was.is_some() == now.is_some() {
                was = now;
                continue;
            }
            // The last place inside, from either side.
            let goes_in = now.is_some();
            let mut surface = if goes_in { now.clone() } else { was.clone() };
            for _ in 0..HALVINGS {
                let middle = 0.5 * (low + high);
                let found = inside(middle);
                if found.is_some() == goes_in {
                    high = middle
                } else {
                    low = middle
                }
                surface = found.or(surface);
            }
            was = now;
            let Some(point) = surface else { continue };
            let pose = between(from, to, high);
            let at_m = thread_m + needle.length_m();
            let open = bites.last().is_some_and(|b| b.organ == organ.organ && is_open(b));
            match (goes_in, ahead, open) {
                (true, true, _) if !bites.last().is_some_and(is_open) => {
                    let holes = smallvec![hole(organ, HoleKind::Entry, point, at_m)];
                    bites.push(Bite { organ: organ.organ, holes, load_n: 0.0, strength_n: 0.0 });
                }
                (false, true, true) => {
                    let Some(bite) = bites.last_mut() else { continue };
                    let entry = nearest_angle(needle, &pose, organ.place(&bite.holes[0].point)) as f32;
                    let middle = 0.5 * (entry + needle.arc_rad);
                    let place = needle.point(&pose, middle).as_dvec3();
                    let size = DVec3::splat(f64::from(needle.wire_radius_m));
                    let mut around = Vec::new();
                    organ.near(place - size, place + size, &mut around);
                    if let Some(point) = organ.at(place, &around) {
                        bite.holes.push(hole(organ, HoleKind::Channel, point, thread_m + needle.radius_m * middle));
                    }
                    bite.holes.push(hole(organ, HoleKind::Exit, point, at_m));
                }
                (false, false, true) => {
                    bites.pop();
                }
                _ => {}
            }
        }
    }
}

/// Whether the tip is still inside.
#[must_use]
pub fn is_open(bite: &Bite) -> bool {
    bite.holes.last().is_some_and(|h| h.kind == HoleKind::Entry)
}

fn hole(organ: &Tissue, kind: HoleKind, point: TissuePoint, at_m: f32) -> Hole {
    let (rest, anchor) = (organ.rest(&point).as_vec3(), organ.place(&point).as_vec3());
    Hole { kind, point, rest, at_m, anchor, force_n: Vec3::ZERO }
}

/// What becomes of a hole that the needle is in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum OnNeedle {
    /// The wire is in it: length from the tail and place, m.
    Wire {
        /// Length from the tail, m.
        at_m: f32,
        /// Where the wire holds it, m.
        anchor: Vec3,
    },
    /// The wire has gone through: the thread is in it.
    Thread,
    /// The wire has been drawn back out of it.
    Out,
}

/// Where the needle holds a hole that is at `place` (m): the tissue drags along the wire with no more than `drag_n` (N) at this compliance (m/N), and goes with it sideways.
#[must_use]
pub fn on_needle(needle: &Needle, pose: &Isometry3d, thread_m: f32, at_m: f32, place: DVec3, drag_n: f32, compliance_m_n: f32) -> OnNeedle {
    let near_m = nearest_angle(needle, pose, place) as f32 * needle.radius_m;
    let slack_m = drag_n * compliance_m_n;
    let along_m = (at_m - thread_m).clamp(near_m - slack_m, near_m + slack_m);
    if along_m < 0.0 {
        OnNeedle::Thread
    } else if along_m > needle.length_m() + slack_m {
        OnNeedle::Out
    } else {
        OnNeedle::Wire { at_m: thread_m + along_m, anchor: needle.point(pose, along_m / needle.radius_m) }
    }
}
