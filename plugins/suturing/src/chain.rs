//! A thread as a chain of material points, and what moves it in a tick.
//!
//! Particles lie evenly along the thread. Where it runs through tissue or a knot there is an *eye*: one more point of the chain whose place along the
//! thread changes as the thread slides through it (Sueda et al., "Large-scale dynamic simulation of highly constrained strands", SIGGRAPH 2011).
//!
//! A substep predicts, bends (a sweep of XPBD over three neighbours at a time: Macklin et al. 2016), and then solves the implicit step for all constraints at once:
//! `m (x - predicted) = J^T l`, `C + a l = 0`, with `a` the compliance over `dt^2` and `-l / dt^2` the tension. A span between neighbours has its length, an eye
//! is held to its tissue by a compliance, both sides of a knot are in one place. The matrix of `l` is a band but for the knots, so that a solve costs as much as
//! a sweep of a relaxation does, and a pull at one end is felt at the other at once, however long the thread.
//!
//! A thread does not push: a span that is shorter than its thread resists with no more than its inertia, as if the thread were wound up in it.
//!
//! A taut thread is stiff sideways too, by its tension over the length of its spans, and so light that an explicit tension would throw it about: Newton's method takes the
//! double of that as mass, which bounds it from above (after Andrews, Teichmann, Kry, "Geometric stiffness for real-time constrained multibody
//! dynamics", Eurographics 2017). What is solved does not depend on it; where the steps end early the thread is late sideways, never early.
//!
//! At an eye tension differs by no more than friction holds. There the spans on both sides are one constraint while the thread slides, with the friction as a force on top;
//! an eye at rest holds its place along the thread. Which eyes slide is found by trying: solve, look at the tensions, solve again.

use crate::solve::Work;
use bevy_math::DVec3;

/// What a thread is made of, and what it hangs in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThreadLaw {
    /// Mass per length, kg/m.
    pub line_density_kg_m: f64,
    /// Tension per strain, N.
    pub stretch_n: f64,
    /// Moment per curvature, N m2.
    pub bending_n_m2: f64,
    /// Rate at which it loses its speed, 1/s.
    pub damping_1_s: f64,
    /// m/s2.
    pub gravity: DVec3,
    /// Mass of the needle on its end, kg.
    pub end_mass_kg: f64,
}

/// How an eye is held.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum EyeHold {
    /// To a point (m) by a compliance (m/N).
    Tissue {
        /// Where.
        place: DVec3,
        /// How softly.
        compliance_m_n: f64,
    },
    /// To the other eye of the same knot.
    Knot(usize),
}

/// Which way the thread moves through an eye.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Slide {
    /// It does not.
    #[default]
    Rests,
    /// Away from its tail.
    Forward,
    /// Towards its tail.
    Back,
}

/// A point that the thread runs through.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Eye {
    /// How it is held.
    pub hold: EyeHold,
    /// Which length from the tail is there, m.
    pub at_m: f64,
    /// Where it is, m.
    pub place: DVec3,
    /// m/s.
    pub velocity: DVec3,
    /// Of the second eye of a knot: how far it still is from the first, m.
    pub offset: DVec3,
    /// Difference of tension that it holds against [`Slide::Forward`] and [`Slide::Back`], N.
    pub drag_n: [f64; 2],
    /// Coulomb's coefficient where the thread turns: the capstan's law.
    pub friction: f64,
    /// What it did last.
    pub slide: Slide,
    /// Tension on the side of the tail and on that of the needle, N.
    pub tension_n: [f64; 2],
}

impl Eye {
    /// An eye where the thread is, at rest.
    #[must_use]
    pub fn new(hold: EyeHold, at_m: f64, place: DVec3) -> Self {
        let (velocity, offset, slide) = (DVec3::ZERO, DVec3::ZERO, Slide::Rests);
        Self { hold, at_m, place, velocity, offset, drag_n: [0.0; 2], friction: 0.0, slide, tension_n: [0.0; 2] }
    }

    /// What friction adds to the smaller tension where the thread turns by this angle, in this direction, N.
    pub(crate) fn most_difference(&self, forward: bool, smaller_n: f64, turn_rad: f64) -> f64 {
        self.drag_n[usize::from(!forward)] + smaller_n.max(0.0) * ((self.friction * turn_rad).exp() - 1.0)
    }
}

/// A particle that something moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Held {
    /// Which.
    pub particle: usize,
    /// Where it is at the end of the tick, m.
    pub to: DVec3,
}

/// Nearer to an eye than this part of a segment there is no particle, and no second eye.
pub const CLEARANCE: f64 = 0.15;
/// Trials of which eyes slide, at most.
const TRIALS: usize = 6;

/// A thread: particles evenly along it.
#[derive(Clone, Debug, Default)]
pub struct Chain {
    /// Places, from the tail to the swage, m.
    pub places: Vec<DVec3>,
    /// m/s.
    pub velocities: Vec<DVec3>,
    /// Length of thread between neighbours, m.
    pub segment_m: f64,
    /// Largest tension after the last tick, N.
    pub tension_n: f64,
    /// Tension at the tail and at the swage after the last tick, N.
    pub end_tension_n: [f64; 2],
    /// Substeps that were not taken: their result was not finite, or farther away than the thread is long.
    pub refused: u64,
    /// Tension of the segment that ends at each particle, N.
    pub(crate) tensions: Vec<f64>,
    work: Work,
}

impl Chain {
    /// A chain along a polyline (m) whose segments are as near to `segment_m` as they can be; `None` for fewer than two points or no length.
    #[must_use]
    pub fn along(points: impl Iterator<Item = DVec3> + Clone, segment_m: f64) -> Option<Self> {
        let length: f64 = points.clone().zip(points.clone().skip(1)).map(|(a, b)| a.distance(b)).sum();
        if !(length.is_finite() && length > 0.0 && segment_m > 0.0) {
            return None;
        }
        let count = (length / segment_m).round().max(2.0) as usize;
        let mut places = Vec::with_capacity(count + 1);
        let mut gone = 0.0;
        for (a, b) in points.clone().zip(points.clone().skip(1)) {
            let step = a.distance(b);
            while places.len() < count && length * places.len() as f64 / count as f64 <= gone + step {
                let t = (length * places.len() as f64 / count as f64 - gone) / step.max(f64::MIN_POSITIVE);
                places.push(a.lerp(b, t));
            }
            gone += step;
        }
        let last = points.last()?;
        places.resize(count + 1, last);
        Some(Self { velocities: vec![DVec3::ZERO; count + 1], places, segment_m: length / count as f64, ..Self::default() })
    }

    /// Its length, m.
    #[must_use]
    pub fn length_m(&self) -> f64 {
        self.segment_m * self.places.len().saturating_sub(1) as f64
    }

    /// Least distance along the thread of an eye from an end, a held particle or another eye, m.
    #[must_use]
    pub fn clearance_m(&self) -> f64 {
        CLEARANCE * self.segment_m
    }

    /// Where a length from the tail (m) is, m. The chain has two points or more.
    #[must_use]
    pub fn place_at(&self, at_m: f64) -> DVec3 {
        let along = (at_m / self.segment_m).clamp(0.0, (self.places.len() - 1) as f64);
        let i = (along as usize).min(self.places.len() - 2);
        self.places[i].lerp(self.places[i + 1], along - i as f64)
    }

    /// Largest tension between two lengths from the tail (m), N.
    #[must_use]
    pub fn tension_between(&self, from_m: f64, to_m: f64) -> f64 {
        let within = |i: usize| (from_m..=to_m).contains(&(self.segment_m * i as f64));
        self.tensions.iter().enumerate().skip(1).filter(|(i, _)| within(i - 1) && within(*i)).map(|(_, t)| *t).fold(0.0, f64::max)
    }

    /// Lengths from the tail (m) and places (m) of all that the thread runs through, in order: its centre line.
    pub fn line<'a>(&'a self, eyes: &'a [Eye]) -> impl Iterator<Item = (f64, DVec3)> + 'a {
        let clear = self.clearance_m();
        let mut eye = 0;
        let mut particle = 0;
        std::iter::from_fn(move || {
            loop {
                let at = self.segment_m * particle as f64;
                if eye < eyes.len() && eyes[eye].at_m < at {
                    eye += 1;
                    return Some((eyes[eye - 1].at_m, eyes[eye - 1].place));
                }
                let place = *self.places.get(particle)?;
                particle += 1;
                let end = particle == 1 || particle == self.places.len();
                if end || eyes.iter().all(|e| (e.at_m - at).abs() >= clear) {
                    return Some((at, place));
                }
            }
        })
    }

    /// Moves the thread for `dt` s in `substeps`. `eyes` by ascending length; both eyes of a knot are there. Places and lengths of the eyes, tensions are written.
    pub fn step(&mut self, law: &ThreadLaw, eyes: &mut [Eye], held: &[Held], dt: f64, substeps: usize) {
        if self.places.len() < 2 {
            return;
        }
        for s in 0..substeps {
            let share = 1.0 / (substeps - s) as f64;
            for h in held {
                // Where it is at the end of this substep: evenly towards its end.
                let place = self.places[h.particle];
                self.velocities[h.particle] = (h.to - place) * share / (dt / substeps as f64);
            }
            self.substep(law, eyes, held, dt / substeps as f64);
        }
    }

    fn substep(&mut self, law: &ThreadLaw, eyes: &mut [Eye], held: &[Held], dt: f64) {
        let mut work = std::mem::take(&mut self.work);
        work.gather(self, law, eyes, held, dt);
        work.bend(self, law, dt);
        for trial in 0..TRIALS {
            work.project(law, eyes, dt);
            // The last trial stands as it is.
            if !work.try_slides(eyes, self.clearance_m(), trial + 1 == TRIALS) {
                break;
            }
        }
        if work.is_sound(self.length_m()) {
            work.scatter(self, eyes, dt);
        } else {
            self.velocities.fill(DVec3::ZERO);
            self.refused += 1;
        }
        self.work = work;
    }
}
