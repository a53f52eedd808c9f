//! Recordings as files: whole, cut off, spoilt, of another version.

use bevy_math::Vec2;
use keyhole_assessment::recording::{
    Event, FORMAT, Header, Recording, RecordingError, RecordingWriter, SceneIdentity, StateDigest, TickInput, state_digest,
};
use keyhole_whiteboard::{AxisInput, CutMethod, CutPattern, CutSettings, DeviceHand, DeviceHands, Hand, HandInput, Moved};
use proptest::prelude::*;
use std::io::Write;
use std::sync::{Arc, Mutex};

/// A file in memory that can be looked at while it is written.
#[derive(Clone, Default)]
pub struct Shared(pub Arc<Mutex<Vec<u8>>>);

impl Write for Shared {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().unwrap().extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

pub fn header() -> Header {
    let scene = SceneIdentity { name: "kidney".into(), files: vec![("kidney.ron".into(), [7; 32])] };
    // Five ticks a second: short blocks.
    Header { scene, tick_ns: 200_000_000, seeds: vec![("tremor".into(), 5)] }
}

fn digest_of(tick: usize) -> StateDigest {
    let pose = bevy_math::Isometry3d::from_translation(bevy_math::Vec3::X * tick as f32);
    state_digest(std::iter::empty(), std::iter::once((Hand::Left, pose)))
}

fn axis() -> impl Strategy<Value = AxisInput> {
    (any::<Option<f32>>(), any::<f32>()).prop_map(|(at, by)| AxisInput { at, by })
}

fn device() -> impl Strategy<Value = Option<DeviceHand>> {
    let hand = (any::<bool>(), any::<u64>(), [axis(), axis(), axis(), axis()], any::<Option<f32>>(), any::<bool>());
    proptest::option::of(hand.prop_map(|(live, engaged, [yaw, pitch, insertion, roll], grip, pedal)| DeviceHand {
        live,
        engaged,
        yaw,
        pitch,
        insertion,
        roll,
        grip,
        pedal,
    }))
}

fn mouse() -> impl Strategy<Value = HandInput> {
    let moved = prop_oneof![Just(Moved::Hand), Just(Moved::Endoscope), Just(Moved::EndoscopeRoll)];
    (any::<[bool; 3]>(), moved, any::<[f32; 8]>()).prop_map(|([right, squeezed, exchange], moved, x)| HandInput {
        active: if right { Hand::Right } else { Hand::Left },
        moved,
        hand_motion: Vec2::new(x[0], x[1]),
        hand_notches: x[2],
        scope_motion: Vec2::new(x[3], x[4]),
        scope_notches: x[5],
        scope_roll_notches: x[6],
        roll: x[7],
        squeezed,
        exchange,
    })
}

fn cutting() -> impl Strategy<Value = CutSettings> {
    let method = prop_oneof![Just(CutMethod::Hybrid), Just(CutMethod::Progressive), Just(CutMethod::NonProgressive)];
    let pattern = || prop_oneof![Just(CutPattern::Minimal), Just(CutPattern::Symmetric)];
    (method, pattern(), pattern(), any::<f64>()).prop_map(|(method, hull, core, snap)| CutSettings { method, hull, core, snap })
}

fn event() -> impl Strategy<Value = Event> {
    let tick = (any::<u64>(), any::<Option<u64>>(), mouse(), [device(), device()], cutting()).prop_map(
        |(clock, demonstration, mouse, [left, right], cutting)| Event::Tick {
            input: TickInput { clock, demonstration, mouse, devices: DeviceHands { left, right }, cutting },
            mark: 0,
        },
    );
    prop_oneof![8 => tick, 1 => any::<u64>().prop_map(|clock| Event::Reset { clock })]
}

/// The bytes of a recording of events, ended or dropped by a program that was killed; the marks are filled in.
fn recorded(events: &mut [Event], ended: bool) -> Vec<u8> {
    let file = Shared::default();
    let mut writer = RecordingWriter::new(file.clone(), &header()).unwrap();
    for (i, event) in events.iter_mut().enumerate() {
        match event {
            Event::Tick { input, mark } => {
                *mark = digest_of(i).mark();
                writer.tick(input, digest_of(i)).unwrap();
            }
            Event::Reset { clock } => writer.reset(*clock).unwrap(),
        }
    }
    if ended {
        writer.finish().unwrap();
    } else {
        std::mem::forget(writer);
    }
    file.0.lock().unwrap().clone()
}

/// All numbers as bits: NaN is a number like others here.
fn text(events: &[Event]) -> String {
    format!("{events:?}")
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    #[test]
    fn a_recording_cut_off_at_any_byte_is_played_up_to_its_last_whole_block(mut events in proptest::collection::vec(event(), 0..24)) {
        let bytes = recorded(&mut events, true);
        let whole = Recording::parse(&bytes).unwrap();
        prop_assert_eq!(&whole.break_off, &None);
        prop_assert_eq!(&whole.header, &header());
        prop_assert_eq!(text(&whole.events), text(&events));
        let mut longest = 0;
        for length in 0..bytes.len() {
            match Recording::parse(&bytes[..length]) {
                Ok(part) => {
                    prop_assert!(part.break_off.is_some());
                    prop_assert_eq!(text(&part.events), text(&events[..part.events.len()]));
                    prop_assert!(part.events.len() >= longest && part.events.len().is_multiple_of(5) || part.events.len() == events.len());
                    prop_assert_eq!(&whole.digests[..part.digests.len()], &part.digests[..]);
                    longest = part.events.len();
                }
                Err(RecordingError::NoRecording) => prop_assert_eq!(length, 0),
                Err(error) => prop_assert!(matches!(error, RecordingError::NoHeader { .. }) && longest == 0, "{}", error),
            }
        }
        prop_assert_eq!(longest, events.len(), "only the end mark is missing");
    }

    #[test]
    fn a_killed_program_loses_less_than_a_second(mut events in proptest::collection::vec(event(), 0..24)) {
        let bytes = recorded(&mut events, false);
        let played = Recording::parse(&bytes).unwrap();
        prop_assert!(events.len() - played.events.len() < 5);
        prop_assert_eq!(text(&played.events), text(&events[..played.events.len()]));
    }

    #[test]
    fn a_byte_that_was_changed_is_never_played(mut events in proptest::collection::vec(event(), 6..12), at in any::<prop::sample::Index>(), bit in 0..8_u8) {
        let mut bytes = recorded(&mut events, true);
        let at = at.index(bytes.len());
        bytes[at] ^= 1 << bit;
        if let Ok(part) = Recording::parse(&bytes) {
            prop_assert!(part.break_off.is_some());
            prop_assert_eq!(text(&part.events), text(&events[..part.events.len()]));
        }
    }

    #[test]
    fn no_bytes_make_the_reader_fail_otherwise_than_by_an_error(noise in proptest::collection::vec(any::<u8>(), 0..400), whole_start in any::<bool>()) {
        let mut bytes = if whole_start { recorded(&mut [], false) } else { Vec::new() };
        bytes.extend(noise);
        drop(Recording::parse(&bytes));
    }
}

#[test]
fn another_version_is_refused_by_name() {
    let bytes = recorded(&mut [], true);
    let mut other = b"keyhole\0".to_vec();
    other.extend_from_slice(&9_u32.to_le_bytes());
    other.extend_from_slice(b"\x0a2.7.0-rc.1and whatever that version writes");
    let error = Recording::parse(&other).unwrap_err().to_string();
    assert!(error.contains("Keyhole 2.7.0-rc.1 (format 9)") && error.contains(env!("CARGO_PKG_VERSION")), "{error}");
    // The version of the program alone.
    let mut newer = bytes.clone();
    newer[13] += 1;
    assert!(matches!(Recording::parse(&newer), Err(RecordingError::OtherVersion { format: FORMAT, .. })));
    assert!(matches!(Recording::parse(b"RIFF"), Err(RecordingError::NoRecording)));
}

#[test]
fn a_file_that_is_there_is_not_touched() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.recording");
    std::fs::write(&path, "precious").unwrap();
    assert!(matches!(RecordingWriter::create(&path, &header()), Err(RecordingError::File { .. })));
    assert_eq!(std::fs::read(&path).unwrap(), b"precious");
    let new = folder.path().join("b.recording");
    drop(RecordingWriter::create(&new, &header()).unwrap());
    assert_eq!(Recording::read(&new).unwrap().break_off, None);
}
