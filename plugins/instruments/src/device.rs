//! Hands in a device: an instrument follows its handle, stays where it is while the device has a fault, and goes on from there.
//!
//! When a device takes over, the handle is hardly ever where the instrument is. The difference is kept as an offset, so nothing jumps, and
//! the offset is worn off by the hand's own movements: an instrument never moves unless the hand does, and never against it.

use crate::kinematics::{TrocarLimits, TrocarState};
use bevy_ecs::prelude::*;
use keyhole_whiteboard::{AxisInput, DeviceHand};

/// Part of a movement by which an offset is worn off.
const WEAR: f32 = 0.2;
/// Distance at which the rings have come to the jaws, of the way from open to closed.
const NEAR: f32 = 0.05;

/// What an instrument remembers of the device that moves it.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct DeviceClutch {
    engaged: Option<u64>,
    /// Of yaw, pitch, insertion and roll.
    axes: [AxisClutch; 4],
    grip: GripClutch,
    /// The pedal has been up since the device took over.
    pedal: bool,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct AxisClutch {
    /// Where the handle was, and the instrument's place less that.
    held: Option<(f32, f32)>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct GripClutch {
    /// Where the rings were.
    before: Option<f32>,
    /// The jaws follow them.
    caught: bool,
    axis: AxisClutch,
}

impl GripClutch {
    /// The jaws stay as they are until the rings have come to where the jaws are: what is held is neither dropped nor crushed.
    fn follow(&mut self, jaws: f32, rings: f32) -> f32 {
        let passed = self.before.replace(rings).is_some_and(|before| (before - jaws) * (rings - jaws) <= 0.0);
        self.caught |= passed || (rings - jaws).abs() <= NEAR;
        if self.caught { self.axis.follow(jaws, AxisInput { at: Some(rings), by: 0.0 }, 1.0) } else { jaws }
    }
}

impl AxisClutch {
    /// The new place of a degree of freedom that is at `place`. `sign` is -1 where the tip goes the other way than the handle.
    fn follow(&mut self, place: f32, input: AxisInput, sign: f32) -> f32 {
        let Some(at) = input.at.map(|at| sign * at) else { return place + sign * input.by };
        let Some((before, offset)) = self.held else {
            self.held = Some((at, place - at));
            return place;
        };
        let worn = WEAR * (at - before).abs();
        let offset = if offset.abs() <= worn { 0.0 } else { offset - worn * offset.signum() };
        self.held = Some((at, offset));
        at + offset
    }
}

/// The instrument in a hand that a device moves, after one tick.
#[must_use]
pub fn device_tick(state: TrocarState, clutch: &mut DeviceClutch, hand: &DeviceHand, limits: &TrocarLimits) -> TrocarState {
    if !hand.live {
        *clutch = DeviceClutch::default();
        return TrocarState { pedal: false, ..state };
    }
    if clutch.engaged != Some(hand.engaged) {
        *clutch = DeviceClutch { engaged: Some(hand.engaged), ..Default::default() };
    }
    let [yaw, pitch, insertion, roll] = &mut clutch.axes;
    let followed = TrocarState {
        // Mirrored about the port.
        yaw_rad: yaw.follow(state.yaw_rad, hand.yaw, -1.0),
        pitch_rad: pitch.follow(state.pitch_rad, hand.pitch, -1.0),
        insertion_m: insertion.follow(state.insertion_m, hand.insertion, 1.0),
        roll_rad: roll.follow(state.roll_rad, hand.roll, 1.0),
        grip: hand.grip.map_or(state.grip, |rings| clutch.grip.follow(state.grip, rings)),
        pedal: hand.pedal && clutch.pedal,
    };
    clutch.pedal |= !hand.pedal;
    limits.clamp(followed)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(value: f32) -> AxisInput {
        AxisInput { at: Some(value), by: 0.0 }
    }

    fn hand(yaw: f32, grip: f32, engaged: u64) -> DeviceHand {
        DeviceHand { live: true, engaged, yaw: at(yaw), grip: Some(grip), ..Default::default() }
    }

    #[test]
    fn taking_over_moves_nothing_and_the_offset_wears_off_as_the_hand_moves() {
        let (limits, mut clutch) = (TrocarLimits::default(), DeviceClutch::default());
        let mut state = TrocarState { yaw_rad: 0.3, insertion_m: 0.1, grip: 0.8, ..Default::default() };
        state = device_tick(state, &mut clutch, &hand(0.2, 0.0, 1), &limits);
        assert_eq!((state.yaw_rad, state.grip), (0.3, 0.8));
        let mut handle = 0.2;
        for i in 0..400 {
            let before = (handle, state.yaw_rad);
            handle = 0.2 + 0.2 * (i as f32 * 0.05).sin();
            state = device_tick(state, &mut clutch, &hand(handle, 0.0, 1), &limits);
            let (hand, tip) = (handle - before.0, state.yaw_rad - before.1);
            assert!(hand * tip <= 0.0, "never against the hand, mirrored");
            assert!(tip.abs() <= 1.2001 * hand.abs() + 1e-6, "{tip} for {hand}");
        }
        assert!((state.yaw_rad + handle).abs() < 1e-6, "{} and {handle}", state.yaw_rad);
        assert_eq!(state.grip, 0.8, "the rings have not come to the jaws");
        state = device_tick(state, &mut clutch, &hand(handle, 0.9, 1), &limits);
        assert_eq!(state.grip, 0.8, "the jaws begin to follow where they are");
        state = device_tick(state, &mut clutch, &hand(handle, 0.1, 1), &limits);
        assert_eq!(state.grip, 0.1);
    }

    #[test]
    fn a_fault_freezes_and_a_pedal_that_is_down_afterwards_does_not_cut() {
        let (limits, mut clutch) = (TrocarLimits::default(), DeviceClutch::default());
        let pedal = |down, engaged| DeviceHand { pedal: down, ..hand(0.0, 0.5, engaged) };
        let start = TrocarState { insertion_m: 0.1, grip: 0.5, ..Default::default() };
        let mut state = device_tick(start, &mut clutch, &pedal(false, 1), &limits);
        state = device_tick(state, &mut clutch, &pedal(true, 1), &limits);
        assert!(state.pedal);
        let frozen = device_tick(state, &mut clutch, &DeviceHand { live: false, ..pedal(true, 1) }, &limits);
        assert_eq!(frozen, TrocarState { pedal: false, ..state });
        state = device_tick(frozen, &mut clutch, &DeviceHand { yaw: at(0.5), ..pedal(true, 2) }, &limits);
        assert_eq!(state, frozen, "the handle is elsewhere now");
        state = device_tick(state, &mut clutch, &DeviceHand { yaw: at(0.5), ..pedal(false, 2) }, &limits);
        assert!(!state.pedal);
        state = device_tick(state, &mut clutch, &DeviceHand { yaw: at(0.5), ..pedal(true, 2) }, &limits);
        assert!(state.pedal);
    }

    #[test]
    fn a_movement_beyond_a_limit_leaves_nothing_to_be_undone_and_a_position_comes_back_where_it_was() {
        let (limits, mut clutch) = (TrocarLimits::default(), DeviceClutch::default());
        let by = |m| DeviceHand { live: true, insertion: AxisInput { at: None, by: m }, ..Default::default() };
        let mut state = TrocarState { insertion_m: 0.29, ..Default::default() };
        state = device_tick(state, &mut clutch, &by(0.5), &limits);
        assert_eq!(state.insertion_m, limits.insertion_max_m);
        state = device_tick(state, &mut clutch, &by(-0.1), &limits);
        assert!((state.insertion_m - (limits.insertion_max_m - 0.1)).abs() < 1e-6);
    }
}
