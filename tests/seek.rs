//! Going back and forth in a recording: whatever the way, every later tick leaves the bits that were recorded.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

use bevy::prelude::*;
use keyhole::recording::{header, read};
use keyhole::seek::{MOST_KEPT, Timeline};
use keyhole::{Settings, Theatre, simulation};
use keyhole_assessment::recording::{Play, Player, Recorder, Recording, RecordingWriter};
use keyhole_whiteboard::{ClipReport, CutStatus, GraspReport, SimulationControl, StateRegistry, SutureReport, TickCost};
use std::any::TypeId;
use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// Ticks between two checkpoints.
const SPACING: u64 = 50;

fn scene(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes").join(format!("{name}.scene.ron"))
}

/// The first ticks of a demonstration; at `restart` the scene is started over.
fn record(scene: &Path, ticks: u64, restart: Option<u64>) -> Recording {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.recording");
    let theatre = Theatre::load(scene).unwrap();
    let mut app = simulation(theatre.clone(), Settings { demonstration: true, ..Settings::default() });
    app.insert_resource(Recorder::new(RecordingWriter::create(&file, &header(scene, &theatre).unwrap()).unwrap()));
    for tick in 0..ticks {
        app.world_mut().resource_mut::<SimulationControl>().reset = restart == Some(tick);
        app.update();
    }
    app.world_mut().remove_resource::<Recorder>().unwrap().finish().unwrap();
    let recording = read(&file, scene, &theatre).unwrap();
    assert_eq!(recording.ticks(), ticks);
    recording
}

fn replay(scene: &Path, recording: Recording) -> App {
    let mut app = simulation(Theatre::load(scene).unwrap(), Settings::default());
    app.insert_resource(Player::new(Play::new(recording))).init_resource::<Timeline>();
    app.world_mut().resource_mut::<Timeline>().spacing_ticks = SPACING;
    app
}

fn play(app: &App) -> &Play {
    &app.world().resource::<Player>().play
}

/// Goes to a time and gives where it is then: there, or up to a tick later.
fn go_to(app: &mut App, ticks: u64) -> u64 {
    let (control, finished) = (*app.world().resource::<SimulationControl>(), play(app).finished());
    app.world_mut().resource_mut::<Timeline>().go_to(ticks, &control, finished);
    loop {
        app.update();
        if app.world().resource::<Timeline>().wanted().is_none() {
            break;
        }
    }
    assert!(play(app).difference().is_none(), "{:?} on the way to {ticks}", play(app).difference());
    play(app).ticks()
}

fn run_on(app: &mut App, ticks: u64) {
    (0..ticks).for_each(|_| app.update());
    assert!(play(app).difference().is_none(), "{:?}", play(app).difference());
}

/// What of a scene's own is counted.
fn counts(app: &App) -> (CutStatus, ClipReport, u32, Option<u64>) {
    let world = app.world();
    let suturing = world.get_resource::<SutureReport>().map(|r| r.torn);
    let bruised = world.get_resource::<GraspReport>().map_or(0, |r| r.bruised_m2.to_bits());
    (world.resource::<CutStatus>().clone(), *world.resource::<ClipReport>(), bruised, suturing)
}

/// Plays a recording to its end, then goes to times in a fixed disorder, back and forth, and runs on a little from each. Where the scene is not started over
/// meanwhile, no way is longer than between two checkpoints.
fn back_and_forth(name: &str, ticks: u64, restart: Option<u64>, shows: impl Fn(&CutStatus, &ClipReport)) {
    let scene = scene(name);
    let mut app = replay(&scene, record(&scene, ticks, restart));
    run_on(&mut app, ticks + 1);
    assert!(play(&app).finished() && play(&app).compared() == ticks);
    shows(app.world().resource::<CutStatus>(), app.world().resource::<ClipReport>());
    let end = counts(&app);
    assert!(app.world().resource::<Timeline>().kept().len() <= MOST_KEPT);
    let mut spread = 0.5_f64;
    for _ in 0..4 {
        spread = (spread + 0.618_034).fract();
        let (wanted, before) = ((spread * ticks as f64) as u64, play(&app).compared());
        let there = go_to(&mut app, wanted);
        assert!((wanted..=wanted + 1).contains(&there), "{there} instead of {wanted}");
        assert!(restart.is_some() || play(&app).compared() - before <= SPACING + 1, "it goes on from a checkpoint");
        run_on(&mut app, 25.min(ticks - there));
    }
    go_to(&mut app, ticks);
    assert_eq!(counts(&app), end);
}

#[test]
fn with_clips() {
    back_and_forth("clip_and_cut", 640, None, |_, clips| assert!(clips.set > 1));
}

#[test]
fn with_a_restart() {
    back_and_forth("peg_transfer", 300, Some(140), |_, _| {});
}

#[test]
fn with_a_cut_and_a_piece_that_comes_free() {
    back_and_forth("pattern_cut", 600, None, |cut, _| assert!(cut.fragments > 0));
}

#[test]
fn with_needle_and_thread() {
    back_and_forth("stitch", 300, None, |_, _| {});
}

/// Every component and every resource of the house that an app has been said of whether it is state, by its room or here: what would be forgotten fails.
#[test]
fn nothing_of_the_state_is_forgotten() {
    use keyhole_whiteboard as board;
    let mut known: HashSet<TypeId> = HashSet::new();
    macro_rules! stays {
        ($($kind:ty),* $(,)?) => { $(known.insert(TypeId::of::<$kind>());)* };
    }
    // Scenery, what organs and instruments are made of, settings, and what comes from outside, which a recording has.
    stays!(board::Anatomy, board::StaticSurface, board::SurfaceFriction, board::Port, board::Hand, board::ScopeOptics);
    stays!(board::PinchLimit, board::TearResistance, board::Vessel, keyhole_instruments::TrocarLimits);
    stays!(board::Gravity, board::SceneRequirements, board::RigidFragments, board::GlobalView, board::KeyMap, board::ViewMode);
    stays!(board::CutSettings, board::HandInput, board::DeviceHands, board::DeviceStatus, board::PointerClaims, SimulationControl);
    stays!(keyhole_tissue::TissueSettings, keyhole_collision::CollisionSettings, keyhole_grasping::GraspSettings);
    stays!(keyhole_clipping::ClipSettings, keyhole_rigid::RigidSettings, keyhole_suturing::SutureSettings);
    stays!(keyhole_instruments::HandSettings, keyhole_instruments::ProxySettings, keyhole_instruments::exchange::ExchangeSettings);
    stays!(keyhole_instruments::Script, keyhole_assessment::Task, keyhole_assessment::AssessmentSettings);
    stays!(Player, Timeline, Theatre, StateRegistry, board::SimulationIds);
    // Read in the tick in which they are written.
    stays!(Messages<board::TopologyChanged>, Messages<board::ToolTouched>);

    let mut seen = 0;
    for name in ["clip_and_cut", "peg_transfer", "stitch"] {
        let mut app = simulation(Theatre::load(&scene(name)).unwrap(), Settings { demonstration: true, ..Settings::default() });
        (0..60).for_each(|_| app.update());
        let world = app.world();
        let registry = world.resource::<StateRegistry>();
        for id in world.archetypes().iter().flat_map(|archetype| archetype.components()) {
            let info = world.components().get_info(*id).unwrap();
            let Some(kind) = info.type_id().filter(|_| info.name().to_string().contains("keyhole")) else { continue };
            seen += 1;
            assert!(
                registry.knows(kind) || known.contains(&kind),
                "{name}: {} is neither state nor said to be none: register it with `StateOf` in its plugin",
                info.name()
            );
        }
        assert!(registry.knows(TypeId::of::<TickCost>()));
    }
    assert!(seen > 100, "{seen}");
}
