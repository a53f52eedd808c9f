//! What a body touches that has not moved: what it touched in the last tick, as far as nothing else has moved either.
//!
//! A body that sleeps is looked at once. From then on its contacts with anatomy and with itself are those of the tick before, its box says whether a tool may
//! come near, and only what comes into its box is looked for in it. The contacts are the same to the bit, and in the same order, as if all were looked at anew.

use crate::contacts::Party;
use crate::detect::Hit;
use crate::shape::Role;
use bevy_math::Vec3;
use keyhole_whiteboard::Contact;

/// What is known of a body that has not moved.
#[derive(Clone, Debug, Default)]
pub struct Rest {
    /// Corners of a box that its nodes are in until the end of the tick, and every face with room for its fastest corner, m.
    low: Vec3,
    high: Vec3,
    friction: f32,
    /// Its nodes in its own tetrahedra.
    own: Vec<Hit>,
    /// Its contacts with anatomy; none before they have been looked for.
    pub anatomy: Option<Vec<Contact>>,
}

impl Rest {
    /// Begins with a body, its nodes in its own tetrahedra, and the length of a tick, s.
    #[must_use]
    pub fn of(body: &Party, own: &[Hit], dt_s: f32) -> Self {
        let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        let used = body.shape.roles().iter().zip(body.positions).zip(body.velocities).filter(|((role, _), _)| **role != Role::Unused);
        let (mut behind, mut ahead) = (Vec3::ZERO, Vec3::ZERO);
        for ((_, x), v) in used {
            (low, high) = (low.min(*x), high.max(*x));
            (behind, ahead) = (behind.min(*v * dt_s), ahead.max(*v * dt_s));
        }
        Self { low: low + behind, high: high + ahead, friction: body.friction, own: own.to_vec(), anatomy: None }
    }

    /// Whether it still holds of a body that has not moved: its friction is as it was.
    #[must_use]
    pub fn holds(&self, friction: f32) -> bool {
        self.friction == friction
    }

    /// Its nodes in its own tetrahedra, as those of the body with the place `body`.
    pub fn own(&self, body: u16) -> impl Iterator<Item = Hit> + '_ {
        self.own.iter().map(move |hit| Hit { node_body: body, tet_body: body, ..*hit })
    }

    /// Whether a box may have something of the body in it; m.
    #[must_use]
    pub fn meets(&self, (low, high): (Vec3, Vec3)) -> bool {
        self.low.cmple(high).all() && self.high.cmpge(low).all()
    }
}
