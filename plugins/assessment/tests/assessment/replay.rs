//! A small simulation that depends on every input there is, recorded under load, and replayed.

use crate::files::{Shared, header};
use bevy_app::prelude::*;
use bevy_ecs::prelude::*;
use bevy_math::{DVec3, Vec2, Vec3};
use bevy_time::{Fixed, Time, TimePlugin, TimeUpdateStrategy};
use keyhole_assessment::recording::{Event, Play, Player, PlayerSystems, Recorder, Recording, RecordingPlugin, RecordingWriter};
use keyhole_tetmesh::TetMesh;
use keyhole_whiteboard::{
    AxisInput, CutMethod, CutSettings, DeviceHand, DeviceHands, HandInput, Organ, ScriptClock, SenseSystems, SimulationControl,
    TickSystems, TissueMesh, TissueState, WhiteboardPlugin,
};
use std::time::Duration;

const TICK: Duration = Duration::from_nanos(16_666_667);

/// When the scene started, s.
#[derive(Resource, Default)]
struct Started(f64);

fn spawn(world: &mut World) {
    let mesh = TetMesh::new(vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z], &[[0, 1, 2, 3]], &[]);
    let state = TissueState::at_rest(&mesh);
    world.spawn((Organ { name: "toy".into() }, TissueMesh(mesh), state));
    let started = world.resource::<Time<Fixed>>().elapsed_secs_f64();
    world.insert_resource(Started(started));
    world.insert_resource(ScriptClock::default());
}

fn reset(world: &mut World) {
    if std::mem::take(&mut world.resource_mut::<SimulationControl>().reset) {
        let old: Vec<Entity> = world.query_filtered::<Entity, With<Organ>>().iter(world).collect();
        for organ in old {
            world.despawn(organ);
        }
        spawn(world);
    }
}

/// What the hands do, as instruments does it.
fn take_hands(mut mouse: ResMut<HandInput>, mut taken: ResMut<Taken>, control: Res<SimulationControl>, mut script: ResMut<ScriptClock>) {
    taken.0 = mouse.take();
    if control.demonstration {
        script.advance(TICK.as_secs_f64());
    }
}

#[derive(Resource, Default)]
struct Taken(HandInput);

/// A chaotic map of everything from outside.
fn step(
    mut organs: Query<&mut TissueState>,
    taken: Res<Taken>,
    devices: Res<DeviceHands>,
    cutting: Res<CutSettings>,
    control: Res<SimulationControl>,
    script: Res<ScriptClock>,
    time: Res<Time<Fixed>>,
    started: Res<Started>,
) {
    let device = devices.left.map_or(0.0, |d| d.yaw.at.unwrap_or(0.5) + d.engaged as f32);
    let script = if control.demonstration { script.time_s as f32 } else { -1.0 };
    let method = if cutting.method == CutMethod::Hybrid { 0.0 } else { 1.0 };
    let age = (time.elapsed_secs_f64() - started.0) as f32;
    let kick = taken.0.hand_motion.x + 3.0 * device + 0.1 * script + method + age;
    for mut state in &mut organs {
        for (i, p) in state.positions.iter_mut().enumerate() {
            p.x = (3.7 * p.x.fract() * (1.0 - p.x.fract()) + 0.01 * kick * (i + 1) as f32).fract().abs();
        }
        state.velocities[0] = Vec3::splat(kick);
    }
}

fn app() -> App {
    let mut app = App::new();
    app.add_plugins((TimePlugin, WhiteboardPlugin, RecordingPlugin))
        .insert_resource(Time::<Fixed>::from_duration(TICK))
        .init_resource::<Taken>()
        .add_systems(First, reset.after(PlayerSystems))
        .add_systems(FixedFirst, reset.after(PlayerSystems))
        .add_systems(FixedUpdate, take_hands.in_set(SenseSystems::Hands))
        .add_systems(FixedUpdate, step.in_set(TickSystems::Tissue));
    spawn(app.world_mut());
    app.insert_resource(TimeUpdateStrategy::ManualDuration(Duration::ZERO));
    app.update();
    app
}

/// A session of 300 frames of very different length, with everything that a trainee can do. Gives the states after each tick as well.
fn session() -> (Vec<u8>, Vec<TissueState>) {
    let mut app = app();
    let file = Shared::default();
    app.insert_resource(Recorder::new(RecordingWriter::new(file.clone(), &header()).unwrap()));
    let states = std::sync::Arc::new(std::sync::Mutex::new(Vec::new()));
    let seen = states.clone();
    app.add_systems(
        FixedUpdate,
        (move |organs: Query<&TissueState>| seen.lock().unwrap().extend(organs.iter().cloned())).in_set(TickSystems::Publish),
    );
    for frame in 0..300_u64 {
        let world = app.world_mut();
        let mut control = world.resource_mut::<SimulationControl>();
        control.paused = (100..140).contains(&frame);
        control.steps += u32::from(frame == 120);
        control.reset = frame == 60 || frame == 130;
        control.demonstration = (20..90).contains(&frame);
        let hand =
            DeviceHand { live: true, engaged: frame / 50, yaw: AxisInput { at: Some(frame as f32 * 0.01), by: 0.0 }, ..Default::default() };
        world.resource_mut::<DeviceHands>().left = (frame > 30).then_some(hand);
        world.resource_mut::<CutSettings>().method = if frame < 200 { CutMethod::Hybrid } else { CutMethod::Progressive };
        world.resource_mut::<HandInput>().gather(Vec2::new(frame as f32 * 0.37, 1.0), 0.0);
        // From a third of a tick to two ticks and a half.
        let length = TICK.mul_f64(1.0 / 3.0 + (frame * 7 % 13) as f64 / 6.0);
        world.insert_resource(TimeUpdateStrategy::ManualDuration(length));
        app.update();
    }
    app.world_mut().remove_resource::<Recorder>().unwrap().finish().unwrap();
    let bytes = file.0.lock().unwrap().clone();
    let states = states.lock().unwrap().clone();
    (bytes, states)
}

/// Plays to the end, one tick a frame, with the mouse and the devices of somebody who does not belong here.
fn replay(recording: Recording) -> (Play, Vec<TissueState>) {
    let mut app = app();
    app.insert_resource(Player::new(Play::new(recording))).insert_resource(TimeUpdateStrategy::FixedTimesteps(1));
    let mut states = Vec::new();
    loop {
        app.world_mut().resource_mut::<HandInput>().gather(Vec2::new(9.0, 9.0), 4.0);
        app.world_mut().resource_mut::<DeviceHands>().right = Some(DeviceHand::default());
        app.update();
        if app.world().resource::<SimulationControl>().paused {
            break;
        }
        let world = app.world_mut();
        states.extend(world.query::<&TissueState>().iter(world).cloned());
    }
    (app.world_mut().remove_resource::<Player>().unwrap().play, states)
}

#[test]
fn a_replay_of_a_session_with_pauses_restarts_and_stutter_has_the_same_bits_after_every_tick() {
    let (bytes, states) = session();
    let recording = Recording::parse(&bytes).unwrap();
    let resets = recording.events.iter().filter(|e| matches!(e, Event::Reset { .. })).count();
    assert_eq!((resets, recording.ticks()), (2, states.len() as u64));
    let (play, replayed) = replay(recording);
    assert_eq!(replayed, states);
    assert_eq!((play.difference(), play.compared()), (None, states.len() as u64));
}

#[test]
fn the_first_tick_that_differs_is_named() {
    let (bytes, _) = session();
    let mut recording = Recording::parse(&bytes).unwrap();
    let ticks: Vec<usize> = (0..recording.events.len()).filter(|i| matches!(recording.events[*i], Event::Tick { .. })).collect();
    // Somebody tampers with what the mouse did in the 101st tick, and with a mark later on.
    if let Event::Tick { input, .. } = &mut recording.events[ticks[100]] {
        input.mouse.hand_motion.x += 1.0;
    }
    assert_eq!(replay(recording).0.difference().map(|d| d.tick), Some(101));
    let mut recording = Recording::parse(&bytes).unwrap();
    // A difference that the mark of a tick cannot see is seen at the end of its second.
    let (after, digest) = &mut recording.digests[3];
    digest[31] ^= 1;
    let tick = ticks.iter().filter(|i| *i < after).count() as u64;
    assert_eq!(replay(recording).0.difference().map(|d| d.tick), Some(tick));
}

#[test]
fn a_recording_that_breaks_off_is_played_up_to_there() {
    let (bytes, states) = session();
    let part = Recording::parse(&bytes[..bytes.len() * 2 / 3]).unwrap();
    assert!(part.break_off.is_some());
    let ticks = part.ticks() as usize;
    let (play, replayed) = replay(part);
    assert!(ticks > 100 && ticks < states.len());
    assert_eq!(replayed, states[..ticks]);
    assert_eq!(play.difference(), None);
}
