//! Devices that are not there, through the code that real ones go through.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

mod common;
mod faults;
mod fuzz;
mod stream;
