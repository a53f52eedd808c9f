//! Clips on tissue and vessels that bleed, against figures worked out by hand.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

mod legs;
mod lumen;
mod meshes;
mod tick;
