//! One tick of one suture.

use crate::chain::{Chain, Eye, EyeHold, Held, ThreadLaw};
use crate::drive::{OnNeedle, is_open, nearest_angle, on_needle, pierce};
use crate::grips::{Jaw, let_go};
use crate::settings::SutureSettings;
use crate::tissue::Tissue;
use bevy_math::{DVec3, Isometry3d, Vec3, Vec3A};
use keyhole_tetmesh::TetId;
use keyhole_whiteboard::{Bite, Bites, HoleKind, Knots, Needle, Thread, ThreadGrip, TornBite};

/// Part of the way between its two strands that is left of a throw being pulled tight, from tick to tick.
const CLOSING: f64 = 0.95;

/// Part of a needle's radius that is the least tissue before a needle whose tip is inside: one that has just come in is not lost at once.
const SHALLOW: f32 = 0.25;

/// What a suture keeps from tick to tick besides what is on the whiteboard.
#[derive(Clone, Debug, Default)]
pub struct Works {
    /// The thread.
    pub chain: Chain,
    pub(crate) eyes: Vec<Eye>,
    /// By eye: what it belongs to.
    pub(crate) owners: Vec<Owner>,
    pub(crate) before: Vec<Eye>,
    pub(crate) held: Vec<Held>,
    pub(crate) strands: [Vec<(f64, DVec3)>; 2],
    pub(crate) places: [Vec<DVec3>; 2],
    pub(crate) near: Vec<TetId>,
    /// The winding of the tick before, unless it was of other strands.
    pub(crate) winding: Option<f64>,
    /// Bites and knots that it was counted from.
    pub(crate) counted: (usize, usize),
    /// Turns that the strands would have if they had not gone through each other.
    pub(crate) lost: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Owner {
    Hole(usize, usize),
    Knot(usize, usize),
}

/// A suture on the whiteboard.
#[derive(Debug)]
pub struct Suture<'a> {
    /// Its needle.
    pub needle: &'a mut Needle,
    /// Its thread.
    pub thread: &'a mut Thread,
    /// Its bites.
    pub bites: &'a mut Bites,
    /// Its knots.
    pub knots: &'a mut Knots,
    /// What else it keeps.
    pub works: &'a mut Works,
}

impl Suture<'_> {
    /// One tick of `dt_s` s, among organs as they are and jaws as they have moved: gravity in m/s2.
    pub fn tick(&mut self, organs: &[Tissue], jaws: &[Jaw], settings: &SutureSettings, gravity: Vec3, dt_s: f64) {
        self.string(settings);
        self.feel(organs, settings);
        self.hold(jaws, settings);
        self.drive(organs, jaws, settings);
        self.run(organs, jaws, settings, gravity, dt_s);
        self.settle_knots(settings);
        self.count_throws(settings);
        let Self { thread, works, .. } = self;
        thread.points.clear();
        thread.points.extend(works.chain.line(&works.eyes).map(|(_, p)| p.as_vec3()));
        thread.tension_n = works.chain.tension_n as f32;
        thread.end_tension_n = works.chain.end_tension_n.map(|t| t as f32);
    }

    /// The chain of a thread that has none yet.
    fn string(&mut self, settings: &SutureSettings) {
        if self.works.chain.places.is_empty() {
            let points = self.thread.points.iter().map(|p| p.as_dvec3());
            self.works.chain = Chain::along(points, f64::from(settings.segment_m)).unwrap_or_default();
        }
        self.thread.length_m = self.works.chain.length_m() as f32;
    }

    /// Finds the holes again after the tissue has changed, reads what they bear, and tears.
    fn feel(&mut self, organs: &[Tissue], settings: &SutureSettings) {
        let Bites { held, torn } = &mut *self.bites;
        let (needle, near) = (&*self.needle, &mut self.works.near);
        held.retain_mut(|bite| {
            let Some(organ) = refind(bite, organs) else { return false };
            let mut load = DVec3::ZERO;
            for hole in &mut bite.holes {
                let force = (hole.anchor.as_dvec3() - organ.place(&hole.point)) / f64::from(settings.compliance_m_n);
                hole.force_n = force.as_vec3();
                load += force;
            }
            bite.load_n = load.length() as f32;
            let Some((place, depth, load_n)) =
                (if is_open(bite) { stuck(needle, bite, organ, load, near) } else { borne(bite, organ, load) })
            else {
                return true;
            };
            bite.strength_n = organ.tear_n_m * depth as f32;
            let (place, load_n, strength_n) = (place.as_vec3(), load_n as f32, bite.strength_n);
            if load_n <= strength_n {
                return true;
            }
            torn.push(TornBite { organ: organ.organ, place, load_n, strength_n, depth_m: depth as f32 });
            false
        });
    }

    /// Jaws take hold of the needle and the thread, and let go.
    fn hold(&mut self, jaws: &[Jaw], settings: &SutureSettings) {
        let Self { needle, thread, works, .. } = self;
        let_go(needle, jaws);
        let thickness = 2.0 * needle.wire_radius_m;
        let lost = thread.tension_n > settings.grip_n;
        thread.grips.retain(|g| !lost && jaws.iter().any(|j| j.instrument == g.instrument && j.is_shut(thickness)));
        for jaw in jaws.iter().filter(|j| j.has_shut(thickness)) {
            if let Some(grip) = jaw.take_needle(needle) {
                needle.grips.push(grip);
                continue;
            }
            let chain = &works.chain;
            let swept = chain.places.iter().enumerate().filter_map(|(i, p)| jaw.swept(p.as_vec3()).map(|d| (d, i)));
            if let Some((_, i)) = swept.min_by(|a, b| a.0.total_cmp(&b.0)) {
                let local = jaw.pinched(chain.places[i].as_vec3());
                thread.grips.push(ThreadGrip { instrument: jaw.instrument, at_m: (chain.segment_m * i as f64) as f32, local });
            }
        }
    }

    /// Moves the needle and makes its holes.
    fn drive(&mut self, organs: &[Tissue], jaws: &[Jaw], settings: &SutureSettings) {
        let Self { needle, thread, bites, works, .. } = self;
        let (from, length) = (needle.pose, thread.length_m);
        let holder = needle.grips.first().and_then(|g| jaws.iter().find(|j| j.instrument == g.instrument).map(|j| j.pose * g.local));
        if let Some(to) = holder {
            needle.pose = to;
            pierce(needle, [&from, &to], length, organs, &mut bites.held, &mut works.near);
        } else {
            needle.pose.translation += drift(needle, bites, organs, length, works.chain.places.last());
        }
        let pose: Isometry3d = needle.pose;
        let threaded = works.chain.places.len() > 1;
        let on_thread = length - works.chain.clearance_m() as f32;
        for bite in &mut bites.held {
            let Some(organ) = organs.iter().find(|o| o.organ == bite.organ) else { continue };
            bite.holes.retain_mut(|hole| {
                if hole.at_m < length {
                    return true;
                }
                let place = organ.place(&hole.point);
                match on_needle(needle, &pose, length, hole.at_m, place, settings.needle_drag_n, settings.compliance_m_n) {
                    OnNeedle::Wire { at_m, anchor } => {
                        (hole.at_m, hole.anchor) = (at_m, anchor);
                        true
                    }
                    OnNeedle::Thread => {
                        hole.at_m = on_thread;
                        threaded
                    }
                    OnNeedle::Out => false,
                }
            });
            // Drawn back so far that the tip is inside again: what it had made on its way out is gone.
            if bite.holes.last().is_some_and(|h| h.kind == HoleKind::Channel) {
                bite.holes.pop();
            }
        }
        bites.held.retain(|b| !b.holes.is_empty());
    }

    /// Moves the thread.
    fn run(&mut self, organs: &[Tissue], jaws: &[Jaw], settings: &SutureSettings, gravity: Vec3, dt_s: f64) {
        self.gather_eyes(organs, settings);
        let Self { needle, thread, bites, knots, works } = self;
        let Works { chain, eyes, owners, held, .. } = &mut **works;
        if chain.places.len() < 2 {
            return;
        }
        held.clear();
        let last = chain.places.len() - 1;
        let in_tissue = bites.held.iter().flat_map(|b| &b.holes).any(|h| h.at_m >= thread.length_m);
        let carried = !needle.grips.is_empty() || in_tissue;
        if carried {
            held.push(Held { particle: last, to: needle.point(&needle.pose, 0.0).as_dvec3() });
        }
        for grip in &thread.grips {
            let particle = (f64::from(grip.at_m) / chain.segment_m).round() as usize;
            let jaw = jaws.iter().find(|j| j.instrument == grip.instrument);
            if let (Some(jaw), false) = (jaw, held.iter().any(|h| h.particle == particle)) {
                held.push(Held { particle, to: Vec3::from(jaw.pose.transform_point(grip.local)).as_dvec3() });
            }
        }
        let end_mass_kg = if carried { 0.0 } else { f64::from(needle.mass_kg) };
        let law = ThreadLaw { gravity: gravity.as_dvec3(), end_mass_kg, ..settings.thread };
        chain.step(&law, eyes, held, dt_s, settings.substeps.max(1) as usize);
        if !carried {
            let moved = chain.places[last].as_vec3() - needle.point(&needle.pose, 0.0);
            needle.pose.translation += Vec3A::from(moved);
        }
        for (eye, owner) in eyes.iter().zip(&*owners) {
            match *owner {
                Owner::Hole(b, h) => {
                    let hole = &mut bites.held[b].holes[h];
                    (hole.at_m, hole.anchor) = (eye.at_m as f32, eye.place.as_vec3());
                }
                Owner::Knot(k, side) => {
                    let knot = &mut knots.tied[k];
                    (knot.at_m[side], knot.place) = (eye.at_m as f32, eye.place.as_vec3());
                }
            }
        }
        // The tail has come through.
        let end = 1.05 * chain.clearance_m();
        for bite in &mut bites.held {
            bite.holes.retain(|h| f64::from(h.at_m) > end);
        }
        bites.held.retain(|b| !b.holes.is_empty());
    }

    /// The eyes of all holes that the thread is in and of all knots, in order along the thread.
    fn gather_eyes(&mut self, organs: &[Tissue], settings: &SutureSettings) {
        let Self { thread, bites, knots, works, .. } = self;
        let Works { chain, eyes, owners, before, .. } = &mut **works;
        std::mem::swap(eyes, before);
        eyes.clear();
        owners.clear();
        let known = |at_m: f32, hold: EyeHold| {
            let same = |e: &&Eye| e.at_m as f32 == at_m && std::mem::discriminant(&e.hold) == std::mem::discriminant(&hold);
            before.iter().find(same).map(|e| Eye { hold, ..*e })
        };
        for (b, bite) in bites.held.iter().enumerate() {
            let Some(organ) = organs.iter().find(|o| o.organ == bite.organ) else { continue };
            for (h, hole) in bite.holes.iter().enumerate().filter(|(_, hole)| hole.at_m < thread.length_m) {
                let place = organ.place(&hole.point);
                let hold = EyeHold::Tissue { place, compliance_m_n: f64::from(settings.compliance_m_n) };
                let drag_n = [f64::from(settings.thread_drag_n); 2];
                let eye = known(hole.at_m, hold).unwrap_or_else(|| Eye::new(hold, f64::from(hole.at_m), place));
                eyes.push(Eye { drag_n, friction: f64::from(settings.friction), ..eye });
                owners.push(Owner::Hole(b, h));
            }
        }
        for (k, knot) in knots.tied.iter().enumerate() {
            let [slip, tighten] = settings.knot.drags(knot);
            let [tail, needle] = [0, 1].map(|side| known(knot.at_m[side], EyeHold::Knot(k)));
            let [tail, needle] = match (tail, needle) {
                (Some(tail), Some(needle)) => [tail, Eye { offset: needle.offset * CLOSING, ..needle }],
                _ => {
                    let [tail, needle] = knot.at_m.map(|at| Eye::new(EyeHold::Knot(k), f64::from(at), chain.place_at(f64::from(at))));
                    [tail, Eye { offset: needle.place - tail.place, ..needle }]
                }
            };
            eyes.extend([Eye { drag_n: [slip, tighten], ..tail }, Eye { drag_n: [tighten, slip], ..needle }]);
            owners.extend([Owner::Knot(k, 0), Owner::Knot(k, 1)]);
        }
        // A few eyes, almost in order: insertion keeps both lists together.
        for i in 1..eyes.len() {
            for j in (1..=i).rev() {
                if eyes[j - 1].at_m <= eyes[j].at_m {
                    break;
                }
                eyes.swap(j - 1, j);
                owners.swap(j - 1, j);
            }
        }
        let mut most = chain.length_m() - chain.clearance_m();
        for eye in eyes.iter_mut().rev() {
            eye.at_m = eye.at_m.min(most);
            most = eye.at_m - chain.clearance_m();
        }
    }
}

/// Where a bite bears a load (N), m, how much tissue there is before it, m, and how much of the load that is, N: the middle of its way, without that any hole.
fn borne(bite: &Bite, organ: &Tissue, load: DVec3) -> Option<(DVec3, f64, f64)> {
    let middle = bite.holes.iter().find(|h| h.kind == HoleKind::Channel).or(bite.holes.first())?;
    Some((organ.place(&middle.point), organ.depth(&middle.point, load.try_normalize()?)?, load.length()))
}

/// The same of a needle whose tip is still inside: in the middle of what is inside of its wire. A needle that was carried out of the tissue sideways has none before it.
fn stuck(needle: &Needle, bite: &Bite, organ: &Tissue, load: DVec3, near: &mut Vec<TetId>) -> Option<(DVec3, f64, f64)> {
    let entry = bite.holes.first()?;
    let surface = organ.place(&entry.point);
    let middle = 0.5 * (nearest_angle(needle, &needle.pose, surface) as f32 + needle.arc_rad);
    let along = needle.forward(&needle.pose, middle).as_dvec3();
    // Along itself it slides.
    let across = load.reject_from_normalized(along);
    let way = across.try_normalize()?;
    let inside = needle.point(&needle.pose, middle).as_dvec3();
    let size = DVec3::splat(f64::from(needle.wire_radius_m));
    organ.near(inside - size, inside + size, near);
    let depth = organ.at(inside, near).map_or(Some(0.0), |point| organ.depth(&point, way))?;
    Some((inside, depth.max(f64::from(SHALLOW * needle.radius_m)), across.length()))
}

/// The organ that a bite is in now, its holes found again where a cut went between their nodes; `None` where the tissue is gone.
fn refind<'a, 'b>(bite: &mut Bite, organs: &'a [Tissue<'b>]) -> Option<&'a Tissue<'b>> {
    let own = organs.iter().find(|o| o.organ == bite.organ)?;
    if bite.holes.iter().all(|h| own.tet_of(&h.point).is_some()) {
        return Some(own);
    }
    let first = bite.holes.first()?.rest.as_dvec3();
    let organ = organs.iter().find(|o| o.at_rest(first).is_some())?;
    for hole in &mut bite.holes {
        hole.point = organ.at_rest(hole.rest.as_dvec3())?;
    }
    bite.organ = organ.organ;
    Some(organ)
}

/// How a needle that nobody holds moves in a tick, m: with the tissue that it is in, else with the end of its thread.
fn drift(needle: &Needle, bites: &Bites, organs: &[Tissue], length_m: f32, end: Option<&DVec3>) -> Vec3A {
    let (mut sum, mut count) = (DVec3::ZERO, 0.0);
    for bite in &bites.held {
        let Some(organ) = organs.iter().find(|o| o.organ == bite.organ) else { continue };
        for hole in bite.holes.iter().filter(|h| h.at_m >= length_m) {
            sum += organ.place(&hole.point) - hole.anchor.as_dvec3();
            count += 1.0;
        }
    }
    if count > 0.0 {
        return Vec3A::from((sum / count).as_vec3());
    }
    end.map_or(Vec3A::ZERO, |end| Vec3A::from(end.as_vec3() - needle.point(&needle.pose, 0.0)))
}
