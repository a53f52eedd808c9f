//! Long streams, and devices of each shipped profile.

use crate::common::*;
use keyhole_hid::calibrate::{Observer, STAGES, blank, put};
use keyhole_hid::profile::HandChoice;
use keyhole_hid::shipped::shipped;
use keyhole_hid::virtual_bus::Feed;
use keyhole_hid::{DeviceInfo, Layout, Mapping, Profile, VirtualDevice, Wire, WireField};
use keyhole_whiteboard::{DeviceCondition, Hand};
use std::time::Duration;

#[test]
fn ten_minutes_at_1000_hz_and_every_tick_has_the_newest() {
    // One count a millisecond, up and down: the count tells which report it was.
    let count = |ms: u64| {
        let way = ms % (2 * COUNTS as u64);
        way.min(2 * COUNTS as u64 - way) as i64
    };
    let feed = stream(move |at_s| wire().report(&[count((at_s * 1e3).round() as u64), 0, 0, 0, 0, 0]));
    let (mut app, _) = theatre(vec![device("a", always(), feed)], vec![profile()]);
    run_until(&mut app, 0.1);
    while now_s(&app) < 600.0 {
        app.update();
        let yaw = f64::from(hand(&app, Hand::Right).yaw.at.unwrap()).to_degrees();
        let newest = count((now_s(&app) * 1e3 + 1e-6).floor() as u64);
        assert_eq!(((yaw + 60.0) / 120.0 * COUNTS as f64).round() as i64, newest, "at {} s", now_s(&app));
    }
    assert_eq!((status(&app).reports, status(&app).refused), (600_001, 0));
}

fn field(usage: (u16, u16), bits: u8, least: i32, most: i32) -> WireField {
    WireField { usage, bits, least, most }
}

fn shipped_profile(name: &str) -> Profile {
    shipped().unwrap().into_iter().find(|p| p.name == name).unwrap()
}

fn of_kind(name: &str, usage: (u16, u16), wire: &Wire, feed: Feed) -> VirtualDevice {
    let info = DeviceInfo { path: "virtual/kind".into(), name: name.into(), usages: vec![usage], ..Default::default() };
    VirtualDevice { info, descriptor: wire.descriptor(), plugged: always(), denied: Vec::new(), feed }
}

#[test]
fn a_gamepad_moves_both_hands_and_stops_when_its_sticks_are_let_go() {
    let mut fields: Vec<WireField> = [0x30, 0x31, 0x32, 0x35].map(|u| field((1, u), 8, 0, 255)).into();
    fields.push(field((1, 0x39), 4, 0, 8));
    fields.extend((1..=12).map(|b| field((9, b), 1, 0, 1)));
    let wire = Wire { device: (1, 5), fields };
    // A pad speaks when something changes: left stick to the right and button 8 at half a second, everything let go at one and a half.
    let mut pushed = [128i64, 128, 128, 128, 8, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
    let rest = wire.report(&pushed);
    (pushed[0], pushed[5 + 7]) = (255, 1);
    let spoken = vec![(s(0.4), rest.clone()), (s(0.5), wire.report(&pushed)), (s(1.5), rest)];
    let pad = of_kind("Some Pad", (1, 5), &wire, Box::new(spoken.into_iter()));
    let (mut app, _) = theatre(vec![pad], shipped().unwrap());
    let (mut yaw, mut insertion) = (0.0, 0.0);
    while now_s(&app) < 3.0 {
        app.update();
        let hands = app.world().resource::<keyhole_whiteboard::DeviceHands>();
        yaw += hands.left.map_or(0.0, |h| h.yaw.by);
        insertion += hands.right.map_or(0.0, |h| h.insertion.by);
    }
    // A second at 60 degrees and at 60 mm a second.
    assert!((yaw.to_degrees() - 60.0).abs() < 0.5, "{}", yaw.to_degrees());
    assert!((insertion - 0.06).abs() < 5e-4, "{insertion}");
    assert_eq!(condition(&app), DeviceCondition::Live, "a pad that says nothing is at rest");
}

#[test]
fn a_3d_mouse_sends_an_axis_in_one_report_and_its_buttons_in_another() {
    // Report 1 holds six axes of 16 bits, report 3 two buttons; written by hand, for the identifiers.
    let mut descriptor = vec![0x05, 1, 0x09, 8, 0xa1, 1, 0x85, 1, 0x16, 0xa2, 0xfe, 0x26, 0x5e, 1, 0x75, 16, 0x95, 6];
    descriptor.extend([0x09, 0x30, 0x09, 0x31, 0x09, 0x32, 0x09, 0x33, 0x09, 0x34, 0x09, 0x35, 0x81, 2]);
    descriptor.extend([0x85, 3, 0x05, 9, 0x19, 1, 0x29, 2, 0x15, 0, 0x25, 1, 0x75, 1, 0x95, 2, 0x81, 2, 0x75, 6, 0x95, 1, 0x81, 3, 0xc0]);
    let mut mapping = Mapping::fit(&shipped_profile("3D mouse"), &descriptor).unwrap();
    let axes = |x: i16| [&[1u8][..], &x.to_le_bytes(), &[0; 10]].concat();
    mapping.take(Duration::ZERO, &axes(350)).unwrap();
    mapping.take(s(0.05), &[3, 1]).unwrap();
    mapping.take(s(0.1), &axes(0)).unwrap();
    mapping.take(s(0.2), &axes(0)).unwrap();
    let reading = mapping.reading(0);
    assert!((reading.moved[0].to_degrees() - 6.0).abs() < 1e-9, "a tenth of a second at 60 degrees a second: {reading:?}");
    assert_eq!((reading.grip, reading.pedal), (Some(1.0), false));
    assert!(mapping.take(s(0.3), &[3]).is_err() && mapping.take(s(0.3), &[2, 0]).is_err() && mapping.take(s(0.3), &[]).is_err());
}

#[test]
fn a_port_that_tells_its_direction_says_which_way_the_handle_points() {
    let mut mapping = Mapping::fit(&shipped_profile("Xitact-like port"), &[]).unwrap();
    let (yaw, pitch) = (20f64.to_radians(), -10f64.to_radians());
    let unit = [pitch.cos() * yaw.sin(), pitch.sin(), pitch.cos() * yaw.cos()].map(|c| (c * 32_767.0).round() as i16);
    let mut report = vec![1u8];
    for part in [unit[0], unit[1], unit[2], 12_000, 15_708] {
        report.extend(part.to_le_bytes());
    }
    report.extend([51, 0b1_1001]);
    mapping.take(Duration::ZERO, &report).unwrap();
    let reading = mapping.reading(0);
    let at = reading.at.map(Option::unwrap);
    assert!((at[0] - yaw).abs() < 1e-4 && (at[1] - pitch).abs() < 1e-4, "{at:?}");
    assert!((at[2] - 0.12).abs() < 1e-9 && (at[3] - std::f64::consts::FRAC_PI_2).abs() < 1e-4, "{at:?}");
    assert!((reading.grip.unwrap() - 0.8).abs() < 1e-9 && reading.pedal);
    assert_eq!(mapping.not_homed(), None);
    *report.last_mut().unwrap() = 0b0_1000;
    mapping.take(s(0.002), &report).unwrap();
    assert_eq!(mapping.not_homed(), Some(1), "the trocar has not been tilted");
}

#[test]
fn an_arduino_counts_a_mouse_sensor_and_smooths_its_potentiometer() {
    let mut fields: Vec<WireField> = [0x33, 0x34, 0x36].map(|u| field((1, u), 16, 0, 65_535)).into();
    fields.extend([0x30, 0x31].map(|u| field((1, u), 8, -127, 127)));
    fields.push(field((9, 1), 1, 0, 1));
    let wire = Wire { device: (1, 4), fields };
    let mut mapping = Mapping::fit(&shipped_profile("Arduino trainer"), &wire.descriptor()).unwrap();
    for i in 0..200u32 {
        let tremor = if i % 2 == 0 { 30 } else { -30 };
        mapping.take(Duration::from_millis(5 * u64::from(i)), &wire.report(&[32_768 + tremor, 32_768, 40_000, 0, 4, 0])).unwrap();
    }
    let reading = mapping.reading(0);
    assert!((reading.moved[2] - 800.0 * 25.4e-3 / 800.0).abs() < 1e-12, "800 counts are an inch: {reading:?}");
    assert!(reading.at[0].unwrap().to_degrees().abs() < 0.1);
    assert_eq!(reading.at[2], None);
}

#[test]
fn every_shipped_profile_survives_being_written() {
    for profile in shipped().unwrap() {
        let text = profile.to_ron().unwrap();
        assert_eq!(Profile::parse("written", &text).unwrap(), profile, "{text}");
    }
}

#[test]
fn errors_of_a_profile_name_the_line_and_what_was_expected() {
    let said = |text: &str| Profile::parse("my.ron", text).unwrap_err().to_string();
    assert!(said("(\n  name: \"x\",\n  colour: 3,\n)").starts_with("my.ron:3:"), "{}", said("(\n  name: \"x\",\n  colour: 3,\n)"));
    let same = PROFILE.replace("(-60.0, 60.0)", "(5.0, 5.0)");
    assert!(said(&same).contains("yaw: `means` are two different numbers"), "{}", said(&same));
    let unknown = PROFILE.replace("usage: 0x34", "usage: 0x77");
    let error = Mapping::fit(&Profile::parse("my.ron", &unknown).unwrap(), &wire().descriptor()).unwrap_err().to_string();
    assert!(error.starts_with("pitch: the device has no usage 0x0001:0x0077"), "{error}");
}

#[test]
fn a_calibration_finds_each_axis_and_its_profile_reads_the_hand() {
    let layout = Layout::read(&wire().descriptor()).unwrap();
    let mut observer = Observer::new(layout);
    let mut made = blank("mine", &info("a"), HandChoice::Right);
    // Every movement is one of a hand: the others move a little too.
    let ends = [
        [Held { yaw: -45.0, ..REST }, Held { yaw: 45.0, pitch: 5.0, ..REST }],
        [Held { pitch: -45.0, ..REST }, Held { pitch: 45.0, insertion: 104.0, ..REST }],
        [Held { insertion: 50.0, roll: 3.0, ..REST }, Held { insertion: 150.0, ..REST }],
        [Held { roll: -90.0, ..REST }, Held { roll: 90.0, ..REST }],
        [Held { opening: 0.0, ..REST }, Held { opening: 1.0, ..REST }],
    ];
    for (stage, [from, to]) in STAGES.into_iter().zip(ends) {
        observer.hear(&from.report());
        let before = observer.position();
        assert_eq!(observer.moved(&before, &observer.position()), None);
        observer.hear(&to.report());
        let found = observer.moved(&before, &observer.position()).unwrap();
        observer.take(&found);
        put(&mut made.hands[0], stage.dof, observer.axis(&found, stage.means));
    }
    observer.hear(&REST.report());
    let up = observer.position();
    observer.hear(&Held { pedal: true, ..REST }.report());
    let pedal = observer.moved(&up, &observer.position()).unwrap();
    made.hands[0].pedal.push(Observer::button(&pedal));
    let made = Profile::parse("made", &made.to_ron().unwrap()).unwrap();
    let mut mapping = Mapping::fit(&made, &wire().descriptor()).unwrap();
    let held = Held { yaw: 30.0, pitch: -12.0, insertion: 80.0, roll: 20.0, opening: 0.3, pedal: true };
    mapping.take(Duration::ZERO, &held.report()).unwrap();
    let reading = mapping.reading(0);
    let at = reading.at.map(Option::unwrap);
    assert!(
        (at[0].to_degrees() - 30.0).abs() < 0.01 && (at[1].to_degrees() + 12.0).abs() < 0.01 && (at[3].to_degrees() - 20.0).abs() < 0.01
    );
    // What the trainee called 0 mm was at 50.
    assert!((at[2] - 0.03).abs() < 1e-5 && (reading.grip.unwrap() - 0.7).abs() < 1e-4 && reading.pedal, "{reading:?}");
}
