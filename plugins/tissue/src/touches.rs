//! The contacts of bodies that are solved together: from the whiteboard's lists to forces in the solver, and back.
//!
//! A contact of tissue with tissue moves both sides: it is one force on the points of both, in one system, so that what one loses of momentum the
//! other gets. The two list it each; it is taken from the first of them.
//!
//! In the system a contact is a block that joins all its nodes. The preconditioner knows it by `delassus.rs`.

use crate::body::Body;
use crate::delassus::Delassus;
use crate::gradients::{Equation, Solved, Stop, size_by, solve};
use crate::island::Member;
use crate::membrane::Membrane;
use crate::newton::{Newton, Part};
use crate::touch::{Arm, Touch};
use bevy_ecs::prelude::Entity;
use bevy_math::{DMat3, DVec3, Mat3A, Vec3, Vec3A};
use keyhole_whiteboard::{Contact, Obstacle, TissuePoint};

/// Share of the fall of the energy along a solution that it may rise with at its end.
const BEYOND: f64 = 0.25;

/// Share of all friction that its caps may be off by.
const RECAP: f32 = 0.02;

/// Most steps, and halvings of each, towards a balance.
const BALANCING: u32 = 8;

/// Halvings of a line that is looked along.
const BISECTIONS: u32 = 12;

/// By what a contact is known again in the next tick: the nodes of its point, and what it is with.
type Key = ([u32; 4], Option<Entity>);

/// What force had come to at the contacts of a body, by their keys, N.
#[derive(Clone, Debug, Default)]
pub(crate) struct Grips(Vec<(Key, Vec3)>);

impl Grips {
    /// The force at the first contact with this key.
    pub(crate) fn of(&self, contact: &Contact) -> Option<Vec3> {
        let key = key(contact);
        let at = self.0.partition_point(|(k, _)| *k < key);
        self.0.get(at).filter(|(k, _)| *k == key).map(|(_, force)| *force)
    }

    /// Makes them ready to be looked for.
    fn sort(&mut self) {
        self.0.sort_unstable_by_key(|(key, _)| *key);
    }
}

fn key(contact: &Contact) -> Key {
    let mut nodes = [u32::MAX; 4];
    for (to, (node, _)) in nodes.iter_mut().zip(&contact.point) {
        *to = node.0;
    }
    (nodes, contact.against.entity())
}

/// Where a contact is listed: which body, and which of its contacts.
type Place = (u32, u32);

/// The contacts of some bodies in a tick.
#[derive(Clone, Debug, Default)]
pub(crate) struct Touches {
    list: Vec<Touch>,
    /// Where each is listed, and where again from the other side.
    places: Vec<(Place, Option<Place>)>,
    /// Their part of the preconditioner.
    held: Delassus,
    /// Forces and impulses to go back to.
    kept: Vec<(Vec3A, f32, Vec3A)>,
}

impl Touches {
    /// Whether there are none.
    pub(crate) fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// Whether some of them push.
    pub(crate) fn push(&self) -> bool {
        self.list.iter().any(|t| t.now.touches)
    }

    /// Whether some pushed at the end of the stage before.
    pub(crate) fn last(&self) -> bool {
        self.list.iter().any(|t| t.pushed > 0.0)
    }

    /// Whether some push that are with something else than these bodies.
    pub(crate) fn bear(&self) -> bool {
        self.list.iter().any(|t| t.now.touches && !t.joins())
    }

    /// Takes the contacts of some bodies over at the beginning of a tick.
    pub(crate) fn gather(&mut self, members: &[Member<'_>]) {
        self.list.clear();
        self.places.clear();
        for (m, member) in members.iter().enumerate() {
            // Both sides list their contacts in the same order.
            let mut next = 0;
            for (c, contact) in member.contacts.iter().enumerate() {
                let mut touch = Touch::default();
                let mut mirror = None;
                arms(&mut touch, m, &contact.point, 1.0);
                match &contact.against {
                    Obstacle::Own(point) => arms(&mut touch, m, point, -1.0),
                    Obstacle::Organ { organ, point } => match members.iter().position(|o| o.organ == *organ) {
                        Some(other) if other < m => continue,
                        Some(other) => {
                            arms(&mut touch, other, point, -1.0);
                            mirror = mirror_of(contact, member.organ, members[other].contacts, next).map(|at| (other as u32, at as u32));
                            next = mirror.map_or(next, |(_, at)| at as usize + 1);
                        }
                        None => {}
                    },
                    Obstacle::Anatomy(_) | Obstacle::Instrument(_) => {}
                }
                if self.add(touch, contact, members) {
                    self.places.push(((m as u32, c as u32), mirror));
                }
            }
        }
    }

    fn add(&mut self, mut touch: Touch, contact: &Contact, members: &[Member<'_>]) -> bool {
        let mass = |a: &Arm| members[a.part as usize].body.masses.get(a.node as usize).copied().unwrap_or(0.0);
        let sound = contact.depth_m.is_finite() && contact.normal.is_finite() && contact.velocity_m_s.is_finite();
        if touch.arms.is_empty() || !sound || touch.arms.iter().any(|a| mass(a) <= 0.0) {
            return false;
        }
        touch.normal = contact.normal.into();
        touch.friction = contact.friction.max(0.0);
        touch.gap = -contact.depth_m;
        if !touch.joins() {
            touch.velocity = contact.velocity_m_s.into();
        }
        touch.begun = place(&touch, |a| members[a.part as usize].state.positions[a.node as usize].into());
        let m = touch.arms[0].part as usize;
        let grip = members[m].body.implicit.grips.of(contact).unwrap_or(Vec3::ZERO);
        touch.grip = crate::touch::along(grip.into(), touch.normal);
        touch.pushed = touch.normal.dot(grip.into()).max(0.0);
        touch.mass = touch.arms.iter().map(|a| a.weight * a.weight / mass(a)).sum::<f32>().recip();
        // The softer of the two sides.
        let around = |side: f32| {
            let of =
                |a: &Arm| a.weight.abs() * stiffness(members[a.part as usize].body, members[a.part as usize].membrane, a.node as usize);
            touch.arms.iter().filter(|a| a.weight * side > 0.0).map(of).sum::<f32>()
        };
        let softer = if touch.joins() { around(1.0).min(around(-1.0)) } else { around(1.0) };
        touch.set_stiffness(softer);
        self.list.push(touch);
        true
    }

    /// Keeps what [`Touches::go_back`] goes back to.
    pub(crate) fn keep(&mut self) {
        self.kept.clear();
        self.kept.extend(self.list.iter().map(|t| (t.grip, t.pushed, t.impulse)));
    }

    /// Goes back to where it was kept.
    pub(crate) fn go_back(&mut self) {
        for (touch, kept) in self.list.iter_mut().zip(&self.kept) {
            (touch.grip, touch.pushed, touch.impulse) = *kept;
        }
    }

    /// Sets out on a stage of `length` s that begins with the positions `from`, `time_s` after the tick began; forces are taken `reach` s from there.
    pub(crate) fn begin<'a>(&mut self, from: impl Fn(usize) -> &'a [Vec3A], time_s: f32, length: f32, reach: f32) {
        for touch in &mut self.list {
            let base = place(touch, |a| from(a.part as usize)[a.node as usize]);
            touch.begin(base, time_s, length, reach);
        }
    }

    /// Looks where the bodies are now, for the first step of a stage; where nothing is in touch there, at what will be where inertia leads.
    pub(crate) fn look_ahead(&mut self, parts: &[Part<'_>]) {
        for ahead in [false, true] {
            for touch in &mut self.list {
                let at = |of: fn(&Newton) -> &[Vec3A]| place(touch, |a| of(parts[a.part as usize].newton)[a.node as usize]);
                let (now, target) = (at(|n| &n.x), at(if ahead { |n| &n.target } else { |n| &n.x }));
                touch.look_ahead(now, target);
            }
            if self.push() {
                return;
            }
        }
    }

    /// Looks where the bodies are now.
    pub(crate) fn look(&mut self, parts: &[Part<'_>]) {
        for touch in &mut self.list {
            let place = place(touch, |a| parts[a.part as usize].newton.x[a.node as usize]);
            touch.look(place);
        }
    }

    /// How much of the solution to go: where the bodies' own energy as a quadratic function, `gain` its fall along the solution, and the contacts' as it is are
    /// least together, unless all of the solution is about that.
    pub(crate) fn part_of(&mut self, parts: &[Part<'_>], gain: f64) -> f32 {
        let (mut before, mut slope) = (0.0, 0.0);
        for touch in &mut self.list {
            let at = |of: fn(&Newton) -> &[Vec3A]| place(touch, |a| of(parts[a.part as usize].newton)[a.node as usize]);
            let (here, change) = (at(|n| &n.x), at(|n| &n.gradients.solution));
            let (force, fall) = touch.set_line(here, change);
            before += force;
            slope += fall;
        }
        let rise = |part: f32| {
            let contacts: f64 = self.list.iter().map(|t| t.along_line(part)).sum();
            f64::from(part) * (gain - slope) - (gain - before) - contacts
        };
        if rise(1.0) <= BEYOND * gain {
            return 1.0;
        }
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..BISECTIONS {
            let middle = (low + high) / 2.0;
            if rise(middle) > 0.0 { high = middle } else { low = middle }
        }
        // Somewhere it has to go.
        high
    }

    /// Caps friction by the forces that there are now, if that makes a difference.
    pub(crate) fn recap(&mut self) -> bool {
        let rubs = |t: &&mut Touch| t.friction > 0.0;
        let (mut change, mut all) = (0.0, 0.0);
        for touch in self.list.iter_mut().filter(rubs) {
            let push = touch.now.push.max(0.0);
            change += touch.friction * (push - touch.pushed).abs();
            all += touch.friction * push;
        }
        if change <= RECAP * all {
            return false;
        }
        for touch in self.list.iter_mut().filter(rubs) {
            touch.pushed = touch.now.push.max(0.0);
        }
        true
    }

    /// Adds so many times the forces on the nodes that move freely to the residuals.
    pub(crate) fn add_forces(&self, parts: &mut [Part<'_>], times: f32) {
        for touch in self.list.iter().filter(|t| t.now.touches) {
            for a in &touch.arms {
                let newton = &mut *parts[a.part as usize].newton;
                if newton.free[a.node as usize] {
                    newton.gradients.residual[a.node as usize] += touch.now.force * (a.weight * times);
                }
            }
        }
    }

    /// Which contacts each node takes part in, by body and node, ascending.
    pub(crate) fn of_nodes(&self) -> Vec<((u32, u32), u32)> {
        let arms = self.list.iter().enumerate().flat_map(|(at, t)| t.arms.iter().map(move |a| ((a.part, a.node), at as u32)));
        let mut all: Vec<_> = arms.collect();
        all.sort_unstable();
        all.dedup();
        all
    }

    /// Force (N) of one of the contacts on a node of a body as it was last looked at, and a bound of how it falls with the place of the node (N/m).
    pub(crate) fn on_node(&self, contact: u32, (part, node): (u32, u32), parts: &[Part<'_>]) -> (Vec3A, Mat3A) {
        let touch = &self.list[contact as usize];
        let weight: f32 = touch.arms.iter().filter(|a| (a.part, a.node) == (part, node)).map(|a| a.weight).sum();
        let place = place(touch, |a| parts[a.part as usize].newton.x[a.node as usize]);
        (touch.now.force * weight, touch.most_against(place) * (weight * weight))
    }

    /// Looks at one of the contacts where the bodies are now; the nodes that take part in it.
    pub(crate) fn look_at(&mut self, contact: u32, parts: &[Part<'_>]) -> impl Iterator<Item = (u32, u32)> + '_ {
        let touch = &mut self.list[contact as usize];
        let place = place(touch, |a| parts[a.part as usize].newton.x[a.node as usize]);
        touch.look(place);
        touch.arms.iter().map(|a| (a.part, a.node))
    }

    /// Makes the preconditioner one that knows the contacts as they were last looked at.
    pub(crate) fn hold(&mut self, parts: &[Part<'_>]) {
        self.held.build(&self.list, parts);
    }

    /// Solves the system of the bodies and the contacts.
    pub(crate) fn solve(&mut self, equations: &mut [Equation<'_>], stop: Stop) -> Solved {
        let mut held = std::mem::take(&mut self.held);
        let solved = solve(equations, self, &mut held, stop);
        self.held = held;
        solved
    }

    /// The size of the residuals in the norm of the preconditioner that knows the contacts, J.
    pub(crate) fn size(&mut self, equations: &mut [Equation<'_>]) -> f64 {
        size_by(equations, &mut self.held)
    }

    /// Adds what the contacts have to the images of the directions; the product of that with the directions.
    pub(crate) fn multiply(&self, equations: &mut [Equation<'_>]) -> f64 {
        let mut product = 0.0;
        for touch in self.list.iter().filter(|t| t.now.touches) {
            let way = place(touch, |a| equations[a.part as usize].gradients.direction[a.node as usize]);
            let pull = touch.now.block * way;
            product += f64::from(pull.dot(way));
            for a in &touch.arms {
                let Equation { system, gradients, .. } = &mut equations[a.part as usize];
                let node = a.node as usize;
                if system.free[node] {
                    gradients.image[node] += pull * a.weight;
                }
            }
        }
        product
    }

    /// By how much the bodies have to move all together for forces and inertia to balance, m: `left` is what is not balanced (N), `inertia` what resists besides (N/m).
    pub(crate) fn balance(&self, parts: &[Part<'_>], left: DVec3, inertia: f64) -> Vec3A {
        let places = |t: &Touch| place(t, |a| parts[a.part as usize].newton.x[a.node as usize]);
        let sums = |shift: Vec3A| {
            let of = |(force, slope): (Vec3A, Mat3A), t: &Touch| {
                let (f, s) = t.shifted(places(t), shift);
                (force + f, slope + s)
            };
            self.list.iter().filter(|t| !t.joins()).fold((Vec3A::ZERO, Mat3A::ZERO), of)
        };
        let (first, mut slope) = sums(Vec3A::ZERO);
        let mut shift = Vec3A::ZERO;
        let mut rest = left;
        for _ in 0..BALANCING {
            let against = DMat3::from_diagonal(DVec3::splat(inertia)) + DMat3::from_cols_array(&slope.to_cols_array().map(f64::from));
            let step = (against.inverse() * rest).as_vec3a();
            let (mut part, mut found) = (1.0, false);
            for _ in 0..BALANCING {
                let (force, other) = sums(shift + step * part);
                let now = left + (force - first).as_dvec3() - (shift + step * part).as_dvec3() * inertia;
                if now.length_squared() < rest.length_squared() {
                    (shift, rest, slope, found) = (shift + step * part, now, other, true);
                    break;
                }
                part /= 2.0;
            }
            if !found {
                break;
            }
        }
        shift
    }

    /// What resists a motion of all bodies together, N/m.
    pub(crate) fn against(&self) -> Mat3A {
        self.list.iter().filter(|t| t.now.touches && !t.joins()).fold(Mat3A::ZERO, |sum, t| sum + t.now.block)
    }

    /// What the forces are the gradient of while friction is capped as it now is, J.
    pub(crate) fn energy(&self, parts: &[Part<'_>]) -> f64 {
        let of = |t: &Touch| t.energy(place(t, |a| parts[a.part as usize].newton.x[a.node as usize]));
        self.list.iter().map(of).sum()
    }

    /// Ends a stage: forces count for `length` s.
    pub(crate) fn finish(&mut self, length: f32) {
        self.list.iter_mut().for_each(|t| t.finish(length));
    }

    /// What obstacles and depth may give the bodies in a stage of `length` s, J.
    pub(crate) fn work(&self, length: f32) -> f64 {
        self.list.iter().map(|t| t.work(length)).sum()
    }

    /// Writes mean forces over the tick of `dt` s down, and keeps what friction came to for the next.
    pub(crate) fn write(&self, members: &mut [Member<'_>], dt: f32) {
        for member in &mut *members {
            member.body.implicit.grips.0.clear();
            member.contacts.iter_mut().for_each(|c| c.force_n = Vec3::ZERO);
        }
        for (touch, ((m, c), mirror)) in self.list.iter().zip(&self.places) {
            let force = Vec3::from(touch.impulse / dt);
            let member = &mut members[*m as usize];
            let contact = &mut member.contacts[*c as usize];
            contact.force_n = force;
            let last = Vec3::from(touch.now.force);
            member.body.implicit.grips.0.push((key(contact), last));
            if let Some((m, c)) = mirror {
                let member = &mut members[*m as usize];
                let contact = &mut member.contacts[*c as usize];
                contact.force_n = -force;
                member.body.implicit.grips.0.push((key(contact), -last));
            }
        }
        for member in members {
            member.body.implicit.grips.sort();
        }
    }
}

fn arms(touch: &mut Touch, part: usize, point: &TissuePoint, sign: f32) {
    let used = point.iter().filter(|(_, weight)| *weight != 0.0);
    touch.arms.extend(used.map(|(node, weight)| Arm { part: part as u32, node: node.0, weight: sign * weight }));
}

/// Where the other side lists a contact; it is looked for from `next` on.
fn mirror_of(contact: &Contact, organ: Entity, others: &[Contact], next: usize) -> Option<usize> {
    let Obstacle::Organ { point: there, .. } = &contact.against else { return None };
    let is = |c: &Contact| {
        c.point == *there && matches!(&c.against, Obstacle::Organ { organ: o, point } if *o == organ && *point == contact.point)
    };
    (next..others.len()).chain(0..next.min(others.len())).find(|at| is(&others[*at]))
}

/// About what a node resists with, N/m.
fn stiffness(body: &Body, membrane: Option<&Membrane>, node: usize) -> f32 {
    body.implicit.newton.rows.stiffness(node) + membrane.map_or(0.0, |m| m.stiffness(node))
}

/// The sum of weight times a vector of the nodes.
fn place(touch: &Touch, of: impl Fn(&Arm) -> Vec3A) -> Vec3A {
    touch.arms.iter().map(|a| of(a) * a.weight).sum()
}
