//! Physics with known answers.

#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

mod common;
mod dynamics;
mod statics;
mod tick;
