//! The course of one blade through an organ: where its line is, and where it has been of late. A stroke may be ended at any moment, as when the
//! sheet comes near where it has been before, or near another blade's: what it has opened becomes ordinary tissue, the blade goes over the last part of
//! its way again, running along its cut, and goes on with nothing left uncut between.

use crate::meet::Occupied;
use crate::stroke::FaceWeights;
use keyhole_tetmesh::{DVec3, FaceKey, NodeId};
use rustc_hash::FxHashMap;
use std::collections::VecDeque;

/// How far a blade goes back to begin anew, as a part of the mean edge: over the row of tetrahedra at the tip of its cut and the one before.
pub(crate) const RESUME: f64 = 2.0;

/// A blade that begins within this part of the mean edge of where it stopped goes on with its cut.
const PAUSE: f64 = 1.0;

/// A sheet that comes back to tissue that it left this many mean edges ago meets its own cut as an earlier one.
const RETURN: f64 = 2.5;

/// Lines of a trail lie this part of the mean edge apart.
const SPACING: f64 = 0.2;

/// How much longer than the straight one a way is that still goes forward.
const DETOUR: f64 = 1.2;

/// Whose blade a line is. One organ may be cut by several at once.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct BladeId(pub u64);

/// One blade in one organ.
#[derive(Clone, Debug, Default)]
pub(crate) struct Course {
    pub blade: BladeId,
    /// Thickness of tissue that it takes away, m.
    pub kerf_m: f64,
    /// Its line at the last step, as points of the rest shape; empty before the first of a stroke.
    pub line: Vec<DVec3>,
    /// Where that line pierces faces.
    pub front: FxHashMap<FaceKey, FaceWeights>,
    /// Base tetrahedra that it is in.
    pub occupied: Occupied,
    /// Its lines of late, oldest first, without the turns by which it came back to where it was.
    trail: VecDeque<Vec<DVec3>>,
    /// Lines that it has yet to go to: another blade is in the way.
    pub waiting: VecDeque<Vec<DVec3>>,
    /// How far it has gone since the stroke began, m.
    travel_m: f64,
}

impl Course {
    /// The course of a blade that has not been in the tissue.
    pub fn of(blade: BladeId) -> Self {
        Self { blade, ..Self::default() }
    }

    /// Whether the blade is in the tissue.
    pub fn is_in(&self) -> bool {
        !self.occupied.tets.is_empty()
    }

    /// Notes a step to a line (m), in a mesh of this mean edge (m).
    pub fn note(&mut self, line: &[DVec3], mean_edge_m: f64) {
        let near = |old: &Vec<DVec3>| distance(old, line) < SPACING * mean_edge_m;
        if let Some(again) = self.trail.iter().position(near) {
            self.trail.truncate(again + 1);
            return;
        }
        self.trail.push_back(line.to_vec());
        while self.trail.get(1).is_some_and(|second| distance(second, line) > RESUME * mean_edge_m) {
            self.trail.pop_front();
        }
    }

    /// Forgets where the blade has been: it has left the tissue.
    pub fn forget_trail(&mut self) {
        self.trail.clear();
    }

    /// The lines over which a stroke that starts at `line` goes on with the one before, each of as many points; none when it does not.
    pub fn resumed(&mut self, line: &[DVec3], mean_edge_m: f64) -> Vec<Vec<DVec3>> {
        let mut trail: Vec<Vec<DVec3>> = std::mem::take(&mut self.trail).iter().map(|old| resampled(old, line.len())).collect();
        let away = trail.iter().map(|old| distance(old, line)).enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
        let goes_on = away.filter(|(_, d)| *d < PAUSE * mean_edge_m);
        trail.truncate(goes_on.map_or(0, |(nearest, _)| nearest + 1));
        straight_end(trail)
    }

    /// The lines of late, for a stroke that is ended in the middle of it and begun anew.
    pub fn take_trail(&mut self) -> Vec<Vec<DVec3>> {
        straight_end(std::mem::take(&mut self.trail).into())
    }

    /// Ends the stroke; the trail stays.
    pub fn stop(&mut self) {
        self.line.clear();
        self.front.clear();
        self.occupied.clear();
        self.travel_m = 0.0;
    }

    /// Whether it has gone far since it had travelled this far, m.
    fn has_left(&self, travel_m: f64, mean_edge_m: f64) -> bool {
        self.travel_m - travel_m > RETURN * mean_edge_m
    }

    /// Adds to the way that the blade has gone, m.
    pub fn travel(&mut self, moved_m: f64) {
        self.travel_m += moved_m;
    }
}

/// When the stroke's sheets were last near each node.
#[derive(Clone, Debug, Default)]
pub(crate) struct Visits(FxHashMap<NodeId, (BladeId, f64)>);

impl Visits {
    /// Whether a blade that is near a node has come back to it after it left it long ago, or finds another blade's sheet there.
    pub fn is_return(&self, course: &Course, node: NodeId, mean_edge_m: f64) -> bool {
        self.0.get(&node).is_some_and(|(blade, when)| *blade != course.blade || course.has_left(*when, mean_edge_m))
    }

    /// Whether another blade that is in the tissue was near a node of late.
    pub fn is_beside_other(&self, courses: &[Course], course: usize, node: NodeId, mean_edge_m: f64) -> bool {
        self.0.get(&node).is_some_and(|(blade, when)| {
            let others = courses.iter().filter(|c| c.blade == *blade && *blade != courses[course].blade);
            others.into_iter().any(|c| c.is_in() && !c.has_left(*when, mean_edge_m))
        })
    }

    /// Notes that a blade is near a node now.
    pub fn note(&mut self, course: &Course, node: NodeId) {
        self.0.insert(node, (course.blade, course.travel_m));
    }

    /// The blade that was near a node last.
    pub fn blade(&self, node: NodeId) -> Option<BladeId> {
        self.0.get(&node).map(|v| v.0)
    }

    pub fn clear(&mut self) {
        self.0.clear();
    }
}

/// The largest distance between points of two lines of as many points, m; infinite when they have different numbers of them.
pub(crate) fn distance(a: &[DVec3], b: &[DVec3]) -> f64 {
    if a.len() != b.len() {
        return f64::INFINITY;
    }
    a.iter().zip(b).map(|(p, q)| p.distance(*q)).fold(0.0, f64::max)
}

/// The last part of a trail, as far as it goes forward: to go over a small circle once more would cut across it again and again.
fn straight_end(mut trail: Vec<Vec<DVec3>>) -> Vec<Vec<DVec3>> {
    let Some(last) = trail.last().cloned() else { return trail };
    let (mut way, mut start) = (0.0, trail.len() - 1);
    while start > 0 {
        way += distance(&trail[start - 1], &trail[start]);
        if way > DETOUR * distance(&trail[start - 1], &last) {
            break;
        }
        start -= 1;
    }
    trail.split_off(start)
}

/// A line of `count` points along another one.
fn resampled(line: &[DVec3], count: usize) -> Vec<DVec3> {
    if line.len() == count || line.len() < 2 || count < 2 {
        return line.to_vec();
    }
    let place = |i: usize| {
        let x = i as f64 * (line.len() - 1) as f64 / (count - 1) as f64;
        let at = (x as usize).min(line.len() - 2);
        line[at].lerp(line[at + 1], x - at as f64)
    };
    (0..count).map(place).collect()
}
