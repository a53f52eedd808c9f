//! A scene performed without a window: its demonstration from beginning to end, with a report and pictures where a renderer is found.

use crate::margin::{paint, viewpoint};
use crate::report::{Recorder, Summary, cost::Costs};
use crate::simulation::{Output, Settings, TICKS_PER_SECOND, faults, simulation};
use crate::theatre::Theatre;
use bevy::prelude::*;
use keyhole_assessment::recording::{Header, Play, Player, Recorder as InputRecorder, Recording, RecordingError, RecordingWriter};
use keyhole_assessment::{Outcome as Assessed, outcome as assessed};
use keyhole_instruments::Script;
use keyhole_view::{PictureError, PictureOf, PictureRequest, take_pictures};
use keyhole_whiteboard::{CutMethod, Hand, ViewMode};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// The picture of what was resected in the colours of its margin.
pub const MARGIN: &str = "4_margin.png";
/// Ticks between two frames unless it is said otherwise: ten frames a simulated second.
pub const TICKS_PER_FRAME: u64 = TICKS_PER_SECOND as u64 / 10;

/// What is performed and what is wanted of it.
#[derive(Clone, Debug, Default)]
pub struct Performance {
    /// Simulated time, s; default the demonstration's length.
    pub seconds: Option<f64>,
    /// Another release policy than the scene's.
    pub method: Option<CutMethod>,
    /// Threads; default as many as there are cores.
    pub threads: Option<usize>,
    /// An existing folder for pictures of both views before, during and after the cut.
    pub pictures: Option<PathBuf>,
    /// An existing folder for frames.
    pub frames: Option<PathBuf>,
    /// Which frames, by the name that stands in their files' names; none: both views.
    pub cameras: Vec<(String, PictureOf)>,
    /// Ticks between two frames; default [`TICKS_PER_FRAME`].
    pub ticks_per_frame: Option<u64>,
    /// A recording to play instead of the demonstration, to its end or as long as `seconds` says.
    pub replay: Option<Recording>,
    /// Time of the recording at which pictures and frames begin, s; `seconds` counts from there.
    pub from_s: f64,
    /// A recording to make.
    pub record: Option<Record>,
}

/// Where a recording is written, and what it starts with.
#[derive(Clone, Debug)]
pub struct Record {
    /// The file, which must not be there.
    pub file: PathBuf,
    /// See [`crate::recording::header`].
    pub header: Header,
}

/// What came of it.
#[derive(Debug)]
pub struct Outcome {
    /// The report.
    pub summary: Summary,
    /// What every tick cost.
    pub costs: Costs,
    /// How true a replay was to its recording.
    pub replayed: Option<Replayed>,
    /// What the session was measured to; `None` where the scene does not require it.
    pub assessed: Option<Assessed>,
}

/// How true a replay was to its recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Replayed {
    /// Ticks after which the state was compared.
    pub compared: u64,
    /// The first of them whose state differs.
    pub differs_from: Option<u64>,
}

/// Why a performance did not come to its end.
#[derive(Debug, thiserror::Error)]
pub enum PerformError {
    /// There is nothing to perform.
    #[error("the scene has no demonstration: give --seconds to let it run by itself, or add a demonstration to it")]
    NothingToPerform,
    /// A picture could not be taken.
    #[error(transparent)]
    Picture(#[from] PictureError),
    /// The recording could not be written.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// A system of the simulation failed; the log says which.
    #[error("a part of the simulation failed at tick {tick}: the message above says which and why")]
    Fault {
        /// The tick.
        tick: u64,
    },
}

/// Performs a theatre. `progress` is called after every tick with the number of the tick and of all ticks.
///
/// # Errors
/// When there is nothing to perform, a picture fails, or a system fails.
pub fn perform(theatre: Theatre, wanted: &Performance, mut progress: impl FnMut(u64, u64)) -> Result<Outcome, PerformError> {
    let ticks = ticks(&theatre, wanted)?;
    let demonstration = !theatre.script.is_empty();
    let scene = theatre.scene.name.clone();
    let from = in_ticks(wanted.from_s);
    let shots = shots(&theatre.script, from, ticks);
    let per_frame = wanted.ticks_per_frame.unwrap_or(TICKS_PER_FRAME).max(1);
    let cameras = if wanted.cameras.is_empty() { both_cameras().into() } else { wanted.cameras.clone() };
    let drawn = wanted.pictures.is_some() || wanted.frames.is_some();
    let output = if drawn { Output::Pictures } else { Output::None };
    let faults_before = faults();
    let mut app = simulation(theatre, Settings { output, method: wanted.method, demonstration, threads: wanted.threads });
    if let Some(recording) = &wanted.replay {
        app.insert_resource(Player::new(Play::new(recording.clone())));
    }
    if let Some(Record { file, header }) = &wanted.record {
        app.insert_resource(InputRecorder::new(RecordingWriter::create(file, header)?));
    }
    let mut recorder = Recorder::new(app.world_mut());
    for tick in 1..=ticks {
        app.update();
        if faults() > faults_before {
            return Err(PerformError::Fault { tick });
        }
        recorder.record(app.world_mut());
        if let (Some(folder), Some((_, name))) = (&wanted.pictures, shots.iter().find(|(at, _)| *at == tick)) {
            take_pictures(&mut app, both_views(folder, name))?;
        }
        if let Some(folder) = wanted.frames.as_ref().filter(|_| tick > from && (tick - from).is_multiple_of(per_frame)) {
            let number = (tick - from) / per_frame;
            let frame = |(name, of): &(String, PictureOf)| PictureRequest { path: folder.join(frame_name(number, name)), of: *of };
            take_pictures(&mut app, cameras.iter().map(frame))?;
        }
        progress(tick, ticks);
    }
    if let Some(recorder) = app.world_mut().remove_resource::<InputRecorder>() {
        recorder.finish()?;
    }
    let replayed = app
        .world_mut()
        .remove_resource::<Player>()
        .map(|Player { play, .. }| Replayed { compared: play.compared(), differs_from: play.difference().map(|d| d.tick) });
    let assessed = assessed(app.world_mut()).map(|mut assessed| {
        assessed.results.scene = scene;
        assessed.results.ended_unix_s = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
        assessed
    });
    if let (Some(folder), Some(found)) = (&wanted.pictures, &assessed)
        && let Some(from) = viewpoint(app.world(), &found.pieces)
    {
        app.insert_resource(paint(&found.pieces));
        take_pictures(&mut app, [PictureRequest { path: folder.join(MARGIN), of: PictureOf::Specimen(from) }])?;
    }
    Ok(Outcome { summary: recorder.summary(app.world_mut()), costs: recorder.costs().clone(), replayed, assessed })
}

/// How many ticks are performed.
fn ticks(theatre: &Theatre, wanted: &Performance) -> Result<u64, PerformError> {
    if let Some(recording) = &wanted.replay {
        return Ok(wanted.seconds.map_or(u64::MAX, |s| in_ticks(wanted.from_s + s).max(1)).min(recording.ticks()));
    }
    wanted.seconds.or(theatre.demonstration_s()).map(|s| in_ticks(s).max(1)).ok_or(PerformError::NothingToPerform)
}

/// Whole ticks until a time (s).
#[must_use]
pub fn in_ticks(time_s: f64) -> u64 {
    (time_s * TICKS_PER_SECOND).ceil() as u64
}

/// The ticks at which pictures are taken: the first one after `from`, the middle of the time in which a pedal is down, and the last.
fn shots(script: &Script, from: u64, ticks: u64) -> [(u64, &'static str); 3] {
    let active = |tick: &u64| {
        let time_s = *tick as f64 / TICKS_PER_SECOND;
        [Hand::Left, Hand::Right].into_iter().any(|hand| script.hand(hand, time_s).is_some_and(|key| key.active))
    };
    let cutting: Vec<u64> = (from + 1..=ticks).filter(active).collect();
    let middle = cutting.get(cutting.len() / 2).copied().unwrap_or((from + ticks) / 2);
    [(from + 1, "1_before"), (middle.clamp(from + 2, ticks.max(from + 3) - 1), "2_during"), (ticks, "3_after")]
}

/// Both views, with their names.
#[must_use]
pub fn both_cameras() -> [(String, PictureOf); 2] {
    [("global", ViewMode::Global), ("laparoscopic", ViewMode::Laparoscopic)].map(|(name, mode)| (name.to_owned(), PictureOf::View(mode)))
}

/// The name of the file of a frame, numbered from 1.
#[must_use]
pub fn frame_name(number: u64, camera: &str) -> String {
    format!("{number:05}_{camera}.png")
}

fn both_views(folder: &Path, name: &str) -> [PictureRequest; 2] {
    both_cameras().map(|(view, of)| PictureRequest { path: folder.join(format!("{name}_{view}.png")), of })
}
