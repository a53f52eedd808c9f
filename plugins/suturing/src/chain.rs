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

use crate::skyline::Skyline;
use bevy_math::DVec3;
use smallvec::SmallVec;

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
    fn most_difference(&self, forward: bool, smaller_n: f64, turn_rad: f64) -> f64 {
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
/// Newton steps of a projection at most.
const STEPS: usize = 60;
/// A sliding thread that is pushed by more than this part of its pull rests.
const PUSH: f64 = 0.1;
/// Solves of a Newton step until the stiffness sideways fits its tensions, at most.
const STIFFENINGS: usize = 4;
/// A tension is new when it is so many times what was known.
const TAUTER: f64 = 4.0;
/// Part of the longest span to which a projection is exact.
const PRECISION: f64 = 1e-4;
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
    tensions: Vec<f64>,
    work: Work,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Who {
    Particle(usize),
    Eye(usize),
}

#[derive(Clone, Copy, Debug)]
struct Node {
    who: Who,
    /// Length from the tail, m.
    at_m: f64,
    start: DVec3,
    predicted: DVec3,
    place: DVec3,
    /// kg; infinite for what something moves.
    mass: f64,
    /// One over the mass with the thread's stiffness sideways, 1/kg; zero for what something moves.
    inverse: f64,
    /// Tension of the span that ends here and of the one that begins here, N.
    tension: [f64; 2],
    /// What friction adds to the tension on the pulled side of a sliding eye, N.
    drag: f64,
    /// What the constraints leave of `m (x - predicted)`, kg m.
    residual: DVec3,
}

#[derive(Clone, Copy, Debug)]
enum Row {
    /// The way from one node to another along the chain is as long as the thread between them.
    Span { from: usize, to: usize },
    /// A coordinate of a node is held.
    Tie { node: usize, axis: usize, place: DVec3 },
    /// A coordinate of two nodes is the same.
    Link { nodes: [usize; 2], axis: usize, offset: f64 },
}

type Gradients = SmallVec<[(usize, DVec3); 8]>;

#[derive(Clone, Debug, Default)]
struct Work {
    nodes: Vec<Node>,
    rows: Vec<Row>,
    /// By node: rows and gradients.
    around: Vec<Gradients>,
    first: Vec<usize>,
    matrix: Skyline,
    right: Vec<f64>,
    multipliers: Vec<f64>,
    /// By row, of the side of its law that it is on.
    compliances: Vec<f64>,
    /// By row, of a span that is pulled.
    stiff: Vec<f64>,
    /// By row, the right-hand side before what the residuals add.
    errors: Vec<f64>,
    /// Of a span that is pushed.
    soft: f64,
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

    /// Where a length from the tail (m) is, m.
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

impl Work {
    /// Nodes in order, predicted.
    fn gather(&mut self, chain: &Chain, law: &ThreadLaw, eyes: &[Eye], held: &[Held], dt: f64) {
        let (mass, last) = (law.line_density_kg_m * chain.segment_m, chain.places.len() - 1);
        let keep = (-law.damping_1_s * dt).exp();
        let clear = chain.clearance_m();
        self.nodes.clear();
        let mut node = |who, at_m, place: DVec3, velocity: DVec3, mass: f64, tension| {
            let predicted = if mass.is_finite() { place + (velocity * keep + law.gravity * dt) * dt } else { place + velocity * dt };
            let (residual, drag) = (DVec3::ZERO, 0.0);
            self.nodes.push(Node {
                who,
                at_m,
                start: place,
                predicted,
                place: predicted,
                mass,
                inverse: 1.0 / mass,
                tension,
                drag,
                residual,
            });
        };
        let before = |i: usize| chain.tensions.get(i).copied().unwrap_or(0.0);
        let mut next = 0;
        for (i, (place, velocity)) in chain.places.iter().zip(&chain.velocities).enumerate() {
            let at = chain.segment_m * i as f64;
            while next < eyes.len() && eyes[next].at_m < at {
                node(Who::Eye(next), eyes[next].at_m, eyes[next].place, eyes[next].velocity, mass, eyes[next].tension_n);
                next += 1;
            }
            let is_held = held.iter().any(|h| h.particle == i);
            let own = match i {
                0 => mass / 2.0,
                _ if i == last => mass / 2.0 + law.end_mass_kg,
                _ => mass,
            };
            if i == 0 || i == last || is_held || eyes.iter().all(|e| (e.at_m - at).abs() >= clear) {
                node(Who::Particle(i), at, *place, *velocity, if is_held { f64::INFINITY } else { own }, [before(i), before(i + 1)]);
            }
        }
    }

    /// One sweep of XPBD over the second differences of three neighbours: `E = B/(2 h^3) |a - 2 b + c|^2`.
    fn bend(&mut self, chain: &Chain, law: &ThreadLaw, dt: f64) {
        if law.bending_n_m2 <= 0.0 {
            return;
        }
        let soft = chain.segment_m.powi(3) / (law.bending_n_m2 * dt * dt);
        for i in 1..self.nodes.len() - 1 {
            let [a, b, c] = [i - 1, i, i + 1].map(|n| self.nodes[n]);
            let (Who::Particle(pa), Who::Particle(pb), Who::Particle(pc)) = (a.who, b.who, c.who) else { continue };
            if pb != pa + 1 || pc != pb + 1 {
                continue;
            }
            let weight = a.inverse + 4.0 * b.inverse + c.inverse;
            let pull = (a.predicted - 2.0 * b.predicted + c.predicted) / (weight + soft);
            for (n, factor) in [(i - 1, -1.0), (i, 2.0), (i + 1, -1.0)] {
                let w = self.nodes[n].inverse;
                self.nodes[n].predicted += factor * w * pull;
            }
        }
    }

    /// The rows of the constraints, each with the node where it begins.
    fn list_rows(&mut self, eyes: &[Eye]) {
        self.rows.clear();
        let mut from = 0;
        let mut ties = 0;
        for n in 0..self.nodes.len() {
            let slides = matches!(self.nodes[n].who, Who::Eye(e) if eyes[e].slide != Slide::Rests);
            if n > 0 && !slides {
                self.rows.push(Row::Span { from, to: n });
                from = n;
            }
            if !slides {
                // The ties of the eyes within the span and of this node.
                for node in ties..=n {
                    if let Who::Eye(e) = self.nodes[node].who {
                        if let EyeHold::Tissue { place, .. } = eyes[e].hold {
                            self.rows.extend((0..3).map(|axis| Row::Tie { node, axis, place }));
                        }
                    }
                }
                ties = n + 1;
            }
        }
        for (n, node) in self.nodes.iter().enumerate() {
            let Who::Eye(e) = node.who else { continue };
            let EyeHold::Knot(knot) = eyes[e].hold else { continue };
            let other = self.nodes[n + 1..].iter().position(|o| matches!(o.who, Who::Eye(e) if eyes[e].hold == EyeHold::Knot(knot)));
            if let Some(other) = other {
                let second = n + 1 + other;
                let Who::Eye(e) = self.nodes[second].who else { continue };
                self.rows.extend((0..3).map(|axis| Row::Link { nodes: [n, second], axis, offset: eyes[e].offset[axis] }));
            }
        }
    }

    /// From the prediction onto all constraints.
    fn project(&mut self, law: &ThreadLaw, eyes: &[Eye], dt: f64) {
        for node in &mut self.nodes {
            (node.place, node.drag) = (node.predicted, 0.0);
        }
        self.list_rows(eyes);
        let count = self.rows.len();
        self.multipliers.clear();
        self.multipliers.resize(count, 0.0);
        self.compliances.clear();
        let length = |from: usize, to: usize, nodes: &[Node]| nodes[to].at_m - nodes[from].at_m;
        let shortest = self.nodes.windows(2).map(|n| n[1].at_m - n[0].at_m).fold(f64::INFINITY, f64::min);
        let longest = self.nodes.windows(2).map(|n| n[1].at_m - n[0].at_m).fold(0.0, f64::max);
        for row in &self.rows {
            let compliance = match row {
                Row::Span { from, to } => length(*from, *to, &self.nodes) / law.stretch_n,
                Row::Tie { node, .. } => match self.nodes[*node].who {
                    Who::Eye(e) => match eyes[e].hold {
                        EyeHold::Tissue { compliance_m_n, .. } => compliance_m_n,
                        EyeHold::Knot(_) => 0.0,
                    },
                    Who::Particle(_) => 0.0,
                },
                Row::Link { .. } => shortest / law.stretch_n,
            };
            self.compliances.push(compliance / (dt * dt));
        }
        self.stiff.clone_from(&self.compliances);
        self.soft = 1.0 / (law.line_density_kg_m * longest);
        self.around.resize_with(self.nodes.len().max(self.around.len()), SmallVec::new);
        for _ in 0..STEPS {
            if self.newton_step(eyes, dt) < PRECISION {
                break;
            }
        }
    }

    /// One Newton step; returns the largest of the errors of the constraints before it and of its moves, as part of the longest span.
    fn newton_step(&mut self, eyes: &[Eye], dt: f64) -> f64 {
        let spans = self.nodes.windows(2).map(|n| n[1].at_m - n[0].at_m);
        let longest = spans.fold(0.0, f64::max);
        let worst = self.evaluate();
        self.put_friction(eyes, dt);
        self.errors.clone_from(&self.right);
        for _ in 0..STIFFENINGS {
            self.stiffen(dt);
            self.right.clone_from(&self.errors);
            self.assemble();
            self.matrix.factor();
            self.matrix.solve(&mut self.right);
            // A thread that becomes taut in this very step is stiff sideways in it.
            if !self.tautens(dt) {
                break;
            }
        }
        let moves = |around: &Gradients, node: &Node, right: &[f64]| {
            node.inverse * (around.iter().map(|(r, g)| right[*r] * *g).sum::<DVec3>() - node.residual)
        };
        let farthest = self.around.iter().zip(&self.nodes).map(|(a, n)| moves(a, n, &self.right).length()).fold(0.0, f64::max);
        let part = (2.0 * longest / farthest).min(1.0);
        for (multiplier, step) in self.multipliers.iter_mut().zip(&self.right) {
            *multiplier += part * step;
        }
        for (around, node) in self.around.iter().zip(&mut self.nodes) {
            node.place += part * moves(around, node, &self.right);
        }
        self.read_tensions(eyes, dt);
        worst.max(farthest) / longest
    }

    /// Whether the step that has been solved pulls a span much harder than the stiffness sideways was for; takes those tensions for the next.
    fn tautens(&mut self, dt: f64) -> bool {
        let mut more = false;
        for (r, row) in self.rows.iter().enumerate() {
            let Row::Span { from, to } = *row else { continue };
            let tension = -(self.multipliers[r] + self.right[r]) / (dt * dt);
            for n in from..to {
                if tension > TAUTER * self.nodes[n].tension[1].max(0.0) {
                    more |= tension * dt * dt > 20.0 * self.nodes[n].mass * (self.nodes[n + 1].at_m - self.nodes[n].at_m);
                    self.nodes[n].tension[1] = tension;
                    self.nodes[n + 1].tension[0] = tension;
                }
            }
        }
        more
    }

    /// Masses with the stiffness sideways of the tensions that are known.
    fn stiffen(&mut self, dt: f64) {
        for n in 0..self.nodes.len() {
            let at = |n: usize| self.nodes[n].at_m;
            let [left, right] = self.nodes[n].tension.map(|t| t.max(0.0));
            let mut stiffness = 0.0;
            if n > 0 {
                stiffness += left / (at(n) - at(n - 1));
            }
            if n + 1 < self.nodes.len() {
                stiffness += right / (at(n + 1) - at(n));
            }
            self.nodes[n].inverse = 1.0 / (self.nodes[n].mass + 2.0 * stiffness * dt * dt);
        }
    }

    /// Errors and gradients of all rows, and the residuals of the nodes; returns the largest error, m.
    fn evaluate(&mut self) -> f64 {
        for around in &mut self.around {
            around.clear();
        }
        self.right.clear();
        let mut worst: f64 = 0.0;
        for r in 0..self.rows.len() {
            let error = match self.rows[r] {
                Row::Span { from, to } => {
                    let rest = self.nodes[to].at_m - self.nodes[from].at_m;
                    let mut length = 0.0;
                    for n in from..to {
                        let step = self.nodes[n + 1].place - self.nodes[n].place;
                        let long = step.length();
                        // Two nodes in one place pull in no direction.
                        let along = if long > 1e-9 * rest { step / long } else { DVec3::ZERO };
                        length += long;
                        self.gradient(n, r, -along);
                        self.gradient(n + 1, r, along);
                    }
                    length - rest
                }
                Row::Tie { node, axis, place } => {
                    self.gradient(node, r, DVec3::AXES[axis]);
                    self.nodes[node].place[axis] - place[axis]
                }
                Row::Link { nodes: [a, b], axis, offset } => {
                    self.gradient(a, r, -DVec3::AXES[axis]);
                    self.gradient(b, r, DVec3::AXES[axis]);
                    self.nodes[b].place[axis] - self.nodes[a].place[axis] - offset
                }
            };
            if matches!(self.rows[r], Row::Span { .. }) {
                self.compliances[r] = if error > 0.0 { self.stiff[r] } else { self.soft };
            }
            let left = error + self.compliances[r] * self.multipliers[r];
            worst = worst.max(left.abs());
            self.right.push(-left);
        }
        for (around, node) in self.around.iter().zip(&mut self.nodes) {
            let free = if node.mass.is_finite() { node.mass * (node.place - node.predicted) } else { DVec3::ZERO };
            node.residual = free - around.iter().map(|(r, g)| self.multipliers[*r] * *g).sum::<DVec3>();
        }
        worst
    }

    /// The matrix, and what the residuals move into the right-hand side.
    fn assemble(&mut self) {
        self.first.clear();
        self.first.extend(0..self.rows.len());
        for around in &self.around[..self.nodes.len()] {
            let first = around.iter().map(|(r, _)| *r).min().unwrap_or(0);
            for (r, _) in around {
                self.first[*r] = self.first[*r].min(first);
            }
        }
        self.matrix.reset(self.first.iter().copied());
        for (r, compliance) in self.compliances.iter().enumerate() {
            self.matrix.add(r, r, *compliance);
        }
        for (around, node) in self.around.iter().zip(&self.nodes) {
            for (r, a) in around {
                self.right[*r] += node.inverse * a.dot(node.residual);
                for (c, b) in around.iter().filter(|(c, _)| c <= r) {
                    self.matrix.add(*r, *c, node.inverse * a.dot(*b));
                }
            }
        }
    }

    /// Puts a row's gradient at a node in; what is there already is added to.
    fn gradient(&mut self, node: usize, row: usize, gradient: DVec3) {
        match self.around[node].iter_mut().find(|(r, _)| *r == row) {
            Some((_, g)) => *g += gradient,
            None => self.around[node].push((row, gradient)),
        }
    }

    /// Friction at sliding eyes: the span on the pulled side has more tension than the other.
    fn put_friction(&mut self, eyes: &[Eye], dt: f64) {
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

    fn read_tensions(&mut self, eyes: &[Eye], dt: f64) {
        for (row, multiplier) in self.rows.iter().zip(&self.multipliers) {
            let Row::Span { from, to } = *row else { continue };
            for n in from..to {
                self.nodes[n].tension[1] = -multiplier / (dt * dt);
                self.nodes[n + 1].tension[0] = -multiplier / (dt * dt);
            }
        }
        for n in 1..self.nodes.len().saturating_sub(1) {
            let (Who::Eye(e), drag) = (self.nodes[n].who, self.nodes[n].drag) else { continue };
            match eyes[e].slide {
                Slide::Rests => {}
                Slide::Forward => {
                    self.nodes[n].tension[1] += drag;
                    self.nodes[n + 1].tension[0] += drag;
                }
                Slide::Back => {
                    self.nodes[n].tension[0] += drag;
                    self.nodes[n - 1].tension[1] += drag;
                }
            }
        }
    }

    /// Lets eyes slide or rest by what the tensions are now; whether any changed.
    fn try_slides(&mut self, eyes: &mut [Eye], clear: f64, last: bool) -> bool {
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
    fn slid_to(&self, node: usize, eyes: &[Eye]) -> f64 {
        let slides = |n: usize| matches!(self.nodes[n].who, Who::Eye(e) if eyes[e].slide != Slide::Rests);
        let from = (0..node).rev().find(|n| !slides(*n)).unwrap_or(0);
        let to = (node + 1..self.nodes.len()).find(|n| !slides(*n)).unwrap_or(self.nodes.len() - 1);
        let way = |from: usize, to: usize| self.nodes[from..=to].windows(2).map(|n| n[0].place.distance(n[1].place)).sum::<f64>();
        let whole = way(from, to);
        let part = if whole > 0.0 { way(from, node) / whole } else { 0.5 };
        self.nodes[from].at_m + part * (self.nodes[to].at_m - self.nodes[from].at_m)
    }

    /// How much thread there is to slide through an eye that way, m: up to the next eye, end or held particle.
    fn room(&self, node: usize, way: Slide, clear: f64) -> f64 {
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

    /// Whether the result can be taken.
    fn is_sound(&self, length_m: f64) -> bool {
        self.nodes.iter().all(|n| n.place.distance(n.predicted) <= length_m || n.mass.is_infinite() && n.place.is_finite())
    }

    /// Back to the chain and its eyes.
    fn scatter(&mut self, chain: &mut Chain, eyes: &mut [Eye], dt: f64) {
        chain.tension_n = self.nodes[1..].iter().map(|n| n.tension[0]).fold(0.0, f64::max);
        chain.end_tension_n = [self.nodes.first().map_or(0.0, |n| n.tension[1]), self.nodes.last().map_or(0.0, |n| n.tension[0])];
        chain.tensions.resize(chain.places.len(), 0.0);
        for n in 0..self.nodes.len() {
            let Node { who, start, place, tension, .. } = self.nodes[n];
            match who {
                Who::Particle(i) => {
                    (chain.places[i], chain.velocities[i], chain.tensions[i]) = (place, (place - start) / dt, tension[0]);
                }
                Who::Eye(e) => {
                    if eyes[e].slide != Slide::Rests {
                        let wanted = self.slid_to(n, eyes);
                        let at = self.nodes[n].at_m;
                        let clear = chain.clearance_m();
                        let (forward, back) = (self.room(n, Slide::Forward, clear), self.room(n, Slide::Back, clear));
                        eyes[e].at_m = wanted.clamp(at - forward.max(0.0), at + back.max(0.0));
                    }
                    (eyes[e].place, eyes[e].velocity) = (place, (place - start) / dt);
                }
            }
        }
        // Two eyes that slide towards each other keep their distance.
        for e in 1..eyes.len() {
            let least = eyes[e - 1].at_m + chain.clearance_m();
            eyes[e].at_m = eyes[e].at_m.max(least.min(chain.length_m()));
        }
        // What has no node lies on the line between its neighbours.
        let mut next = 1;
        for i in 1..chain.places.len() - 1 {
            let at = chain.segment_m * i as f64;
            while next + 1 < self.nodes.len() && self.nodes[next].at_m < at {
                next += 1;
            }
            let (a, b) = (self.nodes[next - 1], self.nodes[next]);
            if b.who == Who::Particle(i) || a.who == Who::Particle(i) {
                continue;
            }
            chain.tensions[i] = b.tension[0];
            let place = a.place.lerp(b.place, (at - a.at_m) / (b.at_m - a.at_m));
            (chain.velocities[i], chain.places[i]) = ((place - chain.places[i]) / dt, place);
        }
    }
}

/// The angle by which a way turns in its middle, rad.
fn turn(from: DVec3, over: DVec3, to: DVec3) -> f64 {
    let (before, after) = (over - from, to - over);
    before.cross(after).length().atan2(before.dot(after))
}
