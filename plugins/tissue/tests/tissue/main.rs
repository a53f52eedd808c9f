//! Physics with known answers.

#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

mod capsule;
mod chosen;
mod common;
mod contact;
mod dynamics;
mod finder;
mod models;
mod reference;
mod statics;
mod tick;
mod torsion;
