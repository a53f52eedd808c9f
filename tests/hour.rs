//! What is played for long takes no more memory than what is played for a while: recorded, measured, reported.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

#[path = "common/heap.rs"]
mod heap;

use bevy::prelude::*;
use heap::{BYTES, CALLS, LIVE};
use keyhole::recording::header;
use keyhole::report::Recorder as Reporter;
use keyhole::{Settings, Theatre, simulation};
use keyhole_assessment::recording::{Recorder, RecordingWriter};
use keyhole_whiteboard::{Hand, HandInput, SimulationControl};
use std::path::Path;
use std::sync::atomic::Ordering;
use std::sync::{Mutex, PoisonError};

/// Tests share the heap: one at a time.
static TURN: Mutex<()> = Mutex::new(());

/// Plays the peg board with a recording into a file and a report; `before` is called before each tick. Gives the bytes that are in use after each of `looks`
/// spans of `ticks` ticks.
fn played(demonstration: bool, looks: usize, ticks: u64, mut before: impl FnMut(u64, &mut World)) -> Vec<isize> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/peg_transfer.scene.ron");
    let folder = tempfile::tempdir().unwrap();
    let theatre = Theatre::load(&path).unwrap();
    let head = header(&path, &theatre).unwrap();
    let mut app = simulation(theatre, Settings { demonstration, ..Settings::default() });
    app.insert_resource(Recorder::new(RecordingWriter::create(&folder.path().join("a.recording"), &head).unwrap()));
    let mut reporter = Reporter::new(app.world_mut());
    let mut live = Vec::with_capacity(looks);
    for tick in 0..looks as u64 * ticks {
        before(tick, app.world_mut());
        app.update();
        reporter.record(app.world_mut());
        if (tick + 1).is_multiple_of(ticks) {
            live.push(LIVE.load(Ordering::Relaxed));
        }
    }
    assert!(CALLS.load(Ordering::Relaxed) > 0 && BYTES.load(Ordering::Relaxed) > 0);
    live
}

/// What is more in use after the last look than after the `from`th, bytes a look.
fn growth(live: &[isize], from: usize) -> f64 {
    (live[live.len() - 1] - live[from]) as f64 / (live.len() - 1 - from) as f64
}

/// Hands that never stand still over one scene.
#[test]
fn a_long_session_grows_no_larger() {
    let _turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
    let live = played(false, 6, 600, |tick, world| {
        let mut input = world.resource_mut::<HandInput>();
        input.active = if tick / 240 % 2 == 0 { Hand::Right } else { Hand::Left };
        let turn = std::f32::consts::TAU * (tick % 120) as f32 / 120.0;
        input.hand_motion = Vec2::new(turn.cos(), turn.sin()) * 3.0;
        input.squeezed = tick / 60 % 2 == 1;
    });
    let a_tick = growth(&live, 1) / 600.0;
    assert!(a_tick < 1.0, "{a_tick:.2} bytes a tick, where a byte of each is the least that could be kept: {live:?}");
}

/// The scene begun again and again. (What its entities were called is not used again: some twenty bytes each.)
#[test]
fn many_sessions_take_no_more_than_one() {
    let _turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
    let live = played(true, 10, 120, |tick, world| {
        world.resource_mut::<SimulationControl>().reset = tick.is_multiple_of(120);
    });
    let (a_session, whole) = (growth(&live, 4), live[4] as f64);
    assert!(a_session < 1e-3 * whole, "{a_session:.0} bytes a session: {live:?}");
}
