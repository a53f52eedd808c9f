//! One case of `keyhole study scaling`, measured in a process of its own: the most memory that a process has ever had is that case's alone.

use crate::census::Census;
use crate::modules::Module;
use crate::report::cost::{Cost, Costs};
use crate::simulation::{Settings, TICKS_PER_SECOND, faults, simulation};
use crate::theatre::{Theatre, TheatreError};
use bevy::prelude::*;
use keyhole_collision::CollisionReport;
use keyhole_tissue::{TissueBody, TissueReport};
use keyhole_whiteboard::{Contacts, GestureSystems, SceneRequirements, TickCost, TickSystems, TissueMesh};
use serde::{Deserialize, Serialize};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// What is measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Subject {
    /// No organ, no instrument: the program alone.
    Nothing,
    /// A block of 60 mm of about so many tetrahedra, held at one side, that hangs, is pressed by a grasper and cut into by a scalpel.
    Block {
        /// Tetrahedra asked for.
        tets: usize,
    },
    /// Blocks of 40 mm side by side, each held at one side.
    Organs {
        /// How many.
        count: usize,
        /// Tetrahedra asked for, each.
        tets: usize,
        /// Without weight, so that they sleep; else they swing.
        asleep: bool,
    },
    /// A scene's demonstration.
    Scene {
        /// Its file.
        path: PathBuf,
    },
}

/// A case.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Case {
    /// What is measured.
    pub subject: Subject,
    /// A module that is required although the scene does not ask for it, or the other way round.
    pub toggled: Option<Module>,
    /// Ticks before anything is measured.
    pub warm_ticks: u64,
    /// Ticks that are measured; without it a scene's whole demonstration.
    pub ticks: Option<u64>,
    /// Time after which no further tick is measured, s.
    pub patience_s: f64,
}

/// What one module did in a case.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModuleUse {
    /// Which.
    pub module: Module,
    /// Whether the scene requires it.
    pub required: bool,
    /// Systems of it that ran, in all ticks.
    pub runs: u64,
    /// Mean wall time of its stages, ms a tick.
    pub ms: f64,
    /// Entities with a component of it.
    pub entities: usize,
    /// Size of these components without what they have on the heap, bytes.
    pub bytes: usize,
    /// Size of its resources without what they have on the heap, bytes.
    pub resource_bytes: usize,
}

/// What a case came to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// Name of the scene.
    pub name: String,
    /// Soft organs at the end, with what came free.
    pub organs: usize,
    /// Tetrahedra of all organs before the first tick.
    pub tets: usize,
    /// Tetrahedra at the end.
    pub tets_after: usize,
    /// From nothing to the end of the first tick, s.
    pub start_s: f64,
    /// Ticks measured.
    pub ticks: u64,
    /// Whole ticks, ms.
    pub tick_ms: Cost,
    /// Stages of a tick in their order, ms.
    pub stage_ms: Vec<(String, Cost)>,
    /// Modules.
    pub modules: Vec<ModuleUse>,
    /// The most memory that the process has had resident, bytes; none where the system does not tell.
    pub peak_bytes: Option<u64>,
    /// What the implicit solver keeps for all organs, bytes.
    pub solver_bytes: usize,
    /// Organs that were solved, a tick.
    pub stepped: f64,
    /// Organs that slept, a tick.
    pub asleep: f64,
    /// Iterations of the implicit solver, a tick.
    pub iterations: f64,
    /// Nodes, faces and tetrahedra that collision looked at, a tick.
    pub looked_at: f64,
    /// Contacts, a tick.
    pub contacts: f64,
}

/// Why a case has no result.
#[derive(Debug, thiserror::Error)]
pub enum CaseError {
    /// Its scene.
    #[error(transparent)]
    Theatre(#[from] TheatreError),
    /// A scene that the study itself writes: a fault of this program.
    #[error("the scene of the case cannot be read: {0}")]
    Scene(String),
    /// A system of the simulation failed; the log says which.
    #[error("a part of the simulation failed at tick {0}: the message above says which and why")]
    Fault(u64),
}

/// Wall time of the gestures, each on its own.
#[derive(Resource)]
struct GestureCost {
    mark: Instant,
    total: [Duration; 3],
}

/// Measures a case.
///
/// # Errors
/// When its scene cannot be read or a system fails.
pub fn measure(case: &Case) -> Result<Measured, CaseError> {
    let census = Census::new();
    let began = Instant::now();
    let theatre = theatre(&case.subject)?;
    let name = theatre.scene.name.clone();
    let whole = theatre.demonstration_s().map_or(0, |s| (s * TICKS_PER_SECOND).ceil() as u64);
    let mut app = simulation(theatre, Settings { demonstration: true, ..Settings::default() });
    if let Some(module) = case.toggled {
        module.toggle(&mut app.world_mut().resource_mut::<SceneRequirements>());
    }
    time_gestures(&mut app);
    let tets = tets(&mut app);
    let mut ticks_run = 0;
    let mut update = |app: &mut App| {
        app.update();
        ticks_run += 1;
        if faults() > 0 { Err(CaseError::Fault(ticks_run)) } else { Ok(()) }
    };
    update(&mut app)?;
    let start_s = began.elapsed().as_secs_f64();
    for _ in 1..case.warm_ticks {
        update(&mut app)?;
    }
    let (work_before, tissue_before) = work(&app);
    app.world_mut().resource_mut::<GestureCost>().total = Default::default();
    let (mut costs, mut ticks, mut contacts) = (Costs::default(), 0, 0_usize);
    let mut runs = Module::ALL.map(|_| 0);
    let mut last = census.last_runs(&mut app);
    let wanted = case.ticks.unwrap_or(whole.saturating_sub(case.warm_ticks)).max(1);
    let measuring = Instant::now();
    while ticks < wanted && (ticks == 0 || measuring.elapsed().as_secs_f64() < case.patience_s) {
        update(&mut app)?;
        ticks += 1;
        costs.record(app.world().resource::<TickCost>());
        let now = census.last_runs(&mut app);
        for (sum, of_tick) in runs.iter_mut().zip(now.runs_since(&last).into_values()) {
            *sum += of_tick;
        }
        last = now;
        let world = app.world_mut();
        contacts += world.query::<&Contacts>().iter(world).map(|c| c.0.len()).sum::<usize>();
    }
    let (work_after, tissue_after) = work(&app);
    let a_tick = |after: u64, before: u64| (after - before) as f64 / ticks as f64;
    let modules = modules(&app, &census, &costs, runs, ticks);
    let tets_after = self::tets(&mut app);
    let world = app.world_mut();
    Ok(Measured {
        name,
        organs: world.query::<&TissueMesh>().iter(world).len(),
        tets,
        tets_after,
        start_s,
        ticks,
        tick_ms: costs.tick(),
        stage_ms: costs.stages(),
        modules,
        peak_bytes: peak_bytes(),
        solver_bytes: world.query::<&TissueBody>().iter(world).map(|b| b.body.solver_bytes()).sum(),
        stepped: a_tick(tissue_after.stepped, tissue_before.stepped),
        asleep: a_tick(tissue_after.asleep, tissue_before.asleep),
        iterations: a_tick(tissue_after.iterations, tissue_before.iterations),
        looked_at: a_tick(work_after.nodes + work_after.faces + work_after.tets, work_before.nodes + work_before.faces + work_before.tets),
        contacts: contacts as f64 / ticks as f64,
    })
}

fn tets(app: &mut App) -> usize {
    let world = app.world_mut();
    world.query::<&TissueMesh>().iter(world).map(|m| m.0.tet_count()).sum()
}

fn work(app: &App) -> (CollisionReport, TissueReport) {
    (*app.world().resource::<CollisionReport>(), app.world().resource::<TissueReport>().clone())
}

/// Marks the ends of the gestures' sets.
fn time_gestures(app: &mut App) {
    use GestureSystems::{Clip, Further, Grasp, Suture};
    let mark = |i: usize| {
        move |mut cost: ResMut<GestureCost>| {
            let now = Instant::now();
            let spent = now - cost.mark;
            cost.mark = now;
            cost.total[i] += spent;
        }
    };
    let start = |mut cost: ResMut<GestureCost>| cost.mark = Instant::now();
    app.insert_resource(GestureCost { mark: Instant::now(), total: Default::default() }).add_systems(
        FixedUpdate,
        (start.before(Grasp), mark(0).after(Grasp).before(Clip), mark(1).after(Clip).before(Suture), mark(2).after(Suture).before(Further))
            .in_set(TickSystems::Gesture),
    );
}

/// What each module did; the stages that are its own are its cost.
fn modules(app: &App, census: &Census, costs: &Costs, runs: [u64; Module::ALL.len()], ticks: u64) -> Vec<ModuleUse> {
    let requirements = *app.world().resource::<SceneRequirements>();
    let gestures = app.world().resource::<GestureCost>().total.map(|d| d.as_secs_f64() * 1e3 / ticks as f64);
    let stages = costs.stages();
    let stage = |of: TickSystems| stages[of as usize].1.mean;
    let holdings = census.holdings(app);
    let using = |(module, runs): (Module, u64)| {
        let ms = match module {
            Module::Instruments => stage(TickSystems::Sense),
            Module::Grasping => gestures[0],
            Module::Clipping => gestures[1],
            Module::Suturing => gestures[2],
            Module::Cutting => stage(TickSystems::Cut),
            Module::Collision => stage(TickSystems::Collide),
            Module::Tissue => stage(TickSystems::Adopt) + stage(TickSystems::Tissue),
            Module::Rigid => stage(TickSystems::Rigid),
            Module::Assessment => stage(TickSystems::Assess),
        };
        let has = holdings.get(&module).copied().unwrap_or_default();
        ModuleUse {
            module,
            required: module.is_required(requirements),
            runs,
            ms,
            entities: has.entities,
            bytes: has.bytes,
            resource_bytes: has.resource_bytes,
        }
    };
    Module::ALL.into_iter().zip(runs).map(using).collect()
}

/// The most memory that this process has had resident, bytes: `VmHWM`, which Linux tells.
fn peak_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok().map(|kb| kb * 1024)
}

fn theatre(subject: &Subject) -> Result<Theatre, CaseError> {
    let text = match subject {
        Subject::Scene { path } => return Ok(Theatre::load(path)?),
        Subject::Nothing => "version: 1, name: \"nothing\", organs: []".into(),
        Subject::Block { tets } => block(*tets),
        Subject::Organs { count, tets, asleep } => organs(*count, *tets, *asleep),
    };
    let scene = keyhole_scene::parse(&format!("({text})")).map_err(|e| CaseError::Scene(e.to_string()))?;
    Ok(Theatre::of(scene, Path::new("study"))?)
}

/// Cells along the three sides of a cube, six tetrahedra each, so that there are about `tets`.
fn cells(tets: usize) -> [u32; 3] {
    let cells = tets as f64 / 6.0;
    let low = (cells.cbrt().floor() as u32).max(1);
    // One side after the other becomes longer as long as that comes nearer.
    let mut sides = [low; 3];
    for i in 0..3 {
        let longer = |sides: [u32; 3]| f64::from(sides[0] * sides[1] * sides[2]);
        let mut more = sides;
        more[i] += 1;
        if (longer(more) - cells).abs() < (longer(sides) - cells).abs() {
            sides = more;
        }
    }
    sides
}

/// A block along the axes with its middle at `x` (m), held at its left side.
fn organ(name: &str, side_m: f64, tets: usize, x: f64) -> String {
    let [a, b, c] = cells(tets);
    let left = x - 0.49 * side_m;
    format!(
        "(name: \"{name}\", shape: Block(size: ({side_m}, {side_m}, {side_m}), cells: ({a}, {b}, {c})), transform: (translation: ({x}, 0, 0)), \
         materials: [(name: \"kidney\", young_modulus_pa: 14700.0, poisson_ratio: 0.45, density_kg_m3: 1050.0, inside: (0.5, 0.1, 0.1), surface: (0.5, 0.1, 0.1))], \
         attachments: [(region: HalfSpace(point: ({left}, 0, 0), normal: (-1, 0, 0)))])"
    )
}

/// A grasper goes up and down on the top of the block, twice a second; a scalpel cuts a slit of 24 mm into it from 0.75 s on.
fn block(tets: usize) -> String {
    let mut press = String::new();
    for i in 0..16 {
        let (time_s, y) = (0.25 * f64::from(i), if i % 2 == 0 { 0.040 } else { 0.026 });
        // Writing to a string cannot fail.
        let _ = write!(press, "(time_s: {time_s}, tip: (-0.01, {y}, 0), grip: 1.0), ");
    }
    format!(
        "version: 1, name: \"block\", organs: [{}], \
         ports: [(name: \"left\", position: (-0.05, 0.2, 0), inward: (0.2, -1, 0)), (name: \"right\", position: (0.06, 0.2, 0), inward: (-0.2, -1, 0))], \
         instruments: [(kind: Grasper, hand: Left, port: \"left\"), (kind: Scalpel, hand: Right, port: \"right\")], \
         demonstration: (seconds: 4.0, hands: [(hand: Left, keys: [{press}]), (hand: Right, keys: [\
         (time_s: 0.0, tip: (0.015, 0.050, 0.012)), (time_s: 0.5, tip: (0.015, 0.036, 0.012)), \
         (time_s: 0.75, tip: (0.015, 0.022, 0.012), active: true), (time_s: 1.75, tip: (0.015, 0.022, -0.012)), \
         (time_s: 2.0, tip: (0.015, 0.050, -0.012))])])",
        organ("block", 0.06, tets, 0.0)
    )
}

fn organs(count: usize, tets: usize, asleep: bool) -> String {
    let all: Vec<String> = (0..count).map(|i| organ(&format!("block {}", i + 1), 0.04, tets, 0.05 * i as f64)).collect();
    let gravity = if asleep { "(0, 0, 0)" } else { "(0, -9.81, 0)" };
    format!("version: 1, name: \"{count} organs\", gravity: {gravity}, organs: [{}]", all.join(", "))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;

    #[test]
    fn blocks_have_about_as_many_tetrahedra_as_asked_for() {
        for tets in [1_000, 3_000, 10_000, 30_000, 100_000, 200_000] {
            let found: u32 = 6 * cells(tets).iter().product::<u32>();
            assert!((f64::from(found) / tets as f64 - 1.0).abs() < 0.1, "{found} for {tets}");
        }
    }

    #[test]
    fn the_scenes_of_the_study_can_be_read() {
        for subject in [Subject::Nothing, Subject::Block { tets: 100 }, Subject::Organs { count: 3, tets: 100, asleep: true }] {
            let theatre = theatre(&subject).unwrap();
            let organs = match subject {
                Subject::Organs { count, .. } => count,
                Subject::Block { .. } => 1,
                _ => 0,
            };
            assert_eq!(theatre.meshes.len(), organs);
        }
    }
}
