//! The knots of a suture in a tick: which there are, how tight they are, and whether a throw is being tied.

use crate::knots::{LOOPED, THROUGH, nearest, pull_n, winding};
use crate::settings::SutureSettings;
use crate::stitch::{Owner, Suture, Works};
use bevy_math::DVec3;
use keyhole_whiteboard::Knot;
use smallvec::smallvec;

/// Nearer to each other than this part of a segment two knots are one.
const JOINED: f64 = 0.5;
/// Segments next to the tissue or a knot that are not looked at for where strands cross.
const ROOT: f64 = 2.0;

impl Suture<'_> {
    /// Throws that have run together are one knot; how tight they are; those that have run off an end are undone.
    pub(crate) fn settle_knots(&mut self, settings: &SutureSettings) {
        let Self { thread, knots, works, .. } = self;
        let Works { chain, eyes, owners, .. } = &mut **works;
        for (k, knot) in knots.tied.iter_mut().enumerate() {
            let eye = |side: usize| owners.iter().position(|o| *o == Owner::Knot(k, side)).map(|e| eyes[e]);
            if let (Some(tail), Some(needle)) = (eye(0), eye(1)) {
                knot.hold_n = settings.knot.tightened(knot, pull_n(&tail, &needle), knot.turns()) as f32;
            }
        }
        let close = (JOINED * chain.segment_m) as f32;
        for k in (1..knots.tied.len()).rev() {
            let apart = |side: usize| (knots.tied[k - 1].at_m[side] - knots.tied[k].at_m[side]).abs();
            if apart(0) <= close && apart(1) <= close {
                let outer = knots.tied.remove(k);
                let inner = &mut knots.tied[k - 1];
                let before = inner.turns();
                inner.throws.extend(outer.throws);
                inner.hold_n = settings.knot.tightened(inner, 0.0, before) as f32;
                for (eye, owner) in (0..eyes.len()).rev().zip(owners.clone().into_iter().rev()) {
                    if matches!(owner, Owner::Knot(o, _) if o == k) {
                        eyes.remove(eye);
                        owners.remove(eye);
                    }
                }
                // The owners of knots further out move up.
                for owner in owners.iter_mut() {
                    if let Owner::Knot(o, _) = owner {
                        *o -= usize::from(*o > k);
                    }
                }
            }
        }
        let ends = [1.05 * chain.clearance_m() as f32, thread.length_m - 1.05 * chain.clearance_m() as f32];
        let count = knots.tied.len();
        knots.tied.retain(|k| k.at_m[0] > ends[0] && k.at_m[1] < ends[1]);
        knots.undone += (count - knots.tied.len()) as u32;
    }

    /// Counts how often the free strands go around each other, and ties a throw where a loop has been pulled tight.
    pub(crate) fn count_throws(&mut self, settings: &SutureSettings) {
        let Self { thread, bites, knots, works, .. } = self;
        let holes = || bites.held.iter().flat_map(|b| &b.holes);
        let on_needle = holes().any(|h| h.at_m >= thread.length_m);
        let first = holes().map(|h| h.at_m).chain(knots.tied.iter().map(|k| k.at_m[0])).fold(f32::INFINITY, f32::min);
        let last = holes().map(|h| h.at_m).chain(knots.tied.iter().map(|k| k.at_m[1])).fold(f32::NEG_INFINITY, f32::max);
        if on_needle || first > last {
            (knots.winding, works.winding) = (0.0, None);
            return;
        }
        let (first, last) = (f64::from(first), f64::from(last));
        let Works { chain, eyes, strands: [tail, needle], places, winding: last_winding, counted: last_counted, lost, .. } = &mut **works;
        tail.clear();
        needle.clear();
        // An eye's length has been rounded: it belongs to both strands' roots by half of its clearance.
        let tolerance = 0.5 * chain.clearance_m();
        for (at, place) in chain.line(eyes) {
            if at <= first + tolerance {
                tail.push((at, place));
            }
            if at >= last - tolerance {
                needle.push((at, place));
            }
        }
        tail.reverse();
        let mut fill = |side: usize, strand: &[(f64, DVec3)]| {
            places[side].clear();
            places[side].extend(strand.iter().map(|(_, p)| *p));
        };
        fill(0, tail);
        fill(1, needle);
        let now = winding(&places[0], &places[1]);
        let counted = (bites.held.len(), knots.tied.len());
        let before = last_winding.filter(|_| *last_counted == counted);
        (*last_winding, *last_counted) = (Some(now), counted);
        let change = before.map_or(0.0, |before| now - before);
        if before.is_none() {
            *lost = 0.0;
        } else if change.abs() > THROUGH {
            *lost -= change.round();
        }
        let whole = now + *lost;
        knots.winding = whole as f32;
        let pulled = chain.tension_between(0.0, first).min(chain.tension_between(last, chain.length_m()));
        let turns = lost.clamp(-100.0, 100.0) as i8;
        if whole.abs() < LOOPED || turns == 0 || pulled < f64::from(settings.tighten_n) {
            return;
        }
        // Near the root the strands are beside each other anyway.
        let root = ROOT * chain.segment_m;
        let beyond = |strand: &[(f64, DVec3)], base: f64| strand.iter().position(|(at, _)| (at - base).abs() > root);
        let (Some(a), Some(b)) = (beyond(tail, first), beyond(needle, last)) else { return };
        let Some(([(i, s), (j, t)], _)) = nearest(&places[0][a..], &places[1][b..]) else { return };
        let along = |strand: &[(f64, DVec3)], from: usize, part: f64| {
            let ((at, p), (to, q)) = (strand[from], strand[from + 1]);
            (at + part * (to - at), p.lerp(q, part))
        };
        let ((at_tail, p), (at_needle, q)) = (along(tail, a + i, s), along(needle, b + j, t));
        let clear = 2.0 * chain.clearance_m();
        if at_tail < clear || at_needle > chain.length_m() - clear {
            return;
        }
        let place = (0.5 * (p + q)).as_vec3();
        let at_m = [at_tail as f32, at_needle as f32];
        knots.tied.push(Knot { at_m, throws: smallvec![turns], hold_n: settings.knot.run_n as f32, place });
    }
}
