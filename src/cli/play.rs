//! `keyhole` and `keyhole play`: a scene in a window.

use crate::cli::run::{Wanted, moment, replay_verdict, say, seconds, with_report, within};
use crate::cli::{Failure, MethodArg};
use crate::perform::{Replayed, in_ticks};
use crate::recording::{header, read};
use crate::replay_keys::ReplayPlugin;
use crate::report::folder;
use crate::seek::Timeline;
use crate::simulation::{Output, Settings, simulation};
use crate::stage::StagePlugin;
use crate::theatre::{Theatre, default_scene as find_default_scene};
use bevy::diagnostic::FrameCount;
use bevy::prelude::*;
use bevy::window::PrimaryWindow;
use clap::ValueEnum;
use keyhole_assessment::recording::{Play, Player, Recorder, Recording, RecordingWriter};
use keyhole_view::{PictureOf, PictureRequest, PictureRequests, PicturesPending, ViewLayout, adapter_available, display_available};
use keyhole_whiteboard::{SimulationControl, TickCost, ViewMode};
use std::path::{Path, PathBuf};

/// Arguments of `keyhole play`.
#[derive(Debug, clap::Args)]
pub struct PlayArgs {
    /// The scene; without one the default scene.
    pub scene: Option<PathBuf>,
    /// Another release policy than the scene's.
    #[arg(long, value_enum)]
    pub method: Option<MethodArg>,
    /// Begin with the demonstration.
    #[arg(long, conflicts_with = "replay")]
    pub demonstration: bool,
    /// Record what comes from outside in each tick to this file, which must not be there.
    #[arg(long, value_name = "FILE")]
    pub record: Option<PathBuf>,
    /// Play a recording; the views are free. At its end the simulation is paused.
    #[arg(long, value_name = "FILE", conflicts_with = "method")]
    pub replay: Option<PathBuf>,
    /// Begin at this time of the recording, s. Arrow keys, Home and End go to others.
    #[arg(long, value_name = "S", value_parser = moment, requires = "replay", allow_hyphen_values = true)]
    pub from: Option<f64>,
    /// Close the window after this much simulated time, s, and say how many frames were drawn and what they cost.
    #[arg(long, value_name = "S", value_parser = seconds, allow_hyphen_values = true)]
    pub seconds: Option<f64>,
    /// Save what the window shows in the end as a PNG.
    #[arg(long, value_name = "FILE.png", requires = "seconds")]
    pub picture: Option<PathBuf>,
    /// Begin with this view. V changes it.
    #[arg(long, value_enum, default_value_t = ViewArg::Global)]
    pub view: ViewArg,
    /// Begin with this layout. I and T change it.
    #[arg(long, value_enum, default_value_t = LayoutArg::Single)]
    pub layout: LayoutArg,
    /// Size of the window, pixels.
    #[arg(long, value_name = "WxH", value_parser = size)]
    pub window: Option<UVec2>,
}

/// A view.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum ViewArg {
    /// The whole theatre from outside.
    #[default]
    Global,
    /// Through the endoscope.
    Laparoscopic,
}

/// How the window is shared out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum LayoutArg {
    /// One view.
    #[default]
    Single,
    /// The other view small in a corner.
    Inset,
    /// The laparoscopic view through two lenses, side by side.
    Stereo,
}

fn size(text: &str) -> Result<UVec2, String> {
    let parsed = text.split_once('x').and_then(|(w, h)| Some(UVec2::new(w.parse().ok()?, h.parse().ok()?)));
    parsed
        .filter(|s| s.cmpge(UVec2::new(320, 240)).all() && s.cmple(UVec2::splat(16_384)).all())
        .ok_or_else(|| "expected a width and a height in pixels, 320x240 or more: 1280x720".into())
}

/// Plays a scene in a window.
///
/// # Errors
/// Status 2 when the scene is not as it should be; status 1 without a display or a graphics adapter, or when a part of the simulation fails.
pub fn run(args: PlayArgs) -> Result<(), Failure> {
    // Without a scene, and without anything that is of one, the trainee chooses.
    let start = args.scene.is_none() && !args.demonstration && args.replay.is_none() && args.record.is_none();
    let path = args.scene.map_or_else(find_default_scene, Ok).map_err(Failure::input)?;
    let theatre = Theatre::load(&path).map_err(Failure::input)?;
    display_available().map_err(Failure::job)?;
    adapter_available().map_err(Failure::job)?;
    let replay = args.replay.map(|file| read(&file, &path, &theatre)).transpose().map_err(Failure::input)?;
    let from_s = args.from.map(|from| within(from, replay.as_ref())).transpose()?;
    let writer = |file: &PathBuf| header(&path, &theatre).and_then(|header| RecordingWriter::create(file, &header));
    let record = args.record.as_ref().map(writer).transpose().map_err(Failure::input)?;
    let settings =
        Settings { output: Output::Window, method: args.method.map(Into::into), demonstration: args.demonstration, threads: None };
    let view = match args.view {
        ViewArg::Global => ViewMode::Global,
        ViewArg::Laparoscopic => ViewMode::Laparoscopic,
    };
    let layout = match args.layout {
        LayoutArg::Single => ViewLayout::Single,
        LayoutArg::Inset => ViewLayout::Inset,
        LayoutArg::Stereo => ViewLayout::SideBySide,
    };
    let (seconds, picture, window) = (args.seconds, args.picture, args.window);
    open(theatre, settings, Session { path, start, seconds, picture, replay, from_s, record, view, layout, window })
}

/// What happens in a window besides playing.
#[derive(Default)]
struct Session {
    /// The scene's file.
    path: PathBuf,
    /// Begin with the start screen.
    start: bool,
    view: ViewMode,
    layout: ViewLayout,
    window: Option<UVec2>,
    seconds: Option<f64>,
    picture: Option<PathBuf>,
    replay: Option<Recording>,
    from_s: Option<f64>,
    record: Option<RecordingWriter>,
}

/// Plays the default scene in a window, or without a display or an adapter performs its demonstration and leaves a report.
///
/// # Errors
/// Status 2 when there is no default scene; status 1 when the performance or the window fails.
pub fn default_scene() -> Result<(), Failure> {
    let path = find_default_scene().map_err(Failure::input)?;
    let theatre = Theatre::load(&path).map_err(Failure::input)?;
    let missing = display_available().and_then(|()| adapter_available()).err();
    match missing {
        None => {
            let session = Session { path, start: true, ..Session::default() };
            open(theatre, Settings { output: Output::Window, ..Settings::default() }, session)
        }
        Some(why) => {
            eprintln!("keyhole: no window: {why}; performing the demonstration of {} instead", path.display());
            with_report(theatre, &Wanted { report: Some(folder::unused(Path::new("."))), ..Wanted::default() })
        }
    }
}

/// When the window closes by itself.
#[derive(Resource)]
struct Closing {
    after_tick: u64,
    /// On the start screen no tick runs: then after this much time by the clock, s.
    after_s: Option<f64>,
    picture: Option<PathBuf>,
    /// The tick that is shown first.
    from_tick: u64,
    /// When that came: before it pipelines are made, and a replay is on its way there.
    begun: Spent,
}

/// What has been spent since the program started.
#[derive(Clone, Copy, Default)]
struct Spent {
    frames: u32,
    /// By the clock, s.
    time_s: f64,
    /// By the processor, all threads together, s, and by those that draw in software; `None` where the system does not say.
    processor_s: Option<[f64; 2]>,
}

impl Spent {
    /// What a frame took since `before`.
    fn sentence(&self, before: &Self) -> Option<String> {
        let (frames, length_s) = (self.frames - before.frames, self.time_s - before.time_s);
        let per_frame = |s: f64| s / f64::from(frames);
        let drawn = format!("{frames} frames in {length_s:.1} s: {:.1} a second", per_frame(length_s).recip());
        let processor = self.processor_s.zip(before.processor_s).map(|(now, then)| [now[0] - then[0], now[1] - then[1]].map(per_frame));
        let cost = processor.map(|[all, software]| format!("; {all:.3} s of processor each, {software:.3} s of it drawing in software"));
        (frames > 0).then(|| drawn + &cost.unwrap_or_default())
    }
}

/// What the threads of this program have taken, s, on Linux, and those of lavapipe among them.
fn processor_s() -> Option<[f64; 2]> {
    let mut sum = [0.0; 2];
    for thread in std::fs::read_dir("/proc/self/task").ok()? {
        let folder = thread.ok()?.path();
        // A thread that has just ended is none.
        let Ok(schedule) = std::fs::read_to_string(folder.join("schedstat")) else { continue };
        let taken_s = 1e-9 * schedule.split_whitespace().next()?.parse::<f64>().ok()?;
        let software = std::fs::read_to_string(folder.join("comm")).is_ok_and(|name| name.starts_with("llvmpipe"));
        sum[0] += taken_s;
        sum[1] += if software { taken_s } else { 0.0 };
    }
    Some(sum)
}

fn open(theatre: Theatre, settings: Settings, session: Session) -> Result<(), Failure> {
    let Session { path, start, view, layout, window, seconds, picture, replay, from_s, record } = session;
    let mut app = simulation(theatre, settings);
    let free = replay.is_none() && record.is_none();
    app.add_plugins(StagePlugin { path, free, start }).insert_resource(view).insert_resource(layout);
    if let Some(size) = window {
        let mut windows = app.world_mut().query_filtered::<&mut Window, With<PrimaryWindow>>();
        for mut window in windows.iter_mut(app.world_mut()) {
            window.resolution.set_physical_resolution(size.x, size.y);
        }
    }
    if let Some(recording) = replay {
        app.insert_resource(Player::new(Play::new(recording))).add_plugins(ReplayPlugin).add_systems(Last, tell_end);
        if let Some(from_s) = from_s {
            app.world_mut().resource_mut::<Timeline>().go_to(in_ticks(from_s), &SimulationControl::default(), false);
        }
    }
    if let Some(writer) = record {
        app.insert_resource(Recorder::new(writer));
    }
    if let Some(seconds) = seconds {
        let from_s = from_s.unwrap_or(0.0);
        let (from_tick, after_tick) = (in_ticks(from_s), in_ticks(from_s + seconds));
        app.insert_resource(Closing { after_tick, after_s: start.then_some(seconds), picture, from_tick, begun: Spent::default() })
            .add_systems(Last, close);
    }
    match app.run() {
        AppExit::Success => Ok(()),
        AppExit::Error(code) => Err(Failure::job(format!("the window closed with error {code}: the messages above say why"))),
    }
}

fn close(
    cost: Res<TickCost>,
    (time, frames): (Res<Time<Real>>, Res<FrameCount>),
    mut closing: ResMut<Closing>,
    mut requests: ResMut<PictureRequests>,
    pending: Res<PicturesPending>,
    mut exit: MessageWriter<AppExit>,
    mut told: Local<bool>,
) {
    let now = || Spent { frames: frames.0, time_s: time.elapsed_secs_f64(), processor_s: processor_s() };
    if cost.ticks <= closing.from_tick {
        closing.begun = now();
    }
    let long_enough = closing.after_s.is_some_and(|s| time.elapsed_secs_f64() >= s);
    if cost.ticks < closing.after_tick && !long_enough {
        return;
    }
    if !std::mem::replace(&mut *told, true) {
        requests.0.extend(closing.picture.take().map(|path| PictureRequest { path, of: PictureOf::Window }));
        if let Some(sentence) = now().sentence(&closing.begun) {
            say(&sentence);
        }
    } else if pending.0 == 0 && requests.0.is_empty() {
        exit.write(AppExit::Success);
    }
}

/// Says once that the replay is over, and whether it was true to its recording.
fn tell_end(player: Res<Player>, mut told: Local<bool>) {
    let play = &player.play;
    if play.finished() && !*told {
        *told = true;
        let replayed = Replayed { compared: play.compared(), differs_from: play.difference().map(|d| d.tick) };
        say(&replay_verdict(replayed));
    }
}
