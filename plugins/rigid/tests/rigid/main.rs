//! Rigid bodies against closed forms.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

mod laws;
