//! The room as a whole: recordings cut off and spoilt, and an app that is recorded and replayed.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

mod files;
mod replay;
