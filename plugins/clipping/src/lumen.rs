//! The inside of a vessel as a bundle of fibres in the organ's rest shape: which of them a cut has severed, and where, and what a clip closes.
//!
//! A fibre runs along the centre line at a place of its own in the cross-section (places of equal area on a spiral of golden angles; of a vessel that is
//! hollow in the mesh evenly around the middle of its wall, each for the sector of the lumen that it is the wall of). From station to
//! station it is a straight line through the tetrahedra; where it leaves the mesh on its way the vessel is open. The rest shape does not move, so
//! nothing of this has to be done anew but after a cut.

use crate::locate::at_rest;
use bevy_math::{DVec3, Vec3};
use keyhole_tetmesh::{FACES, TetId, TetMesh, TopologyDelta};
use keyhole_whiteboard::{ClipPair, Vessel};
use std::f64::consts::TAU;

/// Fibres of a vessel.
pub const FIBRES: usize = 64;

/// From one place of the spiral to the next, rad: the golden angle.
const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;

/// Where a fibre is at a station.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Seed {
    /// Outside the organ from the beginning: the fibre is not looked at there.
    Outside,
    /// In this tetrahedron.
    In(TetId),
    /// In tissue that is no longer a part of this organ.
    Gone,
}

/// A vessel and what is left of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Lumen {
    radius: f64,
    wall: f64,
    /// Along the line, m, and the centre there.
    stations: Vec<(f64, DVec3)>,
    /// By station, then fibre.
    points: Vec<DVec3>,
    seeds: Vec<Seed>,
    /// Between a station and the next, by fibre: where it is severed, along the line, m.
    severed: Vec<Option<f64>>,
}

/// What a clip closes of a vessel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Closure {
    /// Where along the line, m.
    pub along_m: f64,
    /// Part of the lumen, in [0, 1].
    pub closes: f64,
}

/// An opening of a vessel as one of its ends reaches it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Opening {
    /// Where along the line, m.
    pub along_m: f64,
    /// Area through which blood reaches it and leaves, m2.
    pub area_m2: f64,
}

/// An end of a vessel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// Where the line begins.
    Near,
    /// Where it ends.
    Far,
}

impl Lumen {
    /// The lumen of a vessel in an organ as it is.
    #[must_use]
    pub fn new(mesh: &TetMesh, vessel: &Vessel) -> Self {
        let (radius, wall) = (f64::from(vessel.radius_m), f64::from(vessel.wall_m));
        let stations = stations(&vessel.line, radius);
        let mut points = Vec::with_capacity(stations.len() * FIBRES);
        let mut across = DVec3::ZERO;
        for (i, (_, centre)) in stations.iter().enumerate() {
            let (before, after) = (stations[i.saturating_sub(1)].1, stations[(i + 1).min(stations.len() - 1)].1);
            let tangent = (after - before).normalize_or_zero();
            // The frame turns as little as it can from station to station.
            let carried = across.reject_from(tangent.try_normalize().unwrap_or(DVec3::X));
            across = carried.try_normalize().unwrap_or_else(|| tangent.any_orthonormal_vector());
            let other = tangent.cross(across);
            points.extend((0..FIBRES).map(|f| {
                let part = (f as f64 + 0.5) / FIBRES as f64;
                let (angle, at) =
                    if wall > 0.0 { (part * TAU, radius + wall / 2.0) } else { (f as f64 * GOLDEN_ANGLE, radius * part.sqrt()) };
                *centre + (across * angle.cos() + other * angle.sin()) * at
            }));
        }
        let mut seeds = Vec::with_capacity(points.len());
        let mut last: Option<(TetId, DVec3)> = None;
        for p in &points {
            let walked = last.and_then(|(tet, from)| walk(mesh, tet, from, *p).ok());
            let found = walked.or_else(|| at_rest(mesh, mesh.iter().map(|(t, _)| t), p.as_vec3()).map(|f| f.0));
            last = found.map(|tet| (tet, *p)).or(last);
            seeds.push(found.map_or(Seed::Outside, Seed::In));
        }
        let severed = vec![None; (stations.len() - 1) * FIBRES];
        let mut lumen = Self { radius, wall, stations, points, seeds, severed };
        lumen.look(mesh);
        lumen
    }

    /// What a piece of the organ that has come free has of it: all else is severed there. `mesh` is the mesh of the piece, its rest shape where it was.
    #[must_use]
    pub fn of_fragment(&self, mesh: &TetMesh) -> Self {
        let seeds = self.seeds.iter().zip(&self.points).map(|(seed, p)| match seed {
            Seed::Outside => Seed::Outside,
            Seed::In(_) | Seed::Gone => {
                at_rest(mesh, mesh.iter().map(|(t, _)| t), p.as_vec3()).map_or(Seed::Gone, |(tet, _)| Seed::In(tet))
            }
        });
        let mut lumen = Self { seeds: seeds.collect(), severed: vec![None; self.severed.len()], ..self.clone() };
        lumen.look(mesh);
        lumen
    }

    /// Whether anything of it is in this organ.
    #[must_use]
    pub fn is_somewhere(&self) -> bool {
        self.seeds.iter().any(|s| matches!(s, Seed::In(_)))
    }

    /// Carries the lumen over a topology change; `mesh` is the mesh after it.
    pub fn update(&mut self, mesh: &TetMesh, delta: &TopologyDelta) {
        let mut removed = delta.removed.clone();
        removed.sort_unstable();
        for (seed, p) in self.seeds.iter_mut().zip(&self.points) {
            let Seed::In(tet) = *seed else { continue };
            if removed.binary_search(&tet).is_ok() || !mesh.contains(tet) {
                let found = at_rest(mesh, delta.added.iter().map(|a| a.tet).filter(|t| mesh.contains(*t)), p.as_vec3());
                *seed = found.map_or(Seed::Gone, |f| Seed::In(f.0));
            }
        }
        self.look(mesh);
    }

    /// Follows every fibre that is still whole from each station to the next.
    fn look(&mut self, mesh: &TetMesh) {
        for (i, severed) in self.severed.iter_mut().enumerate().filter(|(_, s)| s.is_none()) {
            let station = i / FIBRES;
            let (from, to) = (self.stations[station].0, self.stations[station + 1].0);
            *severed = match (self.seeds[i], self.seeds[i + FIBRES]) {
                (Seed::Outside, _) | (_, Seed::Outside) => None,
                (Seed::Gone, _) => Some(from),
                (Seed::In(_), Seed::Gone) => Some(to),
                (Seed::In(tet), Seed::In(_)) => {
                    walk(mesh, tet, self.points[i], self.points[i + FIBRES]).err().map(|part| from + part * (to - from))
                }
            };
        }
    }

    /// Area of the whole lumen, m2.
    #[must_use]
    pub fn area_m2(&self) -> f64 {
        std::f64::consts::PI * self.radius * self.radius
    }

    /// Part of the fibres that are severed anywhere.
    #[must_use]
    pub fn severed(&self) -> f64 {
        (0..FIBRES).filter(|f| self.cuts(*f).next().is_some()).count() as f64 / FIBRES as f64
    }

    fn cuts(&self, fibre: usize) -> impl Iterator<Item = f64> + '_ {
        self.severed.iter().skip(fibre).step_by(FIBRES).flatten().copied()
    }

    /// Whether an end of the line is still in this organ.
    fn has_end(&self, end: End) -> bool {
        let mut stations: Vec<&[Seed]> = self.seeds.chunks(FIBRES).collect();
        if end == End::Far {
            stations.reverse();
        }
        let first = stations.into_iter().find(|s| s.iter().any(|seed| *seed != Seed::Outside));
        first.is_some_and(|s| s.iter().any(|seed| matches!(seed, Seed::In(_))))
    }

    /// What blood from an end reaches: the severed fibres, in groups between clips, each through no more of the lumen than the clips on the way leave open.
    #[must_use]
    pub fn openings(&self, clips: &[Closure], end: End) -> Vec<Opening> {
        if !self.has_end(end) {
            return Vec::new();
        }
        let length = self.stations.last().map_or(0.0, |s| s.0);
        let from_end = |along: f64| if end == End::Near { along } else { length - along };
        let mut clips: Vec<(f64, f64)> = clips.iter().map(|c| (from_end(c.along_m), 1.0 - c.closes)).collect();
        clips.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        let mut firsts: Vec<f64> = (0..FIBRES).filter_map(|f| self.cuts(f).map(from_end).min_by(f64::total_cmp)).collect();
        firsts.sort_by(f64::total_cmp);
        let fibre = self.area_m2() / FIBRES as f64;
        let (mut openings, mut used, mut open, mut at) = (Vec::new(), 0.0, 1.0f64, 0);
        for i in 0..=clips.len() {
            let until = clips.get(i).map_or(f64::INFINITY, |c| c.0);
            let group: Vec<f64> = firsts[at..].iter().copied().take_while(|s| *s <= until).collect();
            at += group.len();
            let area_m2 = (group.len() as f64 * fibre).min(open * self.area_m2() - used);
            if !group.is_empty() && area_m2 > 0.0 {
                let mean = group.iter().sum::<f64>() / group.len() as f64;
                openings.push(Opening { along_m: from_end(mean), area_m2 });
                used += area_m2;
            }
            open = open.min(clips.get(i).map_or(open, |c| c.1));
        }
        openings
    }

    /// What a clip closes: each piece of its legs with the centre of the lumen between them a slice of the lumen as wide as the piece. `cell_m` is the length
    /// of such a piece where it is alone. `None` of a clip without tissue.
    #[must_use]
    pub fn closure(&self, pairs: &[ClipPair], cell_m: f32) -> Option<Closure> {
        let middle = |p: &ClipPair| (p.rest[0] + p.rest[1]).as_dvec3() / 2.0;
        let centre = pairs.iter().map(middle).sum::<DVec3>() / pairs.len() as f64;
        let (along_m, on, tangent) = self.nearest(centre).filter(|_| !pairs.is_empty())?;
        let pinch: DVec3 = pairs.iter().map(|p| (p.rest[0] - p.rest[1]).as_dvec3()).sum();
        let Some(v) = pinch.reject_from(tangent).try_normalize() else { return Some(Closure { along_m, closes: 0.0 }) };
        let u = tangent.cross(v);
        let around = |p: &&ClipPair| (p.rest[0].as_dvec3() - on).dot(v) > 0.0 && (p.rest[1].as_dvec3() - on).dot(v) < 0.0;
        let mut places: Vec<(f32, f64)> = pairs.iter().filter(around).map(|p| (p.along_m, (middle(p) - on).dot(u))).collect();
        places.sort_by(|a, b| a.1.total_cmp(&b.1));
        let rows: Vec<f64> =
            places.chunk_by(|a, b| a.0 == b.0).map(|row| row.iter().map(|p| p.1).sum::<f64>() / row.len() as f64).collect();
        // Pieces that abut reach half-way to each other, and as far to their other side.
        let widest = f64::from(cell_m);
        let abut = |a: usize, b: usize| Some(rows.get(b)? - rows[a]).filter(|d| *d < 1.5 * widest);
        let mut slices: Vec<(f64, f64)> = Vec::new();
        for (i, at) in rows.iter().enumerate() {
            let (last, next) = (i.checked_sub(1).and_then(|l| abut(l, i)), abut(i, i + 1));
            let half = |own: Option<f64>, other: Option<f64>| own.or(other).unwrap_or(widest) / 2.0;
            let (low, high) = (at - half(last, next), at + half(next, last));
            match slices.last_mut().filter(|_| last.is_some()) {
                Some(slice) => slice.1 = high,
                None => slices.push((low, high)),
            }
        }
        let closes: f64 = slices.iter().map(|(low, high)| disc_below(high / self.radius) - disc_below(low / self.radius)).sum();
        Some(Closure { along_m, closes: closes.clamp(0.0, 1.0) })
    }

    /// The point of the line that is nearest: where along it (m), the point, and the direction of the line there.
    fn nearest(&self, point: DVec3) -> Option<(f64, DVec3, DVec3)> {
        let pieces = self.stations.windows(2).map(|s| {
            let (way, length) = (s[1].1 - s[0].1, s[1].0 - s[0].0);
            let part = ((point - s[0].1).dot(way) / way.length_squared()).clamp(0.0, 1.0);
            (s[0].0 + part * length, s[0].1 + way * part, way / length)
        });
        pieces.min_by(|a, b| a.1.distance_squared(point).total_cmp(&b.1.distance_squared(point)))
    }

    /// Points of the organ's rest shape whose middle is where the line is so far along (m), each with a tetrahedron that it is in or near. Of a hollow vessel
    /// they are in its wall, on the side of this end of the line. Empty where nothing is left there.
    #[must_use]
    pub fn places(&self, along_m: f64, end: End) -> Vec<(TetId, Vec3)> {
        if self.wall <= 0.0 {
            return self.place(along_m).into_iter().collect();
        }
        let this_side = |s: f64| if end == End::Near { s <= along_m } else { s >= along_m };
        let whole = self.stations.iter().zip(self.seeds.chunks(FIBRES).zip(self.points.chunks(FIBRES)));
        let near = whole.filter(|(s, (seeds, _))| this_side(s.0) && seeds.iter().any(|s| matches!(s, Seed::In(_))));
        let nearest = near.min_by(|a, b| (a.0.0 - along_m).abs().total_cmp(&(b.0.0 - along_m).abs()));
        let ring = nearest.into_iter().flat_map(|(_, (seeds, points))| seeds.iter().zip(points));
        ring.filter_map(|(seed, p)| if let Seed::In(tet) = seed { Some((*tet, p.as_vec3())) } else { None }).collect()
    }

    /// The point of the organ's rest shape where the line is so far along (m), and a tetrahedron that was near it.
    fn place(&self, along_m: f64) -> Option<(TetId, Vec3)> {
        let part = self.stations.windows(2).find(|s| along_m <= s[1].0).or_else(|| self.stations.windows(2).last())?;
        let at = part[0].1.lerp(part[1].1, ((along_m - part[0].0) / (part[1].0 - part[0].0)).clamp(0.0, 1.0));
        let seeds = self.seeds.iter().zip(&self.points).filter_map(|(s, p)| if let Seed::In(tet) = s { Some((*tet, *p)) } else { None });
        seeds.min_by(|a, b| a.1.distance_squared(at).total_cmp(&b.1.distance_squared(at))).map(|(tet, _)| (tet, at.as_vec3()))
    }
}

/// Part of a disc of radius one with a coordinate below `x`.
fn disc_below(x: f64) -> f64 {
    let x = x.clamp(-1.0, 1.0);
    0.5 + (x * (1.0 - x * x).sqrt() + x.asin()) / std::f64::consts::PI
}

/// Places along a line (m), evenly, no further from each other than its radius, with both ends and all corners between.
fn stations(line: &[Vec3], radius: f64) -> Vec<(f64, DVec3)> {
    let mut stations: Vec<(f64, DVec3)> = Vec::new();
    let mut along = 0.0;
    for ends in line.windows(2) {
        let (from, to) = (ends[0].as_dvec3(), ends[1].as_dvec3());
        let length = from.distance(to);
        let count = (length / radius).ceil().max(1.0) as usize;
        let places = (0..count).map(|i| i as f64 / count as f64).map(|t| (along + t * length, from.lerp(to, t)));
        stations.extend(places.filter(|_| length > 0.0));
        along += length;
    }
    stations.extend(line.last().map(|p| (along, p.as_dvec3())));
    stations
}

/// Walks along a straight line through the rest shape, from a point of a tetrahedron: to the one that has the other end, or as far as the part of
/// the line where it leaves the mesh.
fn walk(mesh: &TetMesh, mut tet: TetId, from: DVec3, to: DVec3) -> Result<TetId, f64> {
    let way = to - from;
    for _ in 0..=mesh.tet_count() {
        let corners = mesh.points(tet);
        let mut exit = (f64::INFINITY, 0);
        for (face, [i, j, k]) in FACES.into_iter().enumerate() {
            let normal = (corners[j] - corners[i]).cross(corners[k] - corners[i]);
            let speed = normal.dot(way);
            if speed > 0.0 {
                let at = normal.dot(corners[i] - from) / speed;
                exit = if at < exit.0 { (at, face) } else { exit };
            }
        }
        if exit.0 >= 1.0 {
            return Ok(tet);
        }
        tet = mesh.topology().neighbour(tet, exit.1).ok_or(exit.0.clamp(0.0, 1.0))?;
    }
    Err(1.0)
}
