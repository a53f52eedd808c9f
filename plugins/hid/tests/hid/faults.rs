//! What a device can do to a procedure: each fault comes in the middle of a grasp, on the virtual clock, through the code that real devices go through.

use crate::common::*;
use bevy_math::{Isometry3d, Vec3};
use keyhole_hid::virtual_bus::Feed;
use keyhole_hid::{Profile, VirtualDevice};
use keyhole_whiteboard::{
    DeviceCondition, DeviceHands, DeviceStatus, Hand, Instrument, InstrumentKind, InstrumentPose, Port, SimulationControl, ToolForce,
};
use std::time::Duration;

fn grasp(at_s: f64) -> Held {
    Held { yaw: 20.0 * (2.0 * at_s).sin(), opening: 0.2, ..REST }
}

/// Sound for 2 s, then something else for 1 s, then sound again.
fn fault(during: impl Fn(f64) -> Vec<u8> + Send + 'static) -> Feed {
    stream(move |at_s| if (2.0..3.0).contains(&at_s) { during(at_s) } else { grasp(at_s).report() })
}

#[test]
fn a_sound_device_is_on_the_whiteboard_in_the_tick_after_its_report() {
    let (mut app, _) = theatre(vec![device("a", always(), moving(grasp))], vec![profile()]);
    run_until(&mut app, 2.0);
    let right = hand(&app, Hand::Right);
    let at_s = now_s(&app);
    // The newest report is at most a millisecond old.
    let newest = grasp((at_s * 1e3).floor() * 1e-3);
    assert!((f64::from(right.yaw.at.unwrap()).to_degrees() - newest.yaw).abs() < 0.003, "{right:?}");
    assert!((f64::from(right.insertion.at.unwrap()) - 0.1).abs() < 4e-6);
    assert!((right.grip.unwrap() - 0.8).abs() < 1e-4);
    assert!(right.live && !right.pedal);
    assert_eq!(condition(&app), DeviceCondition::Live);
    assert_eq!((status(&app).advice.as_str(), &status(&app).hands[..]), ("", &[Hand::Right][..]));
    assert!(app.world().resource::<DeviceHands>().left.is_none());
}

#[test]
fn unplugged_in_mid_grasp_and_plugged_in_elsewhere() {
    let plugged = vec![Duration::ZERO..s(2.0), s(3.0)..Duration::MAX];
    let (mut app, _) = theatre(vec![device("a", plugged, moving(grasp))], vec![profile()]);
    run_until(&mut app, 1.9);
    let before = hand(&app, Hand::Right);
    assert!(before.live);
    run_until(&mut app, 2.1);
    let gone = hand(&app, Hand::Right);
    assert!(!gone.live && !gone.pedal);
    assert_eq!(condition(&app), DeviceCondition::Unplugged);
    assert!(status(&app).advice.contains("plug it in again"), "{}", status(&app).advice);
    run_until(&mut app, 4.0);
    let back = hand(&app, Hand::Right);
    assert!(back.live && back.engaged > before.engaged, "whoever follows takes over anew");
    assert_eq!((condition(&app), app.world().resource::<DeviceStatus>().0.len()), (DeviceCondition::Live, 1));
}

#[test]
fn garbage_and_half_reports_freeze_the_hand_and_are_said() {
    let noise = |at_s: f64| {
        let mut seed = ((at_s * 1e3) as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        (0..11)
            .map(|_| {
                seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (seed >> 56) as u8
            })
            .collect::<Vec<u8>>()
    };
    let half = |at_s: f64| grasp(at_s).report()[..5].to_vec();
    let empty_or_long = |at_s: f64| if ((at_s * 1e3) as u64).is_multiple_of(2) { vec![0] } else { vec![0xff; 3] };
    for feed in [fault(noise), fault(half), fault(empty_or_long)] {
        let (mut app, _) = theatre(vec![device("a", always(), feed)], vec![profile()]);
        run_until(&mut app, 1.95);
        let (before, refused) = (hand(&app, Hand::Right), status(&app).refused);
        assert!(before.live && refused == 0);
        run_until(&mut app, 2.5);
        assert_eq!(condition(&app), DeviceCondition::Garbage);
        assert!(!hand(&app, Hand::Right).live);
        assert!(status(&app).refused > 100 && status(&app).advice.contains("made up"), "{:?}", status(&app));
        run_until(&mut app, 3.2);
        let after = hand(&app, Hand::Right);
        assert!(after.live && after.engaged > before.engaged);
        assert_eq!(condition(&app), DeviceCondition::Live);
        assert!((f64::from(after.yaw.at.unwrap()).to_degrees() - grasp(now_s(&app)).yaw).abs() < 0.1);
    }
}

#[test]
fn one_report_in_ten_that_is_nonsense_moves_nothing() {
    let spikes = stream(|at_s| {
        let sound = grasp(at_s);
        let nonsense = Held { yaw: -59.0, insertion: 249.0, ..sound };
        if (at_s * 1e3).round() as u64 % 10 == 7 { nonsense.report() } else { sound.report() }
    });
    let (mut app, _) = theatre(vec![device("a", always(), spikes)], vec![profile()]);
    run_until(&mut app, 0.5);
    let engaged = hand(&app, Hand::Right).engaged;
    while now_s(&app) < 3.0 {
        app.update();
        let right = hand(&app, Hand::Right);
        assert!(right.live && right.engaged == engaged);
        assert!((f64::from(right.yaw.at.unwrap()).to_degrees() - grasp(now_s(&app)).yaw).abs() < 0.1);
    }
    assert!(status(&app).refused > 200);
}

#[test]
fn silence_freezes_and_is_said() {
    let feed = Box::new(moving(grasp).filter(|(at, _)| !(s(2.0)..s(3.0)).contains(at)));
    let (mut app, _) = theatre(vec![device("a", always(), feed)], vec![profile()]);
    run_until(&mut app, 2.2);
    assert_eq!(condition(&app), DeviceCondition::Live, "a quarter of a second may be a hiccup");
    run_until(&mut app, 2.4);
    assert_eq!(condition(&app), DeviceCondition::Silent);
    assert!(!hand(&app, Hand::Right).live);
    run_until(&mut app, 3.2);
    assert!(hand(&app, Hand::Right).live);
}

#[test]
fn a_stuck_axis_is_named_and_the_others_go_on() {
    let held = |at_s: f64| Held { yaw: 12.0, pitch: 50.0 * (6.0 * at_s).sin(), insertion: 125.0 + 100.0 * (5.0 * at_s).sin(), ..REST };
    let (mut app, _) = theatre(vec![device("a", always(), moving(held))], vec![profile()]);
    run_until(&mut app, 0.3);
    assert_eq!(condition(&app), DeviceCondition::Live);
    run_until(&mut app, 8.0);
    assert_eq!(condition(&app), DeviceCondition::Stuck);
    // Roll does not move either; yaw is the first.
    assert!(status(&app).advice.contains("yaw"), "{}", status(&app).advice);
    let right = hand(&app, Hand::Right);
    assert!(right.live && (f64::from(right.pitch.at.unwrap()).to_degrees() - held(now_s(&app)).pitch).abs() < 0.5);
}

#[test]
fn a_trembling_axis_is_named_and_followed() {
    let held = |at_s: f64| {
        let tremor = if ((at_s * 1e3).round() as u64).is_multiple_of(2) { 2.0 } else { -2.0 };
        Held { pitch: tremor, ..grasp(at_s) }
    };
    let (mut app, _) = theatre(vec![device("a", always(), moving(held))], vec![profile()]);
    run_until(&mut app, 1.0);
    assert_eq!(condition(&app), DeviceCondition::Noisy);
    assert!(status(&app).advice.starts_with("pitch") && hand(&app, Hand::Right).live);
}

#[test]
fn a_device_that_may_not_be_opened_comes_with_the_rule_that_opens_it() {
    let denied = VirtualDevice { denied: vec![Duration::ZERO..s(2.0)], ..device("a", always(), moving(grasp)) };
    let (mut app, _) = theatre(vec![denied], vec![profile()]);
    run_until(&mut app, 1.0);
    assert_eq!(condition(&app), DeviceCondition::Denied);
    let rule = r#"KERNEL=="hidraw*", ATTRS{idVendor}=="1209", ATTRS{idProduct}=="0001", TAG+="uaccess""#;
    assert!(status(&app).advice.contains(rule), "{}", status(&app).advice);
    run_until(&mut app, 2.7);
    assert_eq!((condition(&app), app.world().resource::<DeviceStatus>().0.len()), (DeviceCondition::Live, 1));
}

#[test]
fn a_device_without_what_its_profile_asks_for_is_said_to_be_unsuitable() {
    let other = VirtualDevice { descriptor: vec![0x05, 0x01, 0x09], ..device("a", always(), moving(grasp)) };
    let (mut app, _) = theatre(vec![other], vec![profile()]);
    run_until(&mut app, 1.0);
    assert_eq!(condition(&app), DeviceCondition::Unsuitable);
    assert!(status(&app).advice.contains("calibrate"), "{}", status(&app).advice);
}

#[test]
fn homing_says_what_to_do_and_holds_the_hand_until_it_is_done() {
    let text = PROFILE.replace("hands:", r#"homing: [(flag: (from: Usage(page: 9, usage: 1)), advice: "pull the tool out")], hands:"#);
    let profile = Profile::parse("test", &text).unwrap();
    let feed = moving(|at_s| Held { pedal: at_s > 1.0, ..grasp(at_s) });
    let (mut app, _) = theatre(vec![device("a", always(), feed)], vec![profile]);
    run_until(&mut app, 0.9);
    assert_eq!((condition(&app), status(&app).advice.as_str()), (DeviceCondition::Homing, "pull the tool out"));
    assert!(!hand(&app, Hand::Right).live);
    run_until(&mut app, 1.1);
    assert!(hand(&app, Hand::Right).live);
}

#[test]
fn two_devices_of_one_kind_are_two_hands_and_a_third_is_told_so() {
    let devices = ["a", "b", "c"].map(|name| device(name, always(), moving(grasp))).into();
    let (mut app, _) = theatre(devices, vec![profile()]);
    run_until(&mut app, 1.0);
    let status = &app.world().resource::<DeviceStatus>().0;
    let conditions: Vec<_> = status.iter().map(|d| (d.hands.clone(), d.condition)).collect();
    let expected =
        vec![(vec![Hand::Right], DeviceCondition::Live), (vec![Hand::Left], DeviceCondition::Live), (vec![], DeviceCondition::Unsuitable)];
    assert_eq!(conditions, expected);
}

#[test]
fn hands_that_moved_during_a_pause_take_over_anew() {
    let (mut app, _) = theatre(vec![device("a", always(), moving(grasp))], vec![profile()]);
    run_until(&mut app, 1.0);
    let before = hand(&app, Hand::Right).engaged;
    app.world_mut().resource_mut::<SimulationControl>().paused = true;
    (0..10).for_each(|_| app.update());
    assert_eq!(hand(&app, Hand::Right).engaged, before);
    app.world_mut().resource_mut::<SimulationControl>().paused = false;
    app.update();
    assert_eq!(hand(&app, Hand::Right).engaged, before + 1);
}

#[test]
fn the_force_on_the_tool_is_sent_at_500_hz_limited_and_not_at_all_in_a_fault() {
    let feed = fault(|at_s| grasp(at_s).report()[..5].to_vec());
    let (mut app, bus) = theatre(vec![device("a", always(), feed)], vec![profile()]);
    let instrument = Instrument { kind: InstrumentKind::Grasper, name: "tool".into(), shaft_length_m: 0.33, shaft_radius_m: 0.0025 };
    let port = Port { position: Vec3::ZERO, inward: Vec3::NEG_Z };
    let tip = Vec3::new(0.0, 0.0, -0.1);
    let pose = InstrumentPose { now: Isometry3d::from_translation(tip), before: Isometry3d::from_translation(tip) };
    // 4 N out of the body are sent; the 30 N m of yaw are not.
    let felt = ToolForce { force_n: Vec3::new(-300.0, 0.0, 4.0), at: tip, grip_n: 0.0 };
    app.world_mut().spawn((instrument, Hand::Right, port, pose, felt));
    run_until(&mut app, 4.0);
    let written = bus.written("virtual/a");
    let between = |from: f64, to: f64| written.iter().filter(move |(at, _)| (s(from)..s(to)).contains(at));
    let sent = |report: &[u8]| [1, 3].map(|i| i16::from_le_bytes([report[i], report[i + 1]]));
    let (count, late) = (between(1.0, 2.0).count(), between(2.1, 2.9).count());
    assert!((499..=501).contains(&count) && (399..=401).contains(&late), "{count} {late}");
    assert!(between(1.0, 2.0).all(|(_, report)| sent(report) == [-4000, 2000]));
    assert!(between(2.02, 2.99).all(|(_, report)| sent(report) == [0, 0]), "zero within 20 ms of the fault");
    assert!(between(3.1, 4.0).all(|(_, report)| sent(report) == [-4000, 2000]));
    app.world_mut().resource_mut::<SimulationControl>().paused = true;
    drop(app);
    let (_, last) = bus.written("virtual/a").pop().unwrap();
    assert_eq!(sent(&last), [0, 0], "nothing is felt once the program is over");
}
