//! A made-up device with five axes and a pedal, and a theatre without a room around it.

use bevy_app::prelude::*;
use bevy_time::{Fixed, Time, TimePlugin, TimeUpdateStrategy};
use keyhole_hid::virtual_bus::Feed;
use keyhole_hid::{DeviceInfo, HidPlugin, Profile, VirtualBus, VirtualDevice, Wire, WireField};
use keyhole_whiteboard::{DeviceCondition, DeviceHand, DeviceHands, DeviceReport, DeviceStatus, Hand, WhiteboardPlugin};
use std::ops::Range;
use std::time::Duration;

pub const HZ: f64 = 60.0;
/// Counts of an axis from one end to the other.
pub const COUNTS: i64 = 65_535;

/// One hand: yaw, pitch, insertion, roll, opening of 16 bits, and a pedal.
pub const PROFILE: &str = r#"(
    name: "made up", matches: [Device(vendor: 0x1209, product: 0x0001)], rate_hz: 1000.0,
    hands: [(
        hand: Any,
        yaw: (from: Usage(page: 1, usage: 0x33), means: (-60.0, 60.0)),
        pitch: (from: Usage(page: 1, usage: 0x34), means: (-60.0, 60.0)),
        insertion: (from: Usage(page: 1, usage: 0x32), means: (0.0, 250.0)),
        roll: (from: Usage(page: 1, usage: 0x35), means: (-180.0, 180.0), wraps: true),
        opening: (from: Usage(page: 1, usage: 0x36), means: (0.0, 1.0)),
        pedal: [(from: Usage(page: 9, usage: 1))],
    )],
    force: (report: 0, bytes: 4, channels: [
        (effort: Insertion, start: 0, bits: 16, counts_per_unit: 1000.0, limit: 10.0),
        (effort: Yaw, start: 16, bits: 16, counts_per_unit: 1000.0, limit: 2.0),
    ]),
)"#;

pub fn profile() -> Profile {
    Profile::parse("test", PROFILE).unwrap()
}

pub fn wire() -> Wire {
    let axis = |usage| WireField { usage: (1, usage), bits: 16, least: 0, most: COUNTS as i32 };
    let button = WireField { usage: (9, 1), bits: 1, least: 0, most: 1 };
    Wire { device: (1, 4), fields: vec![axis(0x33), axis(0x34), axis(0x32), axis(0x35), axis(0x36), button] }
}

/// Where a hand holds the handle: degrees, millimetres, opening.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Held {
    pub yaw: f64,
    pub pitch: f64,
    pub insertion: f64,
    pub roll: f64,
    pub opening: f64,
    pub pedal: bool,
}

pub const REST: Held = Held { yaw: 0.0, pitch: 0.0, insertion: 100.0, roll: 0.0, opening: 1.0, pedal: false };

impl Held {
    pub fn report(&self) -> Vec<u8> {
        let count = |value: f64, low: f64, high: f64| ((value - low) / (high - low) * COUNTS as f64).round() as i64;
        wire().report(&[
            count(self.yaw, -60.0, 60.0),
            count(self.pitch, -60.0, 60.0),
            count(self.insertion, 0.0, 250.0),
            count(self.roll, -180.0, 180.0),
            count(self.opening, 0.0, 1.0),
            i64::from(self.pedal),
        ])
    }
}

pub fn s(seconds: f64) -> Duration {
    Duration::from_secs_f64(seconds)
}

pub fn info(serial: &str) -> DeviceInfo {
    DeviceInfo {
        path: format!("virtual/{serial}"),
        vendor: 0x1209,
        product: 1,
        name: "made-up trainer".into(),
        serial: serial.into(),
        usages: vec![(1, 4)],
    }
}

/// Reports at 1000 Hz, each made from its time in seconds.
pub fn stream(report: impl Fn(f64) -> Vec<u8> + Send + 'static) -> Feed {
    Box::new((0u64..).map(move |ms| (Duration::from_millis(ms), report(ms as f64 * 1e-3))))
}

/// Reports at 1000 Hz of a hand that moves.
pub fn moving(held: impl Fn(f64) -> Held + Send + 'static) -> Feed {
    stream(move |at_s| held(at_s).report())
}

pub fn device(serial: &str, plugged: Vec<Range<Duration>>, feed: Feed) -> VirtualDevice {
    VirtualDevice { info: info(serial), descriptor: wire().descriptor(), plugged, denied: Vec::new(), feed }
}

pub fn always() -> Vec<Range<Duration>> {
    vec![Duration::ZERO..Duration::MAX]
}

/// The whiteboard with devices on a virtual bus; each update is one tick.
pub fn theatre(devices: Vec<VirtualDevice>, profiles: Vec<Profile>) -> (App, VirtualBus) {
    let bus = VirtualBus::new(devices);
    let mut app = App::new();
    app.add_plugins((TimePlugin, WhiteboardPlugin, HidPlugin::stepped(bus.clone(), profiles)))
        .insert_resource(Time::<Fixed>::from_hz(HZ))
        .insert_resource(TimeUpdateStrategy::FixedTimesteps(1));
    // The clock's first update measures no time and runs no tick.
    app.update();
    (app, bus)
}

pub fn now_s(app: &App) -> f64 {
    app.world().resource::<Time<Fixed>>().elapsed_secs_f64()
}

/// Ticks until so many seconds have passed since the beginning.
pub fn run_until(app: &mut App, seconds: f64) {
    while now_s(app) < seconds {
        app.update();
    }
}

pub fn hand(app: &App, hand: Hand) -> DeviceHand {
    *app.world().resource::<DeviceHands>().get(hand).unwrap()
}

pub fn status(app: &App) -> &DeviceReport {
    &app.world().resource::<DeviceStatus>().0[0]
}

pub fn condition(app: &App) -> DeviceCondition {
    status(app).condition
}
