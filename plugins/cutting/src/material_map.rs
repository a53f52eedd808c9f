//! Where the blade's line is in the rest shape.
//!
//! The kernel works in the rest shape, so a line is remembered as material points for free: what the tissue does between two ticks does not
//! change it, and tissue pulled across a blade at rest moves the blade's image in the rest shape. Points in tissue map by the affine map of
//! the tetrahedron that holds them. Points outside go on from the nearest point inside by its map; a point that would land in tissue that way
//! is in an open cut and stays where it last was.

use crate::cutter::Cutter;
use bevy_math::{DMat3, Vec3};
use keyhole_tetmesh::{DVec3, TetId, TetMesh};

/// Spacing of the line's points as a part of the mean edge.
const SPACING: f64 = 0.35;

/// Largest move of the blade in one step as a part of the mean edge.
const STEP: f64 = 0.25;

/// How far a line is followed out of the tissue, as a part of the mean edge: enough for the strip between two steps to reach through the
/// surface, and no more, for outside tissue a map means nothing.
const REACH: f64 = 2.5;

/// How many points a line may have.
const MOST_POINTS: f64 = 256.0;

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

/// A point of the line.
#[derive(Clone, Copy, Debug)]
struct Mapped {
    world: DVec3,
    rest: DVec3,
    /// From a vector in the world to one in the rest shape.
    to_rest: DMat3,
    inside: bool,
}

/// One step for the cutter.
#[derive(Clone, Debug)]
pub struct RestStep {
    /// The line in the rest shape, m, tip first.
    pub line: Vec<DVec3>,
    /// The points of it that are in tissue.
    pub inside: Vec<DVec3>,
}

/// The memory of one blade in one organ.
#[derive(Clone, Debug, Default)]
pub struct MaterialMap {
    points: Vec<Mapped>,
    last: Option<WorldLine>,
    /// Whether a line has been handed out since the stroke began.
    begun: bool,
}

/// A tetrahedron near the blade.
struct Near {
    tet: TetId,
    min: DVec3,
    max: DVec3,
    world: [DVec3; 4],
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

    /// The steps that take the blade from where it was to `now`, through tissue deformed to `positions` (m, by node slot). The second value
    /// tells whether the blade has left the tissue at the end of them: the stroke is over.
    pub fn steps(&mut self, mesh: &TetMesh, cutter: &Cutter, positions: &[Vec3], now: WorldLine) -> (Vec<RestStep>, bool) {
        let edge = cutter.mean_edge_m();
        let before = self.last.replace(now).unwrap_or(now);
        let near = near_tets(mesh, positions, &[before, now]);
        if near.is_empty() && !self.begun {
            return (Vec::new(), false);
        }
        let count = if self.begun {
            self.points.len()
        } else {
            ((now.tip.distance(now.heel) / (SPACING * edge)).ceil().clamp(1.0, MOST_POINTS - 1.0)) as usize + 1
        };
        let moved = before.tip.distance(now.tip).max(before.heel.distance(now.heel));
        let parts = (moved / (STEP * edge)).ceil().max(1.0);
        let mut steps = Vec::new();
        let mut left = false;
        for k in 0..=parts as usize {
            let line = before.between(&now, k as f64 / parts);
            let world: Vec<DVec3> = (0..count).map(|i| line.point(i, count)).collect();
            let found = locate(mesh, &near, &world);
            if !self.begun {
                if found.iter().all(Option::is_none) {
                    self.points = world.iter().map(|w| Mapped { world: *w, rest: *w, to_rest: DMat3::IDENTITY, inside: false }).collect();
                    continue;
                }
                let here = self.follow(mesh, cutter, &world, &found, edge);
                if self.points.len() == count {
                    // Where the blade was just before it came in, seen through the tissue it came into.
                    let entry: Vec<DVec3> =
                        here.iter().zip(&self.points).map(|(h, p)| h.rest + h.to_rest * (p.world - h.world).clamp_length_max(STEP * edge)).collect();
                    steps.push(RestStep { line: entry, inside: here.iter().filter(|p| p.inside).map(|p| p.rest).collect() });
                }
                self.begun = true;
                self.points = here;
            } else {
                self.points = self.follow(mesh, cutter, &world, &found, edge);
            }
            steps.push(RestStep {
                line: self.points.iter().map(|p| p.rest).collect(),
                inside: self.points.iter().filter(|p| p.inside).map(|p| p.rest).collect(),
            });
            let out = |p: &Mapped| !p.inside && cutter.tets_at(mesh, &[p.rest]).is_empty();
            left = self.points.iter().all(out);
            if left {
                self.begun = false;
                self.points.clear();
                break;
            }
        }
        (steps, left)
    }

    /// The line at its new place in the world.
    fn follow(&self, mesh: &TetMesh, cutter: &Cutter, world: &[DVec3], found: &[Option<Mapped>], edge: f64) -> Vec<Mapped> {
        let inside: Vec<usize> = (0..world.len()).filter(|&i| found[i].is_some()).collect();
        let in_tissue = |rest: DVec3| !cutter.tets_at(mesh, &[rest]).is_empty();
        let mut here: Vec<Mapped> = Vec::with_capacity(world.len());
        for (i, &x) in world.iter().enumerate() {
            if let Some(mapped) = found[i] {
                here.push(mapped);
                continue;
            }
            let own = self.points.get(i).filter(|_| self.begun).copied();
            let at = inside.partition_point(|&j| j < i);
            let nearest = [at.checked_sub(1), Some(at)].into_iter().flatten().filter_map(|k| inside.get(k)).min_by_key(|j| j.abs_diff(i));
            let reference = nearest.and_then(|&j| found[j]).or(own);
            let Some(reference) = reference else {
                here.push(Mapped { world: x, rest: x, to_rest: DMat3::IDENTITY, inside: false });
                continue;
            };
            let out = reference.to_rest * (x - reference.world);
            let rest = reference.rest + out.clamp_length_max(REACH * edge);
            let rest = if in_tissue(rest) { own.map_or(reference.rest, |p| p.rest) } else { rest };
            here.push(Mapped { world: x, rest, to_rest: reference.to_rest, inside: false });
        }
        here
    }
}

/// Tetrahedra whose deformed box overlaps the box of the lines. Looks at the whole mesh once a tick while a blade is near.
fn near_tets(mesh: &TetMesh, positions: &[Vec3], lines: &[WorldLine]) -> Vec<Near> {
    let ends = lines.iter().flat_map(|l| [l.tip, l.heel]);
    let (low, high) = ends.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), p| (l.min(p), h.max(p)));
    let (low32, high32) = (low.as_vec3(), high.as_vec3());
    mesh.iter()
        .filter_map(|(tet, corners)| {
            let p = corners.map(|n| positions.get(n.index()).copied().unwrap_or(Vec3::NAN));
            let (min, max) = (p[0].min(p[1]).min(p[2]).min(p[3]), p[0].max(p[1]).max(p[2]).max(p[3]));
            (min.cmple(high32).all() && low32.cmple(max).all()).then(|| Near {
                tet,
                min: min.as_dvec3(),
                max: max.as_dvec3(),
                world: p.map(|p| p.as_dvec3()),
            })
        })
        .collect()
}

/// For each point of a line the tetrahedron that holds it, as a map; the one with the smallest id where several do.
fn locate(mesh: &TetMesh, near: &[Near], world: &[DVec3]) -> Vec<Option<Mapped>> {
    let mut found: Vec<Option<Mapped>> = vec![None; world.len()];
    for candidate in near {
        for (i, x) in world.iter().enumerate() {
            if found[i].is_none() && candidate.min.cmple(*x).all() && x.cmple(candidate.max).all() {
                found[i] = map_through(mesh, candidate, *x);
            }
        }
    }
    found
}

/// The image of a point in the rest shape, when the tetrahedron holds it and is not turned over.
fn map_through(mesh: &TetMesh, near: &Near, x: DVec3) -> Option<Mapped> {
    let [a, b, c, d] = near.world;
    let deformed = DMat3::from_cols(b - a, c - a, d - a);
    if deformed.determinant() <= 0.0 {
        return None;
    }
    let inverse = deformed.inverse();
    let w = inverse * (x - a);
    if w.min_element() < 0.0 || w.element_sum() > 1.0 {
        return None;
    }
    let [ra, rb, rc, rd] = mesh.points(near.tet);
    let to_rest = DMat3::from_cols(rb - ra, rc - ra, rd - ra) * inverse;
    Some(Mapped { world: x, rest: ra + to_rest * (x - a), to_rest, inside: true })
}
