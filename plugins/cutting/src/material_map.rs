//! Where the blade's line is in the rest shape.
//!
//! The kernel works in the rest shape, so a line is remembered as material points for free: what the tissue does between two ticks does not
//! change it, and tissue pulled across a blade at rest moves the blade's image in the rest shape. Points in tissue map by the affine map of
//! the tetrahedron that holds them. Points outside go on from the nearest point inside by its map; a point that would land in tissue that way
//! is in an open cut and stays where it last was.

use crate::cutter::Cutter;
use crate::locate::{Anchor, Deformed, Hint};
use bevy_math::Vec3;
use keyhole_tetmesh::{DVec3, NodeId, TetMesh};

/// Spacing of the line's points as a part of the mean edge.
const SPACING: f64 = 0.35;

/// Largest move of the blade in one step as a part of the mean edge.
const STEP: f64 = 0.25;

/// How far a line is followed out of the tissue, as a part of the mean edge: enough for the strip between two steps to reach through the
/// surface, and no more, for outside tissue a map means nothing.
const REACH: f64 = 2.5;

/// How many points a line may have; a line that is short at first, like that of scissors, has the fewest.
const POINTS: [f64; 2] = [9.0, 256.0];

/// A cutting line in the world, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WorldLine {
    /// End towards the tissue.
    pub tip: DVec3,
    /// The other end.
    pub heel: DVec3,
}

impl WorldLine {
    fn point(&self, i: usize, count: usize) -> DVec3 {
        self.tip.lerp(self.heel, i as f64 / (count - 1) as f64)
    }

    fn between(&self, to: &Self, s: f64) -> Self {
        Self { tip: self.tip.lerp(to.tip, s), heel: self.heel.lerp(to.heel, s) }
    }
}

/// The tissue as it is: one entry a node slot.
#[derive(Clone, Copy, Debug)]
pub struct Tissue<'a> {
    /// Deformed positions, m.
    pub positions: &'a [Vec3],
    /// Velocities, m/s.
    pub velocities: &'a [Vec3],
    /// Length of a tick, s.
    pub dt_s: f32,
}

impl Anchor {
    /// Where the tissue has carried it, m.
    fn world(&self, positions: &[Vec3]) -> Option<DVec3> {
        self.nodes.iter().zip(self.weights).try_fold(DVec3::ZERO, |sum, (n, w)| Some(sum + positions.get(n.index())?.as_dvec3() * w))
    }

    /// How far the tissue has carried it in the last tick, m.
    fn moved(&self, tissue: Tissue) -> DVec3 {
        let velocity = |n: &NodeId| tissue.velocities.get(n.index()).copied().unwrap_or_default().as_dvec3();
        self.nodes.iter().zip(self.weights).fold(DVec3::ZERO, |sum, (n, w)| sum + velocity(n) * w) * f64::from(tissue.dt_s)
    }

    /// The image of a point of the world in the rest shape, no further than `reach` (m) from the anchor's.
    fn map(&self, positions: &[Vec3], x: DVec3, reach: f64) -> DVec3 {
        let offset = self.world(positions).map_or(DVec3::ZERO, |at| x - at);
        self.rest + (self.to_rest * offset).clamp_length_max(reach)
    }
}

/// A point of the line.
#[derive(Clone, Copy, Debug)]
struct Mapped {
    world: DVec3,
    rest: DVec3,
    anchor: Option<Anchor>,
    inside: bool,
}

/// The memory of one blade in one organ.
#[derive(Clone, Debug, Default)]
pub struct MaterialMap {
    points: Vec<Mapped>,
    /// Where to begin the search for each point.
    hints: Vec<Hint>,
    last: Option<WorldLine>,
    /// The line as handed out last.
    line: Vec<DVec3>,
    /// Whether a line has been handed out since the stroke began.
    begun: bool,
}

impl MaterialMap {
    /// Whether the blade is in tissue.
    #[must_use]
    pub fn has_begun(&self) -> bool {
        self.begun
    }

    /// Forgets the stroke.
    pub fn reset(&mut self) {
        *self = Self::default();
    }

    /// The steps that take the blade from where it was to `now`, through tissue as it is: its line in the rest shape (m, tip first) at the end of each. The second value tells whether the blade has left the
    /// tissue at the end of them: the stroke is over.
    pub fn steps(&mut self, mesh: &TetMesh, cutter: &Cutter, tissue: Tissue, now: WorldLine) -> (Vec<Vec<DVec3>>, bool) {
        let positions = tissue.positions;
        let edge = cutter.mean_edge_m();
        let deformed = Deformed { mesh, cutter, positions };
        let before = self.last.replace(now).unwrap_or(now);
        let count = if self.begun {
            self.points.len()
        } else {
            let length = now.tip.distance(now.heel).max(before.tip.distance(before.heel));
            (length / (SPACING * edge)).ceil().clamp(POINTS[0] - 1.0, POINTS[1] - 1.0) as usize + 1
        };
        self.hints.resize(count, Hint::default());
        let moved = before.tip.distance(now.tip).max(before.heel.distance(now.heel));
        if !self.begun {
            let hints = self.hints.iter_mut().enumerate();
            let nearest = hints.map(|(i, h)| deformed.distance(now.point(i, count), h)).fold(f64::INFINITY, f64::min);
            if nearest > moved + 2.0 * cutter.longest_edge_m() {
                return (Vec::new(), false);
            }
        }
        let parts = (moved / (STEP * edge)).ceil().max(1.0);
        let mut steps: Vec<Vec<DVec3>> = Vec::new();
        let mut left = false;
        // The tissue's own motion since the last call and the first part of the blade's are one step.
        for k in usize::from(self.begun)..=parts as usize {
            let line = before.between(&now, k as f64 / parts);
            let world: Vec<DVec3> = (0..count).map(|i| line.point(i, count)).collect();
            let found: Vec<Option<Anchor>> = world.iter().zip(&mut self.hints).map(|(x, hint)| deformed.find(*x, hint)).collect();
            if !self.begun {
                if found.iter().all(Option::is_none) {
                    self.points = world.iter().map(|w| Mapped { world: *w, rest: *w, anchor: None, inside: false }).collect();
                    continue;
                }
                let here = self.follow(mesh, cutter, positions, &world, &found);
                // Where the blade was just before it came in, seen through the tissue it came into, which may have moved itself.
                let entry = here.iter().enumerate().map(|(i, h)| {
                    let Some(anchor) = h.anchor else { return h.rest };
                    let was = self.points.get(i).filter(|_| self.points.len() == count).map_or(h.world, |p| p.world);
                    h.rest + (anchor.to_rest * (was - h.world + anchor.moved(tissue))).clamp_length_max(edge)
                });
                steps.push(entry.collect());
                self.begun = true;
                self.points = here;
            } else {
                self.points = self.follow(mesh, cutter, positions, &world, &found);
            }
            let line: Vec<DVec3> = self.points.iter().map(|p| p.rest).collect();
            // Tissue that moves fast across the blade moves its image far.
            let from = steps.last().unwrap_or(&self.line).clone();
            let jump = line.iter().zip(&from).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
            let parts = (jump / (1.5 * STEP * edge)).ceil().clamp(1.0, 64.0) as usize;
            steps.extend((1..=parts).map(|i| {
                let s = i as f64 / parts as f64;
                if from.len() == line.len() { from.iter().zip(&line).map(|(a, b)| a.lerp(*b, s)).collect() } else { line.clone() }
            }));
            self.line = line;
            let out = |p: &Mapped| !p.inside && cutter.tet_at(mesh, p.rest).is_none();
            left = self.points.iter().all(out);
            if left {
                self.begun = false;
                self.points.clear();
                self.line.clear();
                break;
            }
        }
        (steps, left)
    }

    /// The line at its new place in the world.
    fn follow(&self, mesh: &TetMesh, cutter: &Cutter, positions: &[Vec3], world: &[DVec3], found: &[Option<Anchor>]) -> Vec<Mapped> {
        let reach = REACH * cutter.mean_edge_m();
        let inside: Vec<usize> = (0..world.len()).filter(|&i| found[i].is_some()).collect();
        let mut here: Vec<Mapped> = Vec::with_capacity(world.len());
        for (i, &x) in world.iter().enumerate() {
            if let Some(anchor) = found[i] {
                here.push(Mapped { world: x, rest: anchor.rest, anchor: Some(anchor), inside: true });
                continue;
            }
            let own = self.points.get(i).filter(|_| self.begun);
            let at = inside.partition_point(|&j| j < i);
            let nearest = [at.checked_sub(1), Some(at)].into_iter().flatten().filter_map(|k| inside.get(k)).min_by_key(|j| j.abs_diff(i));
            let Some(anchor) = nearest.and_then(|&j| found[j]).or(own.and_then(|p| p.anchor)) else {
                here.push(Mapped { world: x, rest: x, anchor: None, inside: false });
                continue;
            };
            let out = anchor.map(positions, x, reach);
            let in_a_cut = cutter.tet_at(mesh, out).is_some();
            let rest = if in_a_cut { own.map_or(anchor.rest, |p| p.rest) } else { out };
            here.push(Mapped { world: x, rest, anchor: Some(anchor), inside: false });
        }
        here
    }
}
