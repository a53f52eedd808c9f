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

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;

    fn output(folder: &Path, program: &str, arguments: &[&str]) -> Vec<u8> {
        let run = Command::new(program).current_dir(folder).args(arguments).stdin(Stdio::null()).output().unwrap();
        assert!(run.status.success(), "{program}: {}", String::from_utf8_lossy(&run.stderr));
        run.stdout
    }

    /// The grey values of one frame of a film or picture.
    fn grey(folder: &Path, file: &str, frame: u32) -> Vec<u8> {
        let picked = format!("select=eq(n\\,{frame})");
        output(
            folder,
            "ffmpeg",
            &["-loglevel", "error", "-i", file, "-vf", &picked, "-frames:v", "1", "-f", "rawvideo", "-pix_fmt", "gray", "-"],
        )
    }

    /// A film has every frame of its camera, in order, at the rate asked for, and no other camera's; each shows what was saved. Where there is no ffmpeg, that is said.
    #[test]
    fn a_film_shows_the_frames_in_their_order() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        if Command::new("ffmpeg").arg("-version").stdout(Stdio::null()).status().is_err() {
            let told = make(folder, folder, ["global"].into_iter(), 15);
            assert!(told.contains("ffmpeg is not at hand"), "{told}");
            return println!("no ffmpeg here: no film was made");
        }
        for (camera, source) in [("global", "testsrc=size=64x36:rate=1"), ("camera1", "mandelbrot=size=64x36:rate=1")] {
            let names = format!("%05d_{camera}.png");
            output(folder, "ffmpeg", &["-loglevel", "error", "-f", "lavfi", "-i", source, "-frames:v", "7", &names]);
        }
        let told = make(folder, Path::new("place"), ["global", "camera1"].into_iter(), 15);
        assert!(told.contains("global.mp4") && told.contains("camera1.mp4"), "{told}");
        let entries =
            ["-v", "error", "-count_frames", "-show_entries", "stream=width,height,r_frame_rate,nb_read_frames", "-of", "csv=p=0"];
        for camera in ["global", "camera1"] {
            let film = format!("{camera}.mp4");
            let told = output(folder, "ffprobe", &[&entries[..], &[&film]].concat());
            assert_eq!(String::from_utf8_lossy(&told).trim(), "64,36,15/1,7");
            for frame in [0, 6] {
                let (seen, saved) = (grey(folder, &film, frame), grey(folder, &format!("{:05}_{camera}.png", frame + 1), 0));
                let apart: f64 = seen.iter().zip(&saved).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / saved.len() as f64;
                assert!(seen.len() == 64 * 36 && apart < 8.0, "{camera} {frame}: {apart} grey values apart");
            }
        }
    }
}
