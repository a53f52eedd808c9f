//! Whatever a device or a file says: no panic, no hang, and nothing on the whiteboard that is not finite.

use crate::common::*;
use keyhole_hid::shipped::{SHIPPED, shipped};
use keyhole_hid::virtual_bus::Feed;
use keyhole_hid::{DescriptorError, HandReading, Layout, Mapping, Profile, VirtualDevice};
use keyhole_whiteboard::{AxisInput, DeviceHands};
use proptest::prelude::*;
use std::time::Duration;

/// Items of a descriptor that mean something, in any order, with any data.
fn items() -> impl Strategy<Value = Vec<u8>> {
    let tags =
        vec![0x04u8, 0x14, 0x24, 0x34, 0x44, 0x54, 0x64, 0x74, 0x84, 0x94, 0xa4, 0xb4, 0x08, 0x18, 0x28, 0x80, 0x90, 0xb0, 0xa0, 0xc0];
    let small = prop_oneof![3 => 0u32..40, 1 => any::<u32>()];
    let item = (prop::sample::select(tags), 0u8..4, small).prop_map(|(tag, size, data)| {
        let bytes = [0, 1, 2, 4][usize::from(size)];
        [&[tag | size][..], &data.to_le_bytes()[..bytes]].concat()
    });
    prop::collection::vec(item, 0..60).prop_map(|items| items.concat())
}

fn mutated(mut bytes: Vec<u8>, changes: &[(prop::sample::Index, u8)]) -> Vec<u8> {
    for (at, value) in changes {
        let at = at.index(bytes.len().max(1));
        if let Some(byte) = bytes.get_mut(at) {
            *byte = *value;
        }
    }
    bytes
}

fn finite(reading: &HandReading) -> bool {
    reading.at.iter().flatten().chain(&reading.moved).chain(&reading.grip).all(|v| v.is_finite())
}

/// A device with one of everything that the shipped profiles ask for by usage.
fn everything() -> Vec<u8> {
    let mut wire = wire();
    let axis = wire.fields[0];
    for usage in [0x30, 0x31, 0x32, 0x33, 0x34, 0x35, 0x36, 0x39] {
        wire.fields.push(keyhole_hid::WireField { usage: (1, usage), ..axis });
    }
    for usage in 2..=12 {
        wire.fields.push(keyhole_hid::WireField { usage: (9, usage), bits: 1, least: 0, most: 1 });
    }
    wire.descriptor()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn descriptors(bytes in prop_oneof![prop::collection::vec(any::<u8>(), 0..200), items()], report in prop::collection::vec(any::<u8>(), 0..40)) {
        if let Ok(layout) = Layout::read(&bytes) {
            let _ = layout.admits(&report);
            for control in &layout.controls {
                let _ = control.field.read(&report);
            }
        }
    }

    #[test]
    fn damaged_descriptors_and_any_reports(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
        reports in prop::collection::vec((0u64..50, prop::collection::vec(any::<u8>(), 0..48)), 0..40),
    ) {
        let descriptor = mutated(everything(), &changes);
        for profile in shipped().unwrap() {
            let Ok(mut mapping) = Mapping::fit(&profile, &descriptor) else { continue };
            let mut now = Duration::ZERO;
            for (wait, report) in &reports {
                now += Duration::from_millis(*wait);
                let _ = mapping.take(now, report);
                prop_assert!(finite(&mapping.reading(0)) && finite(&mapping.reading(1)));
            }
        }
    }

    #[test]
    fn profiles(text in "\\PC{0,200}", which in 0..SHIPPED.len(), changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4)) {
        let _ = Profile::parse("fuzz", &text);
        let damaged = String::from_utf8_lossy(&mutated(SHIPPED[which].1.into(), &changes)).into_owned();
        if let Ok(profile) = Profile::parse("fuzz", &damaged)
            && let Ok(mut mapping) = Mapping::fit(&profile, &everything())
        {
            for ms in 0..20u8 {
                let report: Vec<u8> = (0..64).map(|i: u8| i.wrapping_mul(ms)).collect();
                let _ = mapping.take(Duration::from_millis(ms.into()), &report);
                prop_assert!(finite(&mapping.reading(0)) && finite(&mapping.reading(1)));
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn a_device_that_sends_anything_at_any_time(
        reports in prop::collection::vec((0u64..30_000, prop_oneof![
            prop::collection::vec(any::<u8>(), 0..20),
            (any::<[u16; 5]>(), any::<bool>()).prop_map(|(v, pedal)| {
                wire().report(&[v[0].into(), v[1].into(), v[2].into(), v[3].into(), v[4].into(), pedal.into()])
            }),
        ]), 0..200),
        out in 0u64..2000,
    ) {
        let mut at = Duration::ZERO;
        let timed: Vec<_> = reports.into_iter().map(|(us, report)| { at += Duration::from_micros(us); (at, report) }).collect();
        let feed: Feed = Box::new(timed.into_iter());
        let out = Duration::from_millis(out);
        let plugged = vec![Duration::ZERO..out, out + Duration::from_millis(300)..Duration::MAX];
        let (mut app, _) = theatre(vec![VirtualDevice { ..device("a", plugged, feed) }], vec![profile()]);
        while now_s(&app) < 3.0 {
            app.update();
            let DeviceHands { left, right } = *app.world().resource::<DeviceHands>();
            let axis = |a: AxisInput| a.by.is_finite() && a.at.is_none_or(f32::is_finite);
            for hand in [left, right].iter().flatten() {
                prop_assert!([hand.yaw, hand.pitch, hand.insertion, hand.roll].into_iter().all(axis) && hand.grip.is_none_or(f32::is_finite));
                prop_assert!(hand.live || !hand.pedal);
            }
        }
    }
}

#[test]
fn descriptors_that_ask_for_too_much_are_refused_before_they_get_it() {
    // Four thousand million fields; as many usages; a usage without a page; a pop without a push; a collection for ever deeper.
    let bombs: [&[u8]; 5] = [
        &[0x05, 1, 0x09, 0x30, 0x75, 1, 0x97, 0xff, 0xff, 0xff, 0xff, 0x81, 2],
        &[0x05, 1, 0x19, 0, 0x2b, 0xff, 0xff, 0xff, 0xff, 0x75, 1, 0x95, 1, 0x81, 0],
        &[0x09, 0x30, 0x75, 8, 0x95, 1, 0x81, 2],
        &[0xb4, 0xb4],
        &[0xa1; 4096],
    ];
    for bomb in bombs {
        assert!(matches!(Layout::read(bomb), Err(DescriptorError::Item { .. })), "{bomb:02x?}");
    }
    assert!(matches!(Layout::read(&[0; 5000]), Err(DescriptorError::Length { .. })));
    assert!(Profile::parse("deep", &"(".repeat(60_000)).is_err());
}
