//! The room as a whole: recordings cut off and spoilt, and apps that are recorded, replayed and measured.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

mod files;
mod pages;
mod replay;
mod session;
