//! Videos of frames that have been saved, where ffmpeg is at hand.

use std::path::Path;
use std::process::{Command, Stdio};

/// Makes `CAMERA.mp4` of each camera's frames in a folder that will be `place`, and says so in a line; where there is no ffmpeg, or it fails, says that.
pub(crate) fn make<'a>(folder: &Path, place: &Path, cameras: impl Iterator<Item = &'a str>, frame_rate: u16) -> String {
    let mut made = Vec::new();
    for camera in cameras {
        let name = format!("{camera}.mp4");
        let rate = frame_rate.to_string();
        let frames = format!("%05d_{camera}.png");
        let told = ["-y", "-loglevel", "error", "-framerate", &rate, "-i", &frames, "-pix_fmt", "yuv420p", &name];
        let run = Command::new("ffmpeg").current_dir(folder).args(told).stdin(Stdio::null()).stdout(Stdio::null()).status();
        match run {
            Ok(status) if status.success() => made.push(place.join(name).display().to_string()),
            Ok(status) => return format!("Video: ffmpeg failed ({status}); the frames in {} are whole.", place.display()),
            Err(why) => return format!("Video: none, for ffmpeg is not at hand ({why}); the frames are in {}.", place.display()),
        }
    }
    format!("Video: {}.", made.join(", "))
}
