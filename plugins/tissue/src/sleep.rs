//! A body that is still and that nothing touches is not stepped.

use crate::hold::Hold;
use bevy_math::Vec3;
use keyhole_whiteboard::{Contact, TissueState};

/// Root mean square of the speed below which a body is still, in edges of the cube of its volume a second. What it would still creep is about as many
/// edges: 0.02 % of the sag of the beam of [`crate::beam`].
const SLOW: f64 = 1e-4;

/// The same for what rounding does, in units of the last place of a coordinate a tick.
const ROUNDING: f64 = 4.0;

/// How long a body has to be still, s.
const LONG_S: f32 = 0.5;

/// Whether a body sleeps, and what has to stay as it is for that.
#[derive(Clone, Debug, Default)]
pub struct Sleep {
    still_s: f32,
    asleep: bool,
    positions: Vec<Vec3>,
    holds: Vec<Hold>,
    gravity: Vec3,
    bounds: Option<(Vec3, Vec3)>,
    /// What it touches: as the first tick of its sleep listed it.
    contacts: Option<Vec<Contact>>,
}

impl Sleep {
    /// Whether the body sleeps and nothing has changed since it fell asleep.
    #[must_use]
    pub fn holds_on(&self, state: &TissueState, holds: &[Hold], gravity: Vec3) -> bool {
        self.asleep
            && self.gravity == gravity
            && self.holds == holds
            && self.positions == state.positions
            && state.velocities.iter().all(|v| *v == Vec3::ZERO)
    }

    /// Wakes the body.
    pub fn wake(&mut self) {
        (self.still_s, self.asleep) = (0.0, false);
    }

    /// The corners of the box around the body, m, while it sleeps.
    #[must_use]
    pub fn bounds(&self) -> Option<(Vec3, Vec3)> {
        if self.asleep { self.bounds } else { None }
    }

    /// Whether it touches what it touched when it fell asleep, and nothing that moves: where it fell asleep with the last tick that is what it touches now.
    pub(crate) fn touches_alike(&mut self, contacts: &[Contact]) -> bool {
        if contacts.iter().any(|c| c.velocity_m_s != Vec3::ZERO) {
            return false;
        }
        let alike = |a: &Contact, b: &Contact| Contact { force_n: Vec3::ZERO, ..a.clone() } == Contact { force_n: Vec3::ZERO, ..b.clone() };
        let known = self.contacts.get_or_insert_with(|| contacts.to_vec());
        known.len() == contacts.len() && known.iter().zip(contacts).all(|(a, b)| alike(a, b))
    }

    /// Looks at a body after a tick of `dt` s: its kinetic energy (J), mass (kg) and size (m), and whether something that moves pushes it. Whether it has been
    /// still for long.
    pub(crate) fn counts_as_still(
        &mut self,
        state: &TissueState,
        holds: &[Hold],
        pushed: bool,
        dt: f32,
        kinetic: f64,
        mass: f64,
        size: f64,
    ) -> bool {
        let moves = pushed || holds.iter().any(|h| h.from != h.to);
        let furthest = state.positions.iter().fold(Vec3::ZERO, |most, x| most.max(x.abs())).max_element();
        let slow = SLOW * size + ROUNDING * f64::from(f32::EPSILON * furthest / dt);
        // A comparison that a speed which is no number fails.
        let still = !moves && 2.0 * kinetic <= mass * slow * slow;
        if !still {
            self.wake();
            return false;
        }
        self.still_s += dt;
        self.still_s >= LONG_S
    }

    /// Lets a body fall asleep: its velocities become zero.
    pub(crate) fn begin(&mut self, state: &mut TissueState, holds: &[Hold], gravity: Vec3) {
        state.velocities.fill(Vec3::ZERO);
        self.asleep = true;
        self.contacts = None;
        self.gravity = gravity;
        self.holds.clear();
        self.holds.extend_from_slice(holds);
        self.positions.clone_from(&state.positions);
        let corners = |(low, high): (Vec3, Vec3), x: &Vec3| (low.min(*x), high.max(*x));
        self.bounds = state.positions.first().map(|x| state.positions.iter().fold((*x, *x), corners));
    }
}
