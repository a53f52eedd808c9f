//! `keyhole run`: a scene performed without a window.

use crate::cli::{Failure, MethodArg, video};
use crate::perform::{Outcome, PerformError, Performance, Record, Replayed, both_cameras, in_ticks, perform};
use crate::recording::{header, read};
use crate::report::folder::Folder;
use crate::simulation::TICKS_PER_SECOND;
use crate::theatre::Theatre;
use bevy::prelude::Vec3;
use indicatif::{ProgressBar, ProgressStyle};
use keyhole_assessment::recording::{Recording, RecordingError};
use keyhole_view::{PictureOf, Viewpoint, adapter_available};
use keyhole_whiteboard::{CutMethod, ViewMode};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Arguments of `keyhole run`.
#[derive(Debug, clap::Args)]
pub struct RunArgs {
    /// The scene.
    pub scene: PathBuf,
    /// Simulated time, s; without it the demonstration's length.
    #[arg(long, value_name = "S", value_parser = seconds, allow_hyphen_values = true)]
    pub seconds: Option<f64>,
    /// Save frames of both views as PNG in this folder, which must not be there or be empty; where ffmpeg is at hand, a video of each beside them.
    #[arg(long, value_name = "DIR")]
    pub frames: Option<PathBuf>,
    /// Frames of this camera instead, which may be given several times: `global`, `laparoscopic`, or a place and what it looks at, in metres.
    #[arg(long, value_name = "global|laparoscopic|X,Y,Z:X,Y,Z", value_parser = camera, requires = "frames", allow_hyphen_values = true)]
    pub camera: Vec<CameraArg>,
    /// Frames a simulated second: what 60 is a multiple of.
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = frame_rate, requires = "frames")]
    pub frame_rate: u16,
    /// Leave a report in this folder, which must not be there or be empty.
    #[arg(long, value_name = "DIR")]
    pub report: Option<PathBuf>,
    /// Another release policy than the scene's.
    #[arg(long, value_enum)]
    pub method: Option<MethodArg>,
    /// Number of threads; the result does not depend on it.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Record what comes from outside in each tick to this file, which must not be there.
    #[arg(long, value_name = "FILE")]
    pub record: Option<PathBuf>,
    /// Play a recording instead of the demonstration.
    #[arg(long, value_name = "FILE", conflicts_with = "method")]
    pub replay: Option<PathBuf>,
    /// Begin at this time of the recording, s: what comes before is simulated, and not drawn. --seconds counts from there.
    #[arg(long, value_name = "S", value_parser = moment, requires = "replay", allow_hyphen_values = true)]
    pub from: Option<f64>,
    /// Fail unless the replay has the same bits as the recording after every tick.
    #[arg(long, requires = "replay")]
    pub verify: bool,
}

/// What a run is to leave behind, and how.
#[derive(Clone, Debug, Default)]
pub(crate) struct Wanted {
    pub seconds: Option<f64>,
    pub frames: Option<PathBuf>,
    pub cameras: Vec<(String, PictureOf)>,
    pub frame_rate: Option<u16>,
    pub report: Option<PathBuf>,
    pub method: Option<CutMethod>,
    pub threads: Option<usize>,
    pub record: Option<Record>,
    pub replay: Option<Recording>,
    pub from_s: f64,
    pub verify: bool,
}

/// Performs a scene and prints a summary.
///
/// # Errors
/// Status 2 for a scene that is not as it should be or a folder that is in use; status 1 when the performance fails.
pub fn run(args: RunArgs) -> Result<(), Failure> {
    let theatre = Theatre::load(&args.scene).map_err(Failure::input)?;
    let record = args.record.map(|file| header(&args.scene, &theatre).map(|header| Record { file, header }));
    let replay = args.replay.map(|file| read(&file, &args.scene, &theatre)).transpose().map_err(Failure::input)?;
    let from_s = args.from.map_or(Ok(0.0), |from| within(from, replay.as_ref()))?;
    let wanted = Wanted {
        record: record.transpose().map_err(Failure::input)?,
        replay,
        from_s,
        verify: args.verify,
        seconds: args.seconds,
        frames: args.frames,
        cameras: named(args.camera),
        frame_rate: Some(args.frame_rate),
        report: args.report,
        method: args.method.map(Into::into),
        threads: args.threads.map(usize::from),
    };
    with_report(theatre, &wanted)
}

/// Performs a theatre, leaves what is wanted and prints a summary.
pub(crate) fn with_report(theatre: Theatre, wanted: &Wanted) -> Result<(), Failure> {
    if let Some(threads) = wanted.threads {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build_global().map_err(Failure::job)?;
    }
    let begin = |place: &PathBuf| {
        Folder::begin(place).map_err(|e| Failure::input(format!("{}: {e}", place.display()))).map(|folder| (folder, place.clone()))
    };
    let report = wanted.report.as_ref().map(begin).transpose()?;
    let frames = wanted.frames.as_ref().map(begin).transpose()?;
    let drawn_with = match (&frames, &report) {
        (Some(_), _) => adapter_available().map_err(Failure::job)?,
        (None, Some(_)) => adapter_available().unwrap_or_else(|why| format!("none: {why}")),
        (None, None) => "none: no report was asked for".into(),
    };
    let pictures = match &report {
        Some((folder, _)) if !drawn_with.starts_with("none: ") => {
            let pictures = folder.path().join("pictures");
            std::fs::create_dir(&pictures).map_err(Failure::job)?;
            Some(pictures)
        }
        _ => None,
    };
    let performance = Performance {
        seconds: wanted.seconds,
        method: wanted.method,
        threads: wanted.threads,
        pictures,
        frames: frames.as_ref().map(|(folder, _)| folder.path().to_owned()),
        cameras: wanted.cameras.clone(),
        ticks_per_frame: wanted.frame_rate.map(|rate| u64::from(60 / rate.max(1))),
        record: wanted.record.clone(),
        replay: wanted.replay.clone(),
        from_s: wanted.from_s,
    };
    let bar = progress_bar();
    let outcome = perform(theatre, &performance, |tick, ticks| {
        bar.set_length(ticks);
        bar.set_position(tick);
    });
    bar.finish_and_clear();
    let mut outcome = outcome.map_err(|e| match e {
        PerformError::NothingToPerform | PerformError::Recording(RecordingError::File { .. }) => Failure::input(e),
        PerformError::Picture(_) | PerformError::Fault { .. } | PerformError::Recording(_) => Failure::job(e),
    })?;
    outcome.summary.pictures = drawn_with;
    say(&outcome.summary.markdown(&outcome.costs));
    if let Some(task) = outcome.assessed.as_ref().and_then(|a| a.results.task.as_ref()) {
        say(&task.sentence());
    }
    for (folder, place) in [frames].into_iter().flatten() {
        let cameras = if wanted.cameras.is_empty() { both_cameras().into() } else { wanted.cameras.clone() };
        say(&video::make(folder.path(), &place, cameras.iter().map(|(name, _)| name.as_str()), wanted.frame_rate.unwrap_or(10)));
        folder.finish().map_err(|e| Failure::job(format!("{}: {e}", place.display())))?;
    }
    if let Some((folder, place)) = report {
        let in_place = |e: std::io::Error| Failure::job(format!("{}: {e}", place.display()));
        write(folder.path(), &outcome).map_err(in_place)?;
        say(&format!("Report: {}", folder.finish().map_err(in_place)?.display()));
    }
    if let Some(replayed) = outcome.replayed {
        let verdict = replay_verdict(replayed);
        if wanted.verify && replayed.differs_from.is_some() {
            return Err(Failure::job(verdict));
        }
        say(&verdict);
    }
    if outcome.summary.quarantined.is_empty() {
        Ok(())
    } else {
        let organs = outcome.summary.quarantined.join(", ");
        Err(Failure::job(format!("{organs}: left the finite numbers and was frozen; more substeps or a softer material may help")))
    }
}

fn write(folder: &Path, outcome: &Outcome) -> std::io::Result<()> {
    let json = serde_json::to_string_pretty(&outcome.summary)?;
    std::fs::write(folder.join("summary.json"), json + "\n")?;
    if let Some(assessed) = &outcome.assessed {
        assessed.results.write(folder, assessed.margin.as_ref())?;
    }
    std::fs::write(folder.join("summary.md"), outcome.summary.markdown(&outcome.costs))
}

/// Whether a replay had the bits of its recording, in words.
pub(crate) fn replay_verdict(replayed: Replayed) -> String {
    let Replayed { compared, differs_from } = replayed;
    match differs_from {
        None => format!("Replay: the same bits after each of {compared} ticks."),
        Some(tick) => {
            format!("the replay differs from its recording from tick {tick} of {compared} on: was it made by another build of the program?")
        }
    }
}

/// Prints a line. A reader that has had enough and closed the pipe is no reason to fail.
pub(crate) fn say(line: &str) {
    drop(writeln!(std::io::stdout(), "{line}"));
}

/// A bar on a terminal, nothing elsewhere.
fn progress_bar() -> ProgressBar {
    let bar = ProgressBar::new(0);
    if let Ok(style) = ProgressStyle::with_template("{wide_bar} tick {pos} of {len}, {eta} left") {
        bar.set_style(style);
    }
    bar
}

/// A time of at least one tick and at most a day, s.
pub(crate) fn seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(s) if s > 0.0 && s <= 86_400.0 => Ok(s),
        _ => Err("expected a number of seconds above 0 and at most 86400".into()),
    }
}

/// A time since the start, s: at most a day.
pub(crate) fn moment(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(s) if (0.0..=86_400.0).contains(&s) => Ok(s),
        _ => Err("expected a number of seconds from 0 to 86400".into()),
    }
}

/// A time that a recording has.
pub(crate) fn within(from_s: f64, replay: Option<&Recording>) -> Result<f64, Failure> {
    let ticks = replay.map_or(0, Recording::ticks);
    if in_ticks(from_s) < ticks {
        return Ok(from_s);
    }
    let length_s = ticks as f64 / TICKS_PER_SECOND;
    Err(Failure::input(format!("--from {from_s}: the recording is {length_s:.2} s long; give a time before its end")))
}

/// A camera as it is named on the command line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraArg(PictureOf);

fn camera(text: &str) -> Result<CameraArg, String> {
    let triple = |text: &str| -> Option<Vec3> {
        let values: Vec<f32> = text.split(',').map(|v| v.trim().parse().ok().filter(|v: &f32| v.is_finite())).collect::<Option<_>>()?;
        <[f32; 3]>::try_from(values).ok().map(Vec3::from_array)
    };
    match text {
        "global" => Ok(CameraArg(PictureOf::View(ViewMode::Global))),
        "laparoscopic" => Ok(CameraArg(PictureOf::View(ViewMode::Laparoscopic))),
        place => place
            .split_once(':')
            .and_then(|(eye, target)| Some(Viewpoint { eye: triple(eye)?, target: triple(target)? }))
            .filter(|place| place.eye != place.target)
            .map(|place| CameraArg(PictureOf::From(place)))
            .ok_or_else(|| "expected `global`, `laparoscopic`, or where the camera is and what it looks at: 0.2,0.1,0.4:0,0,0".into()),
    }
}

/// Cameras with names for their files; those that are places are numbered.
fn named(cameras: Vec<CameraArg>) -> Vec<(String, PictureOf)> {
    let mut places = 0;
    let mut name = |CameraArg(of)| match of {
        PictureOf::View(ViewMode::Global) => ("global".to_owned(), of),
        PictureOf::View(ViewMode::Laparoscopic) => ("laparoscopic".to_owned(), of),
        _ => {
            places += 1;
            (format!("camera{places}"), of)
        }
    };
    cameras.into_iter().map(&mut name).collect()
}

fn frame_rate(text: &str) -> Result<u16, String> {
    let rate: Option<u16> = text.parse().ok().filter(|rate| *rate > 0 && 60 % rate == 0);
    rate.ok_or_else(|| "expected a number of frames a second that 60 is a multiple of: 10, 15, 20, 30, 60".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_are_views_or_places() {
        let place = Viewpoint { eye: Vec3::new(0.2, -0.1, 0.4), target: Vec3::ZERO };
        assert_eq!(camera("0.2,-0.1,0.4:0,0,0"), Ok(CameraArg(PictureOf::From(place))));
        let names = named(["laparoscopic", "0,0,1:0,0,0", "0,1,1:0,0,0"].into_iter().flat_map(camera).collect());
        assert_eq!(names.iter().map(|n| n.0.as_str()).collect::<Vec<_>>(), ["laparoscopic", "camera1", "camera2"]);
        for wrong in ["", "top", "1,2,3", "1,2:3,4,5", "1,2,3:1,2,3", "1,2,nan:0,0,0"] {
            assert!(camera(wrong).is_err(), "{wrong}");
        }
        assert!(frame_rate("15") == Ok(15) && frame_rate("25").is_err() && frame_rate("0").is_err());
    }
}
