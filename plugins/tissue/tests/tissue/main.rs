//! Physics with known answers.

#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

mod capsule;
mod chosen;
mod common;
mod dynamics;
mod models;
mod reference;
mod statics;
mod tick;
mod torsion;
