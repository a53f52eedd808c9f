//! What a scene does not require does not run and allocates nothing; organs that sleep cost nothing.
//!
//! Whose a system or a component is, is found by [`Census`], not read from the plugins' promises. The second way is the heap: with a module that is not required
//! there, a tick allocates as often and as much as without its plugin, and ends in the same bits.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

#[path = "common/heap.rs"]
mod heap;

use bevy::ecs::schedule::SingleThreadedExecutor;
use bevy::prelude::*;
use heap::{BYTES, CALLS, LIVE};
use keyhole::census::Census;
use keyhole::modules::Module;
use keyhole::report::digest::digest;
use keyhole::simulation::{faults, simulation_of};
use keyhole::spawn::clear;
use keyhole::{Settings, Theatre, simulation};
use keyhole_assessment::Assessment;
use keyhole_collision::CollisionReport;
use keyhole_tissue::TissueReport;
use keyhole_whiteboard::{Contacts, FragmentDetached, SceneRequirements};
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::atomic::Ordering;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Tests share the heap's counters: one at a time.
static TURN: Mutex<()> = Mutex::new(());

fn turn() -> MutexGuard<'static, ()> {
    TURN.lock().unwrap_or_else(PoisonError::into_inner)
}

const MATERIAL: &str = "materials: [(name: \"kidney\", young_modulus_pa: 14700.0, poisson_ratio: 0.45, density_kg_m3: 1050.0, inside: (0.5, 0.1, 0.1), surface: (0.5, 0.1, 0.1))]";

/// A theatre that is said in a line.
fn said(fields: &str) -> Theatre {
    let text = format!("(version: 1, name: \"said\", {fields})").replace("MATERIAL", MATERIAL);
    Theatre::of(keyhole_scene::parse(&text).unwrap(), Path::new("said")).unwrap()
}

fn theatres() -> Vec<(String, Theatre)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    let mut files: Vec<_> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    files.retain(|f| f.to_string_lossy().ends_with(".scene.ron"));
    files.sort();
    let mut all: Vec<(String, Theatre)> = files.iter().map(|f| (f.display().to_string(), Theatre::load(f).unwrap())).collect();
    assert!(all.len() > 3, "the scenes are there");
    let block = "organs: [(name: \"a\", MATERIAL, shape: Block(size: (0.04, 0.02, 0.02), cells: (6, 3, 3)))]";
    let scope = "ports: [(name: \"p\", position: (0, 0.1, 0.1), inward: (0, -1, -1))], endoscope: (port: \"p\")";
    all.push(("nothing".into(), said("organs: []")));
    all.push(("a block".into(), said(block)));
    all.push(("a block and an endoscope".into(), said(&format!("{block}, {scope}"))));
    all
}

fn app(theatre: &Theatre, modules: &[Module]) -> App {
    simulation_of(theatre.clone(), Settings { demonstration: true, ..Settings::default() }, modules.iter().copied())
}

fn is_required(app: &App, module: Module) -> bool {
    module.is_required(*app.world().resource::<SceneRequirements>())
}

#[test]
fn a_module_that_is_not_required_does_not_run_and_has_nothing() {
    let _turn = turn();
    let census = Census::new();
    assert!(Module::ALL.iter().all(|m| census.systems(*m) > 0), "each module has systems");
    let (mut idle, mut busy) = (BTreeSet::new(), BTreeSet::new());
    for (name, theatre) in theatres() {
        let mut app = app(&theatre, &Module::ALL);
        for tick in 1..=10 {
            let before = census.last_runs(&mut app);
            app.update();
            let runs = census.last_runs(&mut app).runs_since(&before);
            for (module, runs) in &runs {
                let wanted = is_required(&app, *module);
                assert_eq!(*runs > 0, wanted, "{name}: {runs} systems of {} ran in tick {tick}", module.name());
                if wanted {
                    busy.insert(*module)
                } else {
                    idle.insert(*module)
                };
            }
        }
        for (module, has) in census.holdings(&app) {
            if !is_required(&app, module) {
                assert_eq!((has.entities, has.bytes), (0, 0), "{name}: {} has something on entities", module.name());
                assert!(has.resource_bytes < 1024, "{name}: settings and empty lists of {}: {has:?}", module.name());
            }
        }
    }
    // Nothing was shown of a module that every scene requires, or none.
    assert_eq!(idle.len(), Module::ALL.len(), "{idle:?}");
    assert_eq!(busy.len(), Module::ALL.len(), "{busy:?}");
    assert_eq!(faults(), 0);
}

/// What `ticks` ticks allocate, and the digest after them.
fn allocated(mut app: App, ticks: u32) -> (u64, u64, String) {
    // In one order, so that what the engine itself allocates is always the same.
    let labels: Vec<_> = app.world().resource::<Schedules>().iter().map(|(_, schedule)| schedule.label()).collect();
    for label in labels {
        app.edit_schedule(label, |schedule| {
            schedule.set_executor(SingleThreadedExecutor::new());
        });
    }
    (0..5).for_each(|_| app.update());
    let before = (CALLS.load(Ordering::Relaxed), BYTES.load(Ordering::Relaxed));
    (0..ticks).for_each(|_| app.update());
    let after = (CALLS.load(Ordering::Relaxed), BYTES.load(Ordering::Relaxed));
    (after.0 - before.0, after.1 - before.1, digest(app.world_mut()))
}

#[test]
fn a_tick_allocates_as_much_as_without_the_modules_that_are_not_required() {
    let _turn = turn();
    for (name, theatre) in theatres() {
        let requirements = theatre.scene.requirements();
        let required: Vec<Module> = Module::ALL.into_iter().filter(|m| m.is_required(requirements)).collect();
        if required.len() < Module::ALL.len() {
            // On one thread, so that what the pool itself allocates is always the same.
            let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
            let [with, without] = one.install(|| [&Module::ALL[..], &required].map(|modules| allocated(app(&theatre, modules), 10)));
            println!("{name}: {with:?}, {without:?}");
            assert_eq!(with, without, "{name}: with the plugins of all modules, and of {required:?} alone");
        }
    }
}

#[test]
fn news_of_a_fragment_is_not_kept_by_who_is_not_required() {
    let _turn = turn();
    let theatre = said("organs: [(name: \"a\", MATERIAL, shape: Block(size: (0.04, 0.02, 0.02), cells: (2, 1, 1)))]");
    let mut app = app(&theatre, &Module::ALL);
    let mut live = Vec::new();
    for _ in 0..30 {
        let [entity, donor] = [(); 2].map(|()| app.world_mut().spawn_empty().id());
        app.world_mut().trigger(FragmentDetached { entity, donor, donor_nodes: vec![keyhole_tetmesh::NodeId(0); 10_000] });
        app.world_mut().despawn(entity);
        app.world_mut().despawn(donor);
        app.update();
        live.push(LIVE.load(Ordering::Relaxed));
    }
    // A list of 10 000 nodes has 40 kB.
    assert!((live[29] - live[9]).abs() < 40_000, "{live:?}");
}

/// What was measured of a scene is let go of with it: the next one may not be measured at all.
#[test]
fn a_scene_that_is_taken_off_leaves_nothing_behind() {
    let _turn = turn();
    let mut app = app(&theatres().remove(0).1, &Module::ALL);
    (0..3).for_each(|_| app.update());
    assert!(!app.world().resource::<Assessment>().figures().is_empty());
    clear(app.world_mut());
    assert!(app.world().resource::<Assessment>().figures().is_empty());
    let left: usize = Census::new().holdings(&app).values().map(|has| has.entities).sum();
    assert_eq!(left, 0);
}

/// Two blocks hang side by side without weight above a bed that one of them touches, and a tool moves far from them.
#[test]
fn organs_that_sleep_are_neither_solved_nor_looked_at() {
    let _turn = turn();
    let organ = |name: &str, x: f32| {
        let hold = format!("attachments: [(region: HalfSpace(point: ({}, 0, 0), normal: (-1, 0, 0)))]", x - 0.0199);
        format!(
            "(name: \"{name}\", MATERIAL, shape: Block(size: (0.04, 0.02, 0.02), cells: (8, 4, 4)), transform: (translation: ({x}, 0, 0)), {hold})"
        )
    };
    let bed = "anatomy: [(name: \"bed\", shape: Box(size: (0.1, 0.02, 0.1)), colour: (1, 1, 1), transform: (translation: (0, -0.01999, 0)), solid: true)]";
    let keys = (0..40).map(|i| format!("(time_s: {}, tip: ({}, 0.2, 0))", 0.1 * f64::from(i), 0.03 * f64::from(i % 2))).collect::<Vec<_>>();
    let tool = format!(
        "ports: [(name: \"p\", position: (0, 0.3, 0), inward: (0, -1, 0))], instruments: [(kind: Grasper, hand: Left, port: \"p\")], \
         demonstration: (seconds: 4, hands: [(hand: Left, keys: [{}])])",
        keys.join(", ")
    );
    let theatre = said(&format!("gravity: (0, 0, 0), organs: [{}, {}], {bed}, {tool}", organ("a", 0.0), organ("b", 0.07)));
    let mut app = app(&theatre, &Module::ALL);
    let work = |app: &App| (*app.world().resource::<CollisionReport>(), app.world().resource::<TissueReport>().clone());
    (0..90).for_each(|_| app.update());
    let (before, solved) = work(&app);
    assert!(before.nodes > 0 && before.faces > 0 && solved.stepped >= 60, "{before:?} {solved:?}");
    let world = app.world_mut();
    let touching: usize = world.query::<&Contacts>().iter(world).map(|c| c.0.len()).sum();
    assert!(touching > 0, "a block lies on the bed");
    (0..60).for_each(|_| app.update());
    let (after, still_solved) = work(&app);
    assert_eq!(
        (still_solved.stepped, still_solved.iterations, still_solved.asleep),
        (solved.stepped, solved.iterations, solved.asleep + 120)
    );
    assert_eq!(after, CollisionReport { at_rest: before.at_rest + 120, ..before });
    let world = app.world_mut();
    assert_eq!(world.query::<&Contacts>().iter(world).map(|c| c.0.len()).sum::<usize>(), touching, "what it touches is still known");
    assert_eq!(simulation(theatre, Settings::default()).world().resource::<TissueReport>().stepped, 0);
}
