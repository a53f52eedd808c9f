//! Why a recording cannot be written or played.

use std::path::PathBuf;

/// What is wrong with a recording.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file cannot be read or written.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The stream that is written to failed.
    #[error("the recording cannot be written: {0}; what was written before can be played")]
    Write(#[from] std::io::Error),
    /// Something cannot be put into bytes.
    #[error("the recording cannot be written: {0}")]
    Encode(postcard::Error),
    /// It is no recording.
    #[error("expected a recording of Keyhole, which begins with `keyhole` and a zero byte: choose a file made by --record")]
    NoRecording,
    /// Another version has made it.
    #[error(
        "recorded by Keyhole {program} (format {format}), and this is Keyhole {} (format {}): the same bits come from the same version alone; replay it with Keyhole {program}",
        super::header::PROGRAM,
        super::header::FORMAT
    )]
    OtherVersion {
        /// The program's version.
        program: String,
        /// Version of the format.
        format: u32,
    },
    /// It breaks off before its first tick.
    #[error("the recording breaks off at byte {byte}, before its header is complete: nothing of it can be played")]
    NoHeader {
        /// Where.
        byte: usize,
    },
    /// The scene is not the one that was recorded.
    #[error("the recording was made in another scene than {scene}: {}; restore what was recorded, or record anew", differences.join("; "))]
    OtherScene {
        /// The scene that it should be played in.
        scene: String,
        /// What differs.
        differences: Vec<String>,
    },
    /// Something else of what the simulation starts with differs.
    #[error("the recording was made with {name} {recorded}, and here it is {here}")]
    OtherSettings {
        /// What.
        name: String,
        /// Its value in the recording.
        recorded: String,
        /// Its value here.
        here: String,
    },
}
