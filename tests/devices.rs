//! Instruments in a device: a virtual one through the code of real ones, the instruments as they are in the program.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

use bevy::app::App;
use bevy::math::Vec3;
use bevy::prelude::{Entity, Fixed, Time};
use bevy::time::{TimePlugin, TimeUpdateStrategy};
use keyhole_hid::{DeviceInfo, HidPlugin, Profile, VirtualBus, VirtualDevice, Wire, WireField};
use keyhole_instruments::{InstrumentsPlugin, PortFrame, TrocarState};
use keyhole_whiteboard::{
    Blade, DeviceCondition, DeviceStatus, Hand, Instrument, InstrumentKind, InstrumentPose, Jaws, Port, SceneRequirements, WhiteboardPlugin,
};
use std::ops::Range;
use std::time::Duration;

const PROFILE: &str = r#"(
    name: "made up", matches: [Named("made up")], rate_hz: 1000.0,
    hands: [(
        hand: Right,
        yaw: (from: Usage(page: 1, usage: 0x33), means: (-60.0, 60.0)),
        pitch: (from: Usage(page: 1, usage: 0x34), means: (-60.0, 60.0)),
        insertion: (from: Usage(page: 1, usage: 0x32), means: (0.0, 250.0)),
        opening: (from: Usage(page: 1, usage: 0x36), means: (0.0, 1.0)),
        pedal: [(from: Usage(page: 9, usage: 1))],
    )],
)"#;

/// Yaw and pitch in degrees, insertion in millimetres, opening, pedal.
#[derive(Clone, Copy)]
struct Held(f64, f64, f64, f64, bool);

fn wire() -> Wire {
    let axis = |usage| WireField { usage: (1, usage), bits: 16, least: 0, most: 60_000 };
    let button = WireField { usage: (9, 1), bits: 1, least: 0, most: 1 };
    Wire { device: (1, 4), fields: vec![axis(0x33), axis(0x34), axis(0x32), axis(0x36), button] }
}

fn report(held: Held) -> Vec<u8> {
    let count = |part: f64| (part * 60_000.0).round() as i64;
    let Held(yaw, pitch, insertion, opening, pedal) = held;
    wire().report(&[count((yaw + 60.0) / 120.0), count((pitch + 60.0) / 120.0), count(insertion / 250.0), count(opening), i64::from(pedal)])
}

struct Bench {
    app: App,
    tool: Entity,
    port: Port,
}

impl Bench {
    /// A hand at 1000 Hz, plugged in at these times, s; reports of no bytes while `broken`.
    fn new(kind: InstrumentKind, plugged: &[Range<f64>], broken: Range<f64>, held: impl Fn(f64) -> Held + Send + 'static) -> Self {
        let seconds = Duration::from_secs_f64;
        let say = move |ms: u64| {
            let at_s = ms as f64 * 1e-3;
            (Duration::from_millis(ms), if broken.contains(&at_s) { vec![0] } else { report(held(at_s)) })
        };
        let device = VirtualDevice {
            info: DeviceInfo { path: "virtual".into(), name: "made up".into(), ..Default::default() },
            descriptor: wire().descriptor(),
            plugged: plugged.iter().map(|p| seconds(p.start)..seconds(p.end)).collect(),
            denied: Vec::new(),
            feed: Box::new((0..).map(say)),
        };
        let mut app = App::new();
        let hid = HidPlugin::stepped(VirtualBus::new(vec![device]), vec![Profile::parse("test", PROFILE).unwrap()]);
        app.add_plugins((TimePlugin, WhiteboardPlugin, InstrumentsPlugin, hid))
            .insert_resource(Time::<Fixed>::from_hz(60.0))
            .insert_resource(TimeUpdateStrategy::FixedTimesteps(1))
            .insert_resource(SceneRequirements { instruments: true, ..Default::default() });
        let instrument = Instrument { kind, name: "tool".into(), shaft_length_m: 0.33, shaft_radius_m: 0.0025 };
        let port = Port { position: Vec3::ZERO, inward: Vec3::NEG_Z };
        let state = TrocarState { insertion_m: 0.1, ..Default::default() };
        let tool = app.world_mut().spawn((instrument, Hand::Right, port, state)).id();
        app.update();
        Self { app, tool, port }
    }

    fn until(&mut self, seconds: f64) {
        while self.app.world().resource::<Time<Fixed>>().elapsed_secs_f64() < seconds {
            self.app.update();
        }
    }

    fn now_s(&self) -> f64 {
        self.app.world().resource::<Time<Fixed>>().elapsed_secs_f64()
    }

    fn tip(&self) -> Vec3 {
        Vec3::from(self.app.world().get::<InstrumentPose>(self.tool).unwrap().now.translation)
    }

    fn state(&self) -> TrocarState {
        *self.app.world().get(self.tool).unwrap()
    }

    fn jaws_rad(&self) -> f32 {
        self.app.world().get::<Jaws>(self.tool).unwrap().angle_rad
    }

    fn condition(&self) -> DeviceCondition {
        self.app.world().resource::<DeviceStatus>().0[0].condition
    }
}

const ALWAYS: [Range<f64>; 1] = [0.0..1e6];

#[test]
fn a_handle_to_the_right_moves_the_tip_to_the_left_and_the_deeper_the_farther() {
    let mut shifts = Vec::new();
    for depth_mm in [50.0, 150.0] {
        let held = move |at_s: f64| Held(if at_s < 1.0 { 0.0 } else { (20.0 * (at_s - 1.0)).min(10.0) }, 0.0, depth_mm, 1.0, false);
        let mut bench = Bench::new(InstrumentKind::Grasper, &ALWAYS, 0.0..0.0, held);
        // In a theatre the instrument stands where the scene put it; here it is put to the handle's depth.
        bench.app.world_mut().get_mut::<TrocarState>(bench.tool).unwrap().insertion_m = depth_mm as f32 * 1e-3;
        bench.until(0.9);
        let before = bench.tip();
        bench.until(2.0);
        let right = PortFrame::of(&bench.port).right;
        shifts.push((bench.tip() - before).dot(right));
        let expected = -(depth_mm as f32) * 1e-3 * 10f32.to_radians().sin();
        assert!((shifts.last().unwrap() - expected).abs() < 1e-4, "{shifts:?}, expected {expected}");
    }
    assert!((shifts[1] / shifts[0] - 3.0).abs() < 0.02);
}

#[test]
fn unplugged_in_mid_grasp_the_instrument_holds_still_and_goes_on_from_there() {
    // The hand squeezes, goes away while the plug is out, comes back elsewhere with the rings open, and squeezes again.
    let held = |at_s: f64| match at_s {
        t if t < 2.0 => Held(10.0 * t, 0.0, 100.0, (1.0 - t).max(0.2), false),
        t if t < 4.0 => Held(-25.0, 15.0, 140.0, 1.0, false),
        t => Held(-25.0 + 5.0 * (t - 4.0), 15.0, 140.0, (1.0 - (t - 4.0)).max(0.1), false),
    };
    let mut bench = Bench::new(InstrumentKind::Grasper, &[0.0..1.9, 3.0..1e6], 0.0..0.0, held);
    bench.until(2.0);
    assert_eq!(bench.condition(), DeviceCondition::Unplugged);
    let (tip, jaws, state) = (bench.tip(), bench.jaws_rad(), bench.state());
    assert!(state.grip > 0.7, "it holds something: {state:?}");
    bench.until(2.9);
    assert_eq!((bench.tip(), bench.jaws_rad()), (tip, jaws), "out");
    bench.until(3.9);
    assert_eq!(bench.condition(), DeviceCondition::Live);
    assert_eq!((bench.tip(), bench.jaws_rad()), (tip, jaws), "in again, and the hand has not moved since");
    bench.until(4.4);
    assert!(bench.tip().distance(tip) > 1e-3, "it follows the hand again");
    assert_eq!(bench.jaws_rad(), jaws, "the rings have not come to the jaws");
    bench.until(5.5);
    assert!(bench.state().grip > 0.8, "and now they have");
}

#[test]
fn a_hook_does_not_cut_while_its_device_sends_garbage_nor_before_the_pedal_was_up() {
    let held = |at_s: f64| Held(5.0 * at_s.sin(), 0.0, 100.0, 1.0, (0.5..4.0).contains(&at_s) || at_s > 4.5);
    let mut bench = Bench::new(InstrumentKind::Hook, &ALWAYS, 2.0..3.0, held);
    let active = |bench: &Bench| bench.app.world().get::<Blade>(bench.tool).unwrap().active;
    bench.until(1.9);
    assert!(active(&bench));
    bench.until(2.1);
    assert_eq!(bench.condition(), DeviceCondition::Garbage);
    let tip = bench.tip();
    bench.until(2.9);
    assert!(!active(&bench) && bench.tip() == tip);
    bench.until(3.9);
    assert_eq!(bench.condition(), DeviceCondition::Live);
    assert!(!active(&bench), "the pedal has been down all the time");
    bench.until(5.0);
    assert!(active(&bench));
}

#[test]
fn a_stuck_axis_leaves_the_others_to_the_hand() {
    let held = |at_s: f64| Held(0.0, 40.0 * (6.0 * at_s).sin(), 125.0 + 80.0 * (5.0 * at_s).sin(), 1.0, false);
    let mut bench = Bench::new(InstrumentKind::Grasper, &ALWAYS, 0.0..0.0, held);
    bench.until(8.0);
    assert_eq!(bench.condition(), DeviceCondition::Stuck);
    let Held(_, pitch, ..) = held(bench.now_s());
    let state = bench.state();
    assert_eq!(state.yaw_rad, 0.0);
    // The tip goes up when the handle goes down; the offset of the beginning has worn off.
    assert!((state.pitch_rad.to_degrees() + pitch as f32).abs() < 0.5, "{} and {pitch}", state.pitch_rad.to_degrees());
}
