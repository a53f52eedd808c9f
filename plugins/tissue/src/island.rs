//! Bodies that touch each other, stepped as one system; and a body on its own.
//!
//! A force between two bodies is one unknown, so it cannot be found from one side: what is solved one after the other takes the other's old place for its
//! new one, passes momentum on a tick late and shakes stacks. So bodies that list contacts with each other are an island: one system with the rows and the
//! preconditioner of each and the contacts between ([`crate::newton`]). They fall asleep together, when all have been still, for one that
//! still moves changes the contacts of those beside it.

use crate::body::Body;
use crate::hold::Hold;
use crate::implicit;
use crate::membrane::Membrane;
use crate::rescue;
use crate::settings::TissueSettings;
use crate::tumble::{self, Fall};
use crate::untangle;
use bevy_ecs::prelude::Entity;
use bevy_math::Vec3;
use keyhole_whiteboard::{Contact, Obstacle, TissueState};

/// One of the bodies of an island, with what a tick needs to know of it.
#[derive(Debug)]
pub struct Member<'a> {
    /// The organ, as contacts name it.
    pub organ: Entity,
    /// Its body.
    pub body: &'a mut Body,
    /// Its capsule.
    pub membrane: Option<&'a Membrane>,
    /// Its state.
    pub state: &'a mut TissueState,
    /// What holds it.
    pub holds: &'a [Hold],
    /// What it touches. Contacts with organs that are not members are taken as obstacles that go the way they say.
    pub contacts: &'a mut [Contact],
    /// Its contacts one side of which is a crumb: those the crumb alone answers.
    pub light: &'a mut [Contact],
    /// Whether all of it is a crumb. Then it is the only member.
    pub crumb: bool,
}

/// Steps an island over one tick of `dt` s under gravity (m/s2) by [`crate::implicit`], unless all of it sleeps, and writes the forces at its contacts down.
pub fn step(members: &mut [Member<'_>], gravity: Vec3, dt: f32, settings: &TissueSettings) {
    let fall = Fall { gravity, dt, drag_1_s: settings.drag_1_s };
    if let [Member { body, state, holds, light, crumb: true, .. }] = members {
        let nodes = body.nodes();
        tumble::step(body, &nodes, state, holds, light, fall);
        return;
    }
    if members.iter_mut().all(|m| m.body.rests(m.state, m.holds, m.contacts, gravity)) {
        members.iter_mut().for_each(|m| m.body.repeat_forces(m.contacts));
        return;
    }
    // What sleeps beside what does not is solved with it.
    members.iter_mut().filter(|m| m.body.sleep.bounds().is_some()).for_each(|m| m.body.wake());
    let mut count = members.len();
    let mut untangled = false;
    while count > 0 && !implicit::step(&mut members[..count], gravity, dt, settings, untangled) {
        // What is tangled comes out of it where it is, once, or by itself; then it is an obstacle to the others in this tick.
        let mut at = 0;
        let again = std::mem::replace(&mut untangled, true);
        while at < count {
            let Member { body, state, holds, .. } = &mut members[at];
            if !again {
                untangle::step(body, state, holds);
                body.implicit.forget_past();
            }
            if implicit::is_lost(body, state) {
                rescued(&mut members[at], fall);
                count -= 1;
                members.swap(at, count);
            } else {
                at += 1;
            }
        }
    }
    for Member { body, state, holds, light, .. } in members.iter_mut() {
        for nodes in body.implicit.newton.crumbs.all() {
            tumble::step(body, nodes, state, holds, light, fall);
        }
    }
    if !settings.sleep {
        return;
    }
    let mut all = true;
    for at in 0..members.len() {
        let pushed = members[at].contacts.iter().any(|c| c.velocity_m_s != Vec3::ZERO && !is_member(members, &c.against));
        let Member { body, state, holds, .. } = &mut members[at];
        let mass = body.masses.iter().map(|m| f64::from(*m)).sum();
        let (kinetic, size) = (body.kinetic_energy(state), body.size(mass));
        all &= body.sleep.counts_as_still(state, holds, pushed, dt, kinetic, mass, size);
    }
    if all {
        for m in members {
            m.body.sleep.begin(m.state, m.holds, gravity);
        }
    }
}

/// A tick of what is tangled: what is fixed goes to its rest shape by [`crate::rescue`], anything else as a rigid body that knows what it touches.
fn rescued(member: &mut Member<'_>, fall: Fall) {
    let Member { body, state, holds, contacts, .. } = member;
    if holds.iter().any(|hold| hold.fixes().is_some()) {
        rescue::step(body, state, holds, fall.gravity, fall.dt, fall.drag_1_s);
    } else {
        let nodes = body.nodes();
        tumble::step(body, &nodes, state, holds, contacts, fall);
    }
    body.implicit.begin_anew();
}

fn is_member(members: &[Member<'_>], against: &Obstacle) -> bool {
    match against {
        Obstacle::Own(_) => true,
        Obstacle::Organ { organ, .. } => members.iter().any(|m| m.organ == *organ),
        Obstacle::Anatomy(_) | Obstacle::Instrument(_) => false,
    }
}
