//! Two handles in a device that is not there, through the code of real ones: its profile, its descriptor, and its reports at 1000 Hz.

use keyhole_hid::{DeviceInfo, HidPlugin, Profile, VirtualBus, VirtualDevice, Wire, WireField};
use keyhole_instruments::TrocarState;
use std::ops::Range;
use std::time::Duration;

const PROFILE: &str = r#"(
    name: "two handles", matches: [Named("two handles")], rate_hz: 1000.0,
    hands: [
        (
            hand: Right,
            yaw: (from: Usage(page: 1, usage: 0x30), means: (-60.0, 60.0)),
            pitch: (from: Usage(page: 1, usage: 0x31), means: (-60.0, 60.0)),
            insertion: (from: Usage(page: 1, usage: 0x32), means: (0.0, 250.0)),
            opening: (from: Usage(page: 1, usage: 0x33), means: (0.0, 1.0)),
            roll: (from: Usage(page: 2, usage: 0x30), means: (-360.0, 360.0)),
            pedal: [(from: Usage(page: 9, usage: 1))],
        ),
        (
            hand: Left,
            yaw: (from: Usage(page: 1, usage: 0x34), means: (-60.0, 60.0)),
            pitch: (from: Usage(page: 1, usage: 0x35), means: (-60.0, 60.0)),
            insertion: (from: Usage(page: 1, usage: 0x36), means: (0.0, 250.0)),
            opening: (from: Usage(page: 1, usage: 0x37), means: (0.0, 1.0)),
            roll: (from: Usage(page: 2, usage: 0x31), means: (-360.0, 360.0)),
            pedal: [(from: Usage(page: 9, usage: 2))],
        ),
    ],
)"#;

/// Counts from one end of an axis to the other.
const COUNTS: i32 = 60_000;

fn wire() -> Wire {
    let axis = |usage| WireField { usage, bits: 16, least: 0, most: COUNTS };
    let button = |usage| WireField { usage: (9, usage), bits: 1, least: 0, most: 1 };
    let fields = (0x30..0x38).map(|usage| axis((1, usage))).chain((0x30..0x32).map(|usage| axis((2, usage)))).chain([1, 2].map(button));
    Wire { device: (1, 4), fields: fields.collect() }
}

/// The report of two handles, the right one first, that have their instruments in these states: a handle goes the other way than its tip.
pub fn report(states: [TrocarState; 2]) -> Vec<u8> {
    let count = |part: f32| (f64::from(part) * f64::from(COUNTS)).round() as i64;
    let angle = |rad: f32| count((60.0 - rad.to_degrees()) / 120.0);
    let axes = states.map(|s| [angle(s.yaw_rad), angle(s.pitch_rad), count(s.insertion_m / 0.25), count(1.0 - s.grip)]);
    let turns = states.map(|s| count((360.0 + s.roll_rad.to_degrees()) / 720.0));
    let pedals = states.map(|s| i64::from(s.pedal));
    wire().report(&[axes.as_flattened(), &turns, &pedals].concat())
}

/// The device, plugged in at these times, s; at every millisecond it says the report that `says` gives for the time, s.
pub fn device(plugged: &[Range<f64>], says: impl Fn(f64) -> Vec<u8> + Send + 'static) -> HidPlugin {
    let seconds = Duration::from_secs_f64;
    let device = VirtualDevice {
        info: DeviceInfo { path: "virtual".into(), name: "two handles".into(), ..Default::default() },
        descriptor: wire().descriptor(),
        plugged: plugged.iter().map(|p| seconds(p.start)..seconds(p.end)).collect(),
        denied: Vec::new(),
        feed: Box::new((0..).map(move |ms: u64| (Duration::from_millis(ms), says(ms as f64 * 1e-3)))),
    };
    let profile = Profile::parse("two handles", PROFILE).unwrap_or_else(|e| panic!("{e}"));
    HidPlugin::stepped(VirtualBus::new(vec![device]), vec![profile])
}
