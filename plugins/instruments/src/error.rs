//! What is wrong with a script.

use keyhole_whiteboard::Hand;

/// A script that cannot be performed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ScriptError {
    /// Keyframes out of order.
    #[error("{track}: keyframe {index} is at {time_s} s, not after the one before it at {before_s} s: sort the keyframes by time")]
    Order {
        /// Which track.
        track: String,
        /// Index of the keyframe in the track.
        index: usize,
        /// Its time, s.
        time_s: f64,
        /// Time of the keyframe before, s.
        before_s: f64,
    },
    /// A number that is not finite.
    #[error("{track}: keyframe {index} holds a number that is not finite: write finite numbers")]
    NotFinite {
        /// Which track.
        track: String,
        /// Index of the keyframe in the track.
        index: usize,
    },
    /// A line of a script file that cannot be read.
    #[error("line {line}: {what}")]
    Line {
        /// Line, from 1.
        line: u64,
        /// What was expected.
        what: String,
    },
}

/// How messages name a hand's track.
pub(crate) fn track_name(hand: Hand) -> String {
    match hand {
        Hand::Left => "left hand".into(),
        Hand::Right => "right hand".into(),
    }
}
