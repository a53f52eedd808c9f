//! `keyhole` and `keyhole play`: a scene in a window.

use crate::cli::run::{Wanted, replay_verdict, say, seconds, with_report};
use crate::cli::{Failure, MethodArg};
use crate::perform::Replayed;
use crate::recording::{header, read};
use crate::report::folder;
use crate::simulation::{Output, Settings, TICKS_PER_SECOND, simulation};
use crate::theatre::{Theatre, default_scene as find_default_scene};
use bevy::prelude::*;
use keyhole_assessment::recording::{Play, Player, Recorder, Recording, RecordingWriter};
use keyhole_view::{PictureOf, PictureRequest, PictureRequests, PicturesPending, adapter_available, display_available};
use keyhole_whiteboard::TickCost;
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
    /// Close the window after this much simulated time, s.
    #[arg(long, value_name = "S", value_parser = seconds, allow_hyphen_values = true)]
    pub seconds: Option<f64>,
    /// Save what the window shows in the end as a PNG.
    #[arg(long, value_name = "FILE.png", requires = "seconds")]
    pub picture: Option<PathBuf>,
}

/// Plays a scene in a window.
///
/// # Errors
/// Status 2 when the scene is not as it should be; status 1 without a display or a graphics adapter, or when a part of the simulation fails.
pub fn run(args: PlayArgs) -> Result<(), Failure> {
    let path = args.scene.map_or_else(find_default_scene, Ok).map_err(Failure::input)?;
    let theatre = Theatre::load(&path).map_err(Failure::input)?;
    display_available().map_err(Failure::job)?;
    adapter_available().map_err(Failure::job)?;
    let replay = args.replay.map(|file| read(&file, &path, &theatre)).transpose().map_err(Failure::input)?;
    let writer = |file: &PathBuf| header(&path, &theatre).and_then(|header| RecordingWriter::create(file, &header));
    let record = args.record.as_ref().map(writer).transpose().map_err(Failure::input)?;
    let settings =
        Settings { output: Output::Window, method: args.method.map(Into::into), demonstration: args.demonstration, threads: None };
    open(theatre, settings, Session { seconds: args.seconds, picture: args.picture, replay, record })
}

/// What happens in a window besides playing.
#[derive(Default)]
struct Session {
    seconds: Option<f64>,
    picture: Option<PathBuf>,
    replay: Option<Recording>,
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
        None => open(theatre, Settings { output: Output::Window, ..Settings::default() }, Session::default()),
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
    picture: Option<PathBuf>,
}

fn open(theatre: Theatre, settings: Settings, session: Session) -> Result<(), Failure> {
    let Session { seconds, picture, replay, record } = session;
    let mut app = simulation(theatre, settings);
    if let Some(recording) = replay {
        app.insert_resource(Player::new(Play::new(recording))).add_systems(Last, tell_end);
    }
    if let Some(writer) = record {
        app.insert_resource(Recorder::new(writer));
    }
    if let Some(seconds) = seconds {
        let after_tick = (seconds * TICKS_PER_SECOND).ceil() as u64;
        app.insert_resource(Closing { after_tick, picture }).add_systems(Last, close);
    }
    match app.run() {
        AppExit::Success => Ok(()),
        AppExit::Error(code) => Err(Failure::job(format!("the window closed with error {code}: the messages above say why"))),
    }
}

fn close(
    cost: Res<TickCost>,
    mut closing: ResMut<Closing>,
    mut requests: ResMut<PictureRequests>,
    pending: Res<PicturesPending>,
    mut exit: MessageWriter<AppExit>,
) {
    if cost.ticks < closing.after_tick {
        return;
    }
    if let Some(path) = closing.picture.take() {
        requests.0.push(PictureRequest { path, of: PictureOf::Window });
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
