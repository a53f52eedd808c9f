//! Detection against brute force; penetration depths, instruments and anatomy against closed forms; the plugin in an app.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

mod depths;
mod detection;
mod folds;
mod meshes;
mod obstacles;
mod tick;
mod tools;
