//! Instruments stop at what is as hard as they are, while the hand goes on.
//!
//! The hand's place and the instrument's are two: the instrument, the hand's proxy (C. B. Zilles, J. K. Salisbury, "A constraint-based god-object
//! method for haptic display", 1995), is where the hand would have it but for what collision found it against, and what pulls the hand back is a
//! spring between the two (J. E. Colgate, M. C. Stanley, J. M. Brown, "Issues in the haptic display of tool use", 1995: virtual coupling).
//!
//! Each contact says of one point of the instrument how far it may still go. In the four degrees of freedom of a trocar that is half a space, and the
//! proxy is the nearest place to the hand's in all of them, found by projecting on one after the other with corrections (C. Hildreth, "A quadratic
//! programming procedure", 1957). Near is measured where the tool works: an angle by the way of the tip.

use crate::kinematics::{PortFrame, TrocarState};
use bevy_ecs::prelude::*;
use bevy_math::Vec3;
use keyhole_whiteboard::{Obstacle, ToolTouch};

/// Rounds of projection. Contacts of a part are few, and most rounds change nothing.
const ROUNDS: usize = 32;

/// Lever of the roll in the measure of nearness, shafts' radii: jaws rather turn a little than make way.
const ROLL_LEVER: f32 = 2.0;

/// How instruments give way. Written by the app.
#[derive(Resource, Clone, Copy, Debug, PartialEq)]
pub struct ProxySettings {
    /// Stiffness of the spring between hand and instrument, N/m. Default 500: half of the least that a common device of this kind displays
    /// (3D Systems Touch, data sheet: 1.26, 2.31 and 1.02 N/mm along its axes), so that no device has to be switched back.
    pub stiffness_n_m: f32,
    /// Largest force of that spring, N. Default 3.3: the peak of the same device.
    pub force_max_n: f32,
    /// Speed with which an instrument that comes free goes to where the hand is, m/s, on top of what the hand moves. Default 0.25: surgeons' tips go at
    /// 0.1 to 0.3 m/s, and 10 cm take less than half a second.
    pub catch_up_m_s: f32,
    /// Largest speed of the tip, m/s, and of no point of the shaft in the body is it larger: a hand that goes faster is followed. Default 1, more than three
    /// times what surgeons' tips go at. A mouse that is flicked or a script that jumps would otherwise swing the shaft through the body in a tick and throw
    /// what it meets.
    pub fastest_m_s: f32,
}

impl Default for ProxySettings {
    fn default() -> Self {
        Self { stiffness_n_m: 500.0, force_max_n: 3.3, catch_up_m_s: 0.25, fastest_m_s: 1.0 }
    }
}

/// Where an instrument is while something holds it off the hand. Written by instruments.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct Proxy {
    /// The hand's place one tick ago, and the instrument's; nothing before the first tick.
    last: Option<(TrocarState, TrocarState)>,
    /// Whether something has held the instrument since it was last where the hand is.
    was_held: bool,
}

/// A place in the four degrees of freedom, in metres at the tip: yaw, pitch, insertion, roll.
type Place = [f32; 4];

/// A half of the space of places: those `x` with `row . x >= least`.
#[derive(Clone, Copy, Debug)]
struct Half {
    row: Place,
    least: f32,
}

fn dot(a: &Place, b: &Place) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn length(a: &Place) -> f32 {
    dot(a, a).sqrt()
}

impl Proxy {
    /// Where the hand was, and where the instrument was.
    #[must_use]
    pub fn last(&self) -> Option<(TrocarState, TrocarState)> {
        self.last
    }

    /// Where the instrument is now that the hand is at `hand`: `near` is what it was against after the last tick, `reach_m` how far ahead of the frame's
    /// origin it works. Without contacts, with no way to catch up and with a hand that is not too fast, it is exactly where the hand is.
    pub fn follow(
        &mut self,
        port: &PortFrame,
        hand: TrocarState,
        near: &[ToolTouch],
        reach_m: f32,
        radius_m: f32,
        settings: &ProxySettings,
        dt_s: f32,
    ) -> TrocarState {
        let Some((hand_before, before)) = self.last else {
            self.last = Some((hand, hand));
            return hand;
        };
        // Metres at the tip per unit of each degree of freedom.
        let lever = (before.insertion_m + reach_m).max(radius_m);
        let scale = [lever, lever, 1.0, ROLL_LEVER * radius_m];
        let offset = |state: &TrocarState| -> Place {
            let by = [
                state.yaw_rad - before.yaw_rad,
                state.pitch_rad - before.pitch_rad,
                state.insertion_m - before.insertion_m,
                state.roll_rad - before.roll_rad,
            ];
            std::array::from_fn(|k| by[k] * scale[k])
        };
        let wanted = offset(&hand);
        let halves: Vec<Half> = near.iter().filter_map(|touch| half(port, &before, touch, &scale)).collect();
        let mut goal = nearest(wanted, &halves);
        let held = goal != wanted;
        // As far as the hand went, and a little more: an instrument that comes free does not jump to where the hand has gone meanwhile.
        let (was, hand_way) = (offset(&hand_before), offset(&hand));
        let moved: Place = std::array::from_fn(|k| hand_way[k] - was[k]);
        let fastest = settings.fastest_m_s * dt_s;
        self.was_held |= held;
        let limit = if self.was_held { fastest.min(length(&moved) + settings.catch_up_m_s * dt_s) } else { fastest };
        let way = length(&goal);
        let limited = way > limit;
        if limited {
            goal = goal.map(|g| g * limit / way);
        }
        let state = if held || limited {
            let at: Place = std::array::from_fn(|k| goal[k] / scale[k]);
            TrocarState {
                yaw_rad: before.yaw_rad + at[0],
                pitch_rad: before.pitch_rad + at[1],
                insertion_m: before.insertion_m + at[2],
                roll_rad: before.roll_rad + at[3],
                ..hand
            }
        } else {
            hand
        };
        self.was_held &= state != hand;
        self.last = Some((hand, state));
        state
    }

    /// What the spring between hand and instrument does to the instrument, seen from the hand: force (N) and where it acts (m). Nothing while the two
    /// are at one place.
    #[must_use]
    pub fn coupling(&self, port: &PortFrame, reach_m: f32, settings: &ProxySettings) -> Option<(Vec3, Vec3)> {
        let (hand, proxy) = self.last.filter(|(hand, proxy)| hand != proxy)?;
        let tip = |state: &TrocarState| port.pose(state) * Vec3::new(0.0, 0.0, -reach_m);
        let at = tip(&proxy);
        Some(((settings.stiffness_n_m * (at - tip(&hand))).clamp_length_max(settings.force_max_n), at))
    }
}

/// What a contact leaves of the places, seen from `before`. `None` of a contact that no degree of freedom changes.
fn half(port: &PortFrame, before: &TrocarState, touch: &ToolTouch, scale: &Place) -> Option<Half> {
    let pose = port.pose(before);
    let local = pose.inverse() * touch.point;
    // Differences over 2 mm at 10 cm: the curvature of the way changes them by less than one part in 50 000, and so does rounding in f32. With a fifth of that, rounding
    // alone made the tip of a hand that leans 3 cm into a wall tremble by 2 micrometres.
    let step = 1e-2 * scale[0];
    let moved = |k: usize, by: f32| {
        let mut state = *before;
        let freedom = [&mut state.yaw_rad, &mut state.pitch_rad, &mut state.insertion_m, &mut state.roll_rad];
        if let Some(freedom) = freedom.into_iter().nth(k) {
            *freedom += by / scale[k];
        }
        port.pose(&state) * local
    };
    let row: Place = std::array::from_fn(|k| (moved(k, step) - moved(k, -step)).dot(touch.normal) / (2.0 * step));
    // Of two instruments each gives half.
    let share = if matches!(touch.against, Obstacle::Instrument(_)) { 0.5 } else { 1.0 };
    (dot(&row, &row) > 1e-6).then_some(Half { row, least: share * touch.depth_m })
}

/// The nearest place to `wanted` in all of the halves: as near as [`ROUNDS`] rounds come.
fn nearest(wanted: Place, halves: &[Half]) -> Place {
    let mut place = wanted;
    let mut pushes = vec![0.0_f32; halves.len()];
    for _ in 0..ROUNDS {
        let mut changed = false;
        for (half, push) in halves.iter().zip(&mut pushes) {
            let missing = (half.least - dot(&half.row, &place)) / dot(&half.row, &half.row);
            let by = missing.max(-*push);
            if by != 0.0 {
                *push += by;
                place = std::array::from_fn(|k| place[k] + by * half.row[k]);
                changed = true;
            }
        }
        if !changed {
            break;
        }
    }
    place
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;
    use bevy_ecs::world::World;
    use keyhole_whiteboard::Port;
    use proptest::prelude::*;

    const DT: f32 = 1.0 / 60.0;
    const RADIUS: f32 = 0.0025;
    const REACH: f32 = 0.016;

    fn port() -> PortFrame {
        PortFrame::of(&Port { position: Vec3::new(0.1, 0.15, 0.05), inward: Vec3::new(-0.5, -0.8, -0.3).normalize() })
    }

    fn tip(state: &TrocarState) -> Vec3 {
        port().pose(state) * Vec3::new(0.0, 0.0, -REACH)
    }

    /// The tip against a wall through `on`, as collision sees it.
    fn wall(state: &TrocarState, on: Vec3, normal: Vec3) -> ToolTouch {
        let wall = World::new().spawn_empty().id();
        ToolTouch { point: tip(state), normal, depth_m: (on - tip(state)).dot(normal), against: Obstacle::Anatomy(wall) }
    }

    fn follow(proxy: &mut Proxy, hand: TrocarState, near: &[ToolTouch]) -> TrocarState {
        proxy.follow(&port(), hand, near, REACH, RADIUS, &ProxySettings::default(), DT)
    }

    fn start() -> TrocarState {
        TrocarState { yaw_rad: 0.1, pitch_rad: -0.2, insertion_m: 0.12, roll_rad: 0.3, ..Default::default() }
    }

    #[test]
    fn an_instrument_that_nothing_holds_is_where_the_hand_is() {
        let mut proxy = Proxy::default();
        for i in 0..60 {
            let jerk = 0.3 * (i as f32 * 0.25).sin();
            let hand = TrocarState { yaw_rad: jerk, insertion_m: 0.12 + 0.1 * jerk, pedal: i % 7 == 0, ..start() };
            let far = wall(&hand, tip(&hand) - Vec3::Y * 0.3, Vec3::Y);
            assert_eq!(follow(&mut proxy, hand, if i % 2 == 0 { &[] } else { std::slice::from_ref(&far) }), hand);
            assert_eq!(proxy.coupling(&port(), REACH, &ProxySettings::default()), None);
        }
    }

    /// A hand that goes to the other side of the body in a tick, and stays.
    #[test]
    fn an_instrument_follows_a_hand_no_faster_than_it_may() {
        let settings = ProxySettings::default();
        let mut proxy = Proxy::default();
        let mut state = follow(&mut proxy, start(), &[]);
        let hand = TrocarState { yaw_rad: -0.9, insertion_m: 0.2, grip: 1.0, ..start() };
        let (mut ticks, mut at) = (0, tip(&state));
        while state != hand {
            state = follow(&mut proxy, hand, &[]);
            let step = tip(&state).distance(at);
            assert!(step <= 1.05 * settings.fastest_m_s * DT, "{step} m in a tick");
            assert_eq!(state.grip, hand.grip, "fingers are not held up by the shaft");
            (ticks, at) = (ticks + 1, tip(&state));
        }
        // Nor does it dawdle: nothing has held it.
        let way = tip(&start()).distance(tip(&hand));
        assert!(ticks as f32 * DT <= 1.3 * way / settings.fastest_m_s, "{ticks} ticks for {way} m");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// A hand that goes 3 cm into a wall, whatever its slope: the tip stays before it, nearest to the hand, at rest while the hand is; the spring pulls
        /// out of the wall. When the hand comes back, or the wall goes, the tip follows without a jump and ends where the hand is.
        #[test]
        fn a_wall_stops_the_tip_and_lets_it_go(slope in prop::array::uniform3(-1f32..1.0), into in prop::array::uniform3(-1f32..1.0), vanishes in any::<bool>()) {
            let settings = ProxySettings::default();
            let along = port().shaft(start().yaw_rad, start().pitch_rad);
            let normal = (Vec3::from_array(slope) * 0.6 - along).normalize();
            let on = tip(&start()) - 0.002 * normal;
            let way = (Vec3::from_array(into) * 0.5 - normal).normalize();
            let deep = port().reach(tip(&start()) + 0.03 * way, REACH, &start()).unwrap();
            let lerp = |t: f32| TrocarState {
                yaw_rad: start().yaw_rad + t * (deep.yaw_rad - start().yaw_rad),
                pitch_rad: start().pitch_rad + t * (deep.pitch_rad - start().pitch_rad),
                insertion_m: start().insertion_m + t * (deep.insertion_m - start().insertion_m),
                ..start()
            };
            let mut proxy = Proxy::default();
            let mut state = follow(&mut proxy, start(), &[]);
            let mut last = tip(&state);
            for i in 0..180 {
                let hand = lerp((i as f32 / 40.0).min(1.0));
                let near = [wall(&state, on, normal)];
                state = follow(&mut proxy, hand, &near);
                let depth = (on - tip(&state)).dot(normal);
                prop_assert!(depth < 2e-4, "{depth} m in the wall at {i}");
                if i > 150 {
                    // Two hundredths of a millimetre in half a second would be seen by nobody; rounding alone is left.
                    prop_assert!(tip(&state).distance(last) < 2e-6, "{} m at rest", tip(&state).distance(last));
                    prop_assert!(depth.abs() < 1e-4);
                }
                last = tip(&state);
            }
            let (force, at) = proxy.coupling(&port(), REACH, &settings).unwrap();
            prop_assert!(at == tip(&state) && force.dot(normal) > 0.9 * force.length().min(settings.force_max_n) * normal.dot(-way).min(0.5));
            prop_assert!(force.length() <= 1.0001 * settings.force_max_n);
            for i in 0..120 {
                let back = |i: usize| if vanishes { 1.0 } else { 1.0 - (i as f32 / 40.0).min(1.0) };
                let near = [wall(&state, on, normal)];
                state = follow(&mut proxy, lerp(back(i)), if vanishes { &[] } else { &near });
                let hand_way = tip(&lerp(back(i))).distance(tip(&lerp(back(i.max(1) - 1)))) + 0.03 * back(i) * 0.05;
                let step = tip(&state).distance(last);
                prop_assert!(step <= 1.2 * hand_way + 1.1 * settings.catch_up_m_s * DT, "{step} m in a tick at {i}");
                last = tip(&state);
            }
            prop_assert_eq!(state, lerp(if vanishes { 1.0 } else { 0.0 }), "the instrument is in the hand again");
        }
    }

    /// A wall beside the shaft, half way in: the tip swings no further, but slides in and out along it.
    #[test]
    fn a_wall_beside_the_shaft_leaves_the_insertion_free() {
        let mut proxy = Proxy::default();
        let mut state = follow(&mut proxy, start(), &[]);
        let side = port().pose(&start()).rotation * Vec3::X;
        let on = port().pose(&start()) * Vec3::new(0.0, 0.0, 0.05) - 0.004 * side;
        for i in 0..100 {
            let t = i as f32 / 100.0;
            // The hand swings through the wall and pushes in meanwhile.
            let swung = TrocarState { yaw_rad: start().yaw_rad - 0.3 * t, insertion_m: 0.12 + 0.02 * t, ..start() };
            let swung = if tip(&swung).dot(side) < tip(&start()).dot(side) {
                swung
            } else {
                TrocarState { yaw_rad: start().yaw_rad + 0.3 * t, ..swung }
            };
            let pose = port().pose(&state);
            let point = pose * Vec3::new(0.0, 0.0, (pose.inverse() * on).z);
            let touch = ToolTouch { point, normal: side, depth_m: (on - point).dot(side), ..wall(&state, on, side) };
            state = follow(&mut proxy, swung, &[touch]);
            assert!((on - port().pose(&state) * Vec3::new(0.0, 0.0, (port().pose(&state).inverse() * on).z)).dot(side) < 2e-4);
        }
        // Nearest to the hand, which is 4 cm behind the wall, is a little further out: the shaft leans at the wall.
        assert!(state.insertion_m > 0.134, "{}", state.insertion_m);
    }
}
