//! The app: which plugins it has, around a theatre. `main`, tests and benches all build it here.

use crate::modules::Module;
use crate::seek::SeekPlugin;
use crate::spawn::{cut_settings, reset, spawn};
use crate::theatre::Theatre;
use crate::window::WindowSharingPlugin;
use bevy::app::TaskPoolThreadAssignmentPolicy;
use bevy::ecs::error::{BevyError, ErrorContext};
use bevy::log::LogPlugin;
use bevy::prelude::*;
use bevy::render::pipelined_rendering::PipelinedRenderingPlugin;
use bevy::time::{TimePlugin, TimeUpdateStrategy};
use bevy::window::ExitCondition;
use bevy::winit::WinitPlugin;
use keyhole_assessment::recording::{PlayerSystems, RecordingPlugin};
use keyhole_hid::{HidPlugin, shipped};
use keyhole_hud::HudPlugin;
use keyhole_view::ViewPlugin;
use keyhole_whiteboard::{CutMethod, ScriptClock, SimulationControl, WhiteboardPlugin, tick::running};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// Ticks a simulated second.
pub const TICKS_PER_SECOND: f64 = 60.0;

/// Ticks that one frame of a window runs at the most.
const MOST_TICKS_A_FRAME: f64 = 2.0;

/// Where the app shows what it does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Output {
    /// Nowhere: no renderer at all. Each update is one tick.
    #[default]
    None,
    /// Pictures on demand, without a window. Each update is one tick.
    Pictures,
    /// A window with a HUD; ticks follow the clock on the wall.
    Window,
}

/// How a theatre is run.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Settings {
    /// Where the app shows what it does.
    pub output: Output,
    /// Another release policy than the scene's.
    pub method: Option<CutMethod>,
    /// Whether the demonstration drives the instruments from the start.
    pub demonstration: bool,
    /// Threads of the app; default as many as there are cores.
    pub threads: Option<usize>,
}

/// Systems that failed since the program started: a failure is logged and counted, and the simulation stops.
static FAULTS: AtomicU64 = AtomicU64::new(0);

/// Number of systems that failed since the program started.
#[must_use]
pub fn faults() -> u64 {
    FAULTS.load(Ordering::Relaxed)
}

/// The app of a theatre, with everything spawned.
///
/// With [`Output::None`] and [`Output::Pictures`] it is finished and ready for `App::update`; with [`Output::Window`] for `App::run`.
pub fn simulation(theatre: Theatre, settings: Settings) -> App {
    simulation_of(theatre, settings, Module::ALL)
}

/// The same with these modules alone: the others are not there at all, whatever the scene requires.
pub fn simulation_of(theatre: Theatre, settings: Settings, modules: impl IntoIterator<Item = Module>) -> App {
    let mut app = App::new();
    add_engine(&mut app, settings);
    app.set_error_handler(count_fault)
        .insert_resource(Time::<Fixed>::from_hz(TICKS_PER_SECOND))
        .add_plugins((WhiteboardPlugin, RecordingPlugin, SeekPlugin))
        .add_systems(First, (stop_on_fault, reset).chain().after(PlayerSystems))
        .add_systems(FixedFirst, (reset, stand_still.run_if(not(running))).chain().after(PlayerSystems));
    modules.into_iter().for_each(|module| module.add(&mut app));
    match settings.output {
        Output::None => {}
        Output::Pictures => {
            app.add_plugins(ViewPlugin::default());
        }
        Output::Window => {
            // Where a tick costs more than its time, simulated time lags behind; frames stay short and hands stay in touch.
            app.insert_resource(Time::<Virtual>::from_max_delta(Duration::from_secs_f64(MOST_TICKS_A_FRAME / TICKS_PER_SECOND)))
                .add_plugins((ViewPlugin::default(), HudPlugin, WindowSharingPlugin, devices()))
                .add_systems(Last, hand_over);
        }
    }
    let mut cut = cut_settings(&theatre);
    cut.method = settings.method.unwrap_or(cut.method);
    app.insert_resource(cut);
    app.world_mut().resource_mut::<SimulationControl>().demonstration = settings.demonstration;
    spawn(app.world_mut(), &theatre);
    app.insert_resource(theatre);
    if settings.output != Output::Window {
        app.insert_resource(TimeUpdateStrategy::FixedTimesteps(1));
        app.finish();
        app.cleanup();
        // The clock's first update only starts it: no tick runs yet.
        app.update();
    }
    app
}

/// The devices of this machine. A profile of the user that is none is logged, and does not matter to the others.
fn devices() -> HidPlugin {
    let (profiles, errors) = shipped::all();
    errors.iter().for_each(|error| tracing::warn!("{error}"));
    HidPlugin::of_this_machine(profiles)
}

fn add_engine(app: &mut App, settings: Settings) {
    let pools = || TaskPoolPlugin { task_pool_options: pool_options(settings.threads) };
    let nothing = WindowPlugin { primary_window: None, exit_condition: ExitCondition::DontExit, ..default() };
    let window = Window { title: "Keyhole".into(), ..default() };
    let engine = || DefaultPlugins.build().disable::<LogPlugin>().set(pools());
    match settings.output {
        Output::None => app.add_plugins((pools(), TimePlugin)),
        Output::Pictures => app.add_plugins(engine().set(nothing).disable::<WinitPlugin>().disable::<PipelinedRenderingPlugin>()),
        Output::Window => app.add_plugins(engine().set(WindowPlugin { primary_window: Some(window), ..default() })),
    };
}

fn pool_options(threads: Option<usize>) -> TaskPoolOptions {
    let Some(threads) = threads else { return TaskPoolOptions::default() };
    let compute = TaskPoolThreadAssignmentPolicy { min_threads: threads, max_threads: threads, ..TaskPoolOptions::default().compute };
    TaskPoolOptions { compute, ..TaskPoolOptions::with_num_threads(threads) }
}

fn count_fault(error: BevyError, context: ErrorContext) {
    FAULTS.fetch_add(1, Ordering::Relaxed);
    tracing::error!("{context}: {error}");
}

/// While the simulation is paused its clock stands: what is held until a time would be let go of otherwise, and nobody has lived to see it.
fn stand_still(mut time: ResMut<Time<Fixed>>) {
    let (step, now, overstep) = (time.timestep(), time.elapsed(), time.overstep());
    let mut stood = Time::<Fixed>::from_duration(step);
    stood.advance_to(now.saturating_sub(step));
    stood.accumulate_overstep(overstep);
    *time = stood;
}

/// A system that failed once would fail again each tick: the simulation is paused.
fn stop_on_fault(mut control: ResMut<SimulationControl>, mut seen: Local<u64>) {
    let faults = faults();
    if faults > *seen {
        *seen = faults;
        control.paused = true;
    }
}

/// When the demonstration is over the trainee takes over; one that is started again begins at its beginning.
fn hand_over(mut control: ResMut<SimulationControl>, mut clock: ResMut<ScriptClock>, mut performing: Local<bool>) {
    if control.demonstration && *performing && clock.ticks > 0 && clock.finished() {
        control.demonstration = false;
    }
    if control.demonstration && !*performing {
        *clock = ScriptClock { end_s: clock.end_s, ..default() };
    }
    *performing = control.demonstration;
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::time::TimeUpdateStrategy;

    /// The clock of ticks stands while the simulation is paused, and goes on by one tick a step.
    #[test]
    fn a_pause_takes_no_simulated_time() {
        let mut app = App::new();
        app.add_plugins(TimePlugin)
            .insert_resource(TimeUpdateStrategy::FixedTimesteps(1))
            .insert_resource(Time::<Fixed>::from_hz(TICKS_PER_SECOND))
            .init_resource::<SimulationControl>()
            .add_systems(FixedFirst, stand_still.run_if(not(running)));
        let mut run = |updates: u32, paused: bool| {
            app.world_mut().resource_mut::<SimulationControl>().paused = paused;
            (0..updates).for_each(|_| app.update());
            (app.world().resource::<Time<Fixed>>().elapsed_secs_f64() * TICKS_PER_SECOND).round()
        };
        let before = run(5, false);
        assert!(before > 0.0);
        assert_eq!(run(100, true), before);
        assert_eq!(run(3, false), before + 3.0);
    }
}
