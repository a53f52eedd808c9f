//! Contacts for the models that move nodes one constraint after the other: a point that is inside an obstacle at the end of a substep is moved out along
//! the normal, what it slid meanwhile is taken back as far as Coulomb's bound goes, and the force is what that takes of momentum.
//!
//! Organs are stepped one after the other there, so each takes half of the depth to another organ. A point that begins deep comes out by a part of the way in each substep.

use crate::body::Body;
use bevy_math::Vec3;
use keyhole_whiteboard::{Contact, Obstacle, TissuePoint};
use smallvec::SmallVec;

/// How slowly a point that is inside comes out, s: see [`crate::island`], where it is the same.
const SLOW_S: f32 = 0.03;

/// A contact during a tick.
#[derive(Clone, Debug)]
struct Press {
    /// Which of the contacts.
    at: usize,
    /// Nodes and weights: negative where an organ touches itself.
    arms: SmallVec<[(usize, f32); 8]>,
    normal: Vec3,
    velocity: Vec3,
    friction: f32,
    /// The gap when the tick began and when the substep did, m.
    begun: f32,
    gap: f32,
    /// Where the point was then, m.
    from: Vec3,
    before: Vec3,
    /// Sum of force times time, N s.
    impulse: Vec3,
}

/// The contacts of an organ during a tick.
#[derive(Clone, Debug, Default)]
pub(crate) struct Presses(Vec<Press>);

impl Presses {
    /// Those that name tissue that is there. `position` gives positions as they are at the beginning of the tick.
    pub(crate) fn new(body: &Body, contacts: &[Contact], position: impl Fn(usize) -> Vec3) -> Self {
        let press = |(at, c): (usize, &Contact)| {
            let mut arms = SmallVec::new();
            let mut add = |point: &TissuePoint, sign: f32| arms.extend(point.iter().map(|(n, w)| (n.index(), sign * w)));
            add(&c.point, 1.0);
            let share = match &c.against {
                Obstacle::Own(point) => {
                    add(point, -1.0);
                    1.0
                }
                Obstacle::Organ { .. } => 0.5,
                Obstacle::Anatomy(_) | Obstacle::Instrument(_) => 1.0,
            };
            let there = arms.iter().all(|(n, _): &(usize, f32)| body.masses().get(*n).is_some_and(|m| *m > 0.0));
            let sound = c.depth_m.is_finite() && c.normal.is_finite() && c.velocity_m_s.is_finite();
            let from = if there { sum(&arms, &position) } else { Vec3::ZERO };
            let velocity = if matches!(c.against, Obstacle::Own(_)) { Vec3::ZERO } else { c.velocity_m_s * share };
            let gap = -c.depth_m * share;
            let press = Press {
                at,
                arms,
                normal: c.normal,
                velocity,
                friction: c.friction.max(0.0),
                begun: gap,
                gap,
                from,
                before: from,
                impulse: Vec3::ZERO,
            };
            (there && sound && !press.arms.is_empty()).then_some(press)
        };
        Self(contacts.iter().enumerate().filter_map(press).collect())
    }

    /// Whether there are none.
    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Ends a substep of `h` s, `time_s` after the tick began: `position` gives positions and inverse masses (1/kg), `shift` moves a node.
    pub(crate) fn push_out(&mut self, h: f32, time_s: f32, position: impl Fn(usize) -> (Vec3, f32), mut shift: impl FnMut(usize, Vec3)) {
        for press in &mut self.0 {
            let Press { arms, normal: n, velocity, .. } = &*press;
            let w: f32 = arms.iter().map(|(node, weight)| position(*node).1 * weight * weight).sum();
            let at = sum(arms, |node| position(node).0);
            let gap = press.begun + (at - press.from - *velocity * time_s).dot(*n);
            let level = press.gap.min(0.0) * (SLOW_S / (SLOW_S + h));
            let out = (level - gap).max(0.0);
            let mut moved = *n * out;
            if out > 0.0 && w > 0.0 {
                let slid = at - press.before - *velocity * h;
                let slid = slid - *n * slid.dot(*n);
                let (far, most) = (slid.length(), press.friction * out);
                moved -= if far > most { slid * (most / far) } else { slid };
                for (node, weight) in arms {
                    shift(*node, moved * (position(*node).1 * weight / w));
                }
                press.impulse += moved / (w * h);
            }
            press.before = sum(&press.arms, |node| position(node).0);
            press.gap = press.begun + (press.before - press.from - press.velocity * time_s).dot(press.normal);
        }
    }

    /// Writes the mean forces over the tick of `dt` s down.
    pub(crate) fn write(&self, contacts: &mut [Contact], dt: f32) {
        contacts.iter_mut().for_each(|c| c.force_n = Vec3::ZERO);
        for press in &self.0 {
            contacts[press.at].force_n = press.impulse / dt;
        }
    }
}

fn sum(arms: &[(usize, f32)], position: impl Fn(usize) -> Vec3) -> Vec3 {
    arms.iter().map(|(node, weight)| position(*node) * *weight).sum()
}
