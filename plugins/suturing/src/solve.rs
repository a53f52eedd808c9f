//! The implicit step of a chain: nodes, constraints, and Newton's method on them. What is solved is said in [`crate::chain`].

use crate::chain::{Chain, Eye, EyeHold, Held, Slide, ThreadLaw};
use crate::skyline::Skyline;
use bevy_math::DVec3;
use smallvec::SmallVec;

/// Newton steps of a projection at most.
const STEPS: usize = 60;
/// Solves of a Newton step until the stiffness sideways fits its tensions, at most.
const STIFFENINGS: usize = 4;
/// A tension is new when it is so many times what was known.
const TAUTER: f64 = 4.0;
/// Part of the longest span to which a projection is exact.
const PRECISION: f64 = 1e-4;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Who {
    Particle(usize),
    Eye(usize),
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Node {
    pub(crate) who: Who,
    /// Length from the tail, m.
    pub(crate) at_m: f64,
    pub(crate) start: DVec3,
    pub(crate) predicted: DVec3,
    pub(crate) place: DVec3,
    /// kg; infinite for what something moves.
    pub(crate) mass: f64,
    /// One over the mass with the thread's stiffness sideways, 1/kg; zero for what something moves.
    pub(crate) inverse: f64,
    /// Tension of the span that ends here and of the one that begins here, N.
    pub(crate) tension: [f64; 2],
    /// What friction adds to the tension on the pulled side of a sliding eye, N.
    pub(crate) drag: f64,
    /// What the constraints leave of `m (x - predicted)`, kg m.
    pub(crate) residual: DVec3,
}

#[derive(Clone, Copy, Debug)]
pub(crate) enum Row {
    /// The way from one node to another along the chain is as long as the thread between them.
    Span { from: usize, to: usize },
    /// A coordinate of a node is held.
    Tie { node: usize, axis: usize, place: DVec3 },
    /// A coordinate of two nodes is the same.
    Link { nodes: [usize; 2], axis: usize, offset: f64 },
}

pub(crate) type Gradients = SmallVec<[(usize, DVec3); 8]>;

#[derive(Clone, Debug, Default)]
pub(crate) struct Work {
    pub(crate) nodes: Vec<Node>,
    pub(crate) rows: Vec<Row>,
    /// By node: rows and gradients.
    pub(crate) around: Vec<Gradients>,
    pub(crate) first: Vec<usize>,
    pub(crate) matrix: Skyline,
    pub(crate) right: Vec<f64>,
    pub(crate) multipliers: Vec<f64>,
    /// By row, of the side of its law that it is on.
    pub(crate) compliances: Vec<f64>,
    /// By row, of a span that is pulled.
    pub(crate) stiff: Vec<f64>,
    /// By row, the right-hand side before what the residuals add.
    pub(crate) errors: Vec<f64>,
    /// Of a span that is pushed.
    pub(crate) soft: f64,
}

impl Work {
    /// Nodes in order, predicted.
    pub(crate) fn gather(&mut self, chain: &Chain, law: &ThreadLaw, eyes: &[Eye], held: &[Held], dt: f64) {
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
    pub(crate) fn bend(&mut self, chain: &Chain, law: &ThreadLaw, dt: f64) {
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
                    let Who::Eye(e) = self.nodes[node].who else { continue };
                    if let EyeHold::Tissue { place, .. } = eyes[e].hold {
                        self.rows.extend((0..3).map(|axis| Row::Tie { node, axis, place }));
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
    pub(crate) fn project(&mut self, law: &ThreadLaw, eyes: &[Eye], dt: f64) {
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

    /// Whether the result can be taken.
    pub(crate) fn is_sound(&self, length_m: f64) -> bool {
        self.nodes.iter().all(|n| n.place.distance(n.predicted) <= length_m || n.mass.is_infinite() && n.place.is_finite())
    }

    /// Back to the chain and its eyes.
    pub(crate) fn scatter(&mut self, chain: &mut Chain, eyes: &mut [Eye], dt: f64) {
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
