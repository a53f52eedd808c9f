//! Which eyes of a chain slide, and what friction does there.

use crate::chain::{Eye, Slide};
use crate::solve::{Who, Work};
use bevy_math::DVec3;

/// A sliding thread that is pushed by more than this part of its pull rests.
const PUSH: f64 = 0.1;

impl Work {
    /// Friction at sliding eyes: the span on the pulled side has more tension than the other.
    pub(crate) fn put_friction(&mut self, eyes: &[Eye], dt: f64) {
        for n in 1..self.nodes.len().saturating_sub(1) {
            let Who::Eye(e) = self.nodes[n].who else { continue };
            let eye = &eyes[e];
            let forward = match eye.slide {
                Slide::Rests => continue,
                Slide::Forward => true,
                Slide::Back => false,
            };
            let turn = turn(self.nodes[n - 1].place, self.nodes[n].place, self.nodes[n + 1].place);
            let smaller = eye.tension_n[0].min(eye.tension_n[1]);
            let more = eye.most_difference(forward, smaller, turn);
            let other = if forward { n + 1 } else { n - 1 };
            let along = (self.nodes[other].place - self.nodes[n].place).normalize_or_zero();
            self.nodes[n].drag = more;
            self.nodes[n].residual -= more * dt * dt * along;
            self.nodes[other].residual += more * dt * dt * along;
        }
    }

    /// Lets eyes slide or rest by what the tensions are now; whether any changed.
    pub(crate) fn try_slides(&mut self, eyes: &mut [Eye], clear: f64, last: bool) -> bool {
        let mut changed = false;
        for n in 1..self.nodes.len().saturating_sub(1) {
            let Who::Eye(e) = self.nodes[n].who else { continue };
            let at = |n: usize| self.nodes[n].place;
            let [left, right] = self.nodes[n].tension;
            if eyes[e].slide == Slide::Rests {
                eyes[e].tension_n = [left, right];
                let turn = turn(at(n - 1), at(n), at(n + 1));
                let ways = [(Slide::Forward, right - left, left), (Slide::Back, left - right, right)];
                let way = ways.into_iter().find(|(way, more, smaller)| {
                    // A thread pulls and does not push.
                    *more + smaller.min(0.0) > eyes[e].most_difference(*way == Slide::Forward, *smaller, turn)
                        && self.room(n, *way, clear) > 0.0
                });
                if let (Some((way, ..)), false) = (way, last) {
                    eyes[e].slide = way;
                    changed = true;
                }
            } else {
                let forward = eyes[e].slide == Slide::Forward;
                eyes[e].tension_n = [left, right];
                let moved = self.nodes[n].at_m - self.slid_to(n, eyes);
                let (pulled, other) = if forward { (right, left) } else { (left, right) };
                // It has turned back, or friction pushes, or there is nowhere to go.
                let room = self.room(n, eyes[e].slide, clear);
                if (if forward { moved } else { -moved }) < 0.0 || room <= 0.0 || other < -PUSH * pulled.abs() {
                    eyes[e].slide = Slide::Rests;
                    changed = true;
                }
            }
        }
        changed
    }

    /// Which length is at an eye, m, once the spans of its row share the thread as they share the way.
    pub(crate) fn slid_to(&self, node: usize, eyes: &[Eye]) -> f64 {
        let slides = |n: usize| matches!(self.nodes[n].who, Who::Eye(e) if eyes[e].slide != Slide::Rests);
        let from = (0..node).rev().find(|n| !slides(*n)).unwrap_or(0);
        let to = (node + 1..self.nodes.len()).find(|n| !slides(*n)).unwrap_or(self.nodes.len() - 1);
        let way = |from: usize, to: usize| self.nodes[from..=to].windows(2).map(|n| n[0].place.distance(n[1].place)).sum::<f64>();
        let whole = way(from, to);
        let part = if whole > 0.0 { way(from, node) / whole } else { 0.5 };
        self.nodes[from].at_m + part * (self.nodes[to].at_m - self.nodes[from].at_m)
    }

    /// How much thread there is to slide through an eye that way, m: up to the next eye, end or held particle.
    pub(crate) fn room(&self, node: usize, way: Slide, clear: f64) -> f64 {
        let stops = |n: usize| {
            let node = &self.nodes[n];
            matches!(node.who, Who::Eye(_)) || node.mass.is_infinite() || n == 0 || n == self.nodes.len() - 1
        };
        let at = self.nodes[node].at_m;
        match way {
            Slide::Forward => (0..node).rev().find(|n| stops(*n)).map_or(0.0, |n| at - self.nodes[n].at_m - clear),
            Slide::Back => (node + 1..self.nodes.len()).find(|n| stops(*n)).map_or(0.0, |n| self.nodes[n].at_m - at - clear),
            Slide::Rests => 0.0,
        }
    }
}

/// The angle by which a way turns in its middle, rad.
fn turn(from: DVec3, over: DVec3, to: DVec3) -> f64 {
    let (before, after) = (over - from, to - over);
    before.cross(after).length().atan2(before.dot(after))
}
