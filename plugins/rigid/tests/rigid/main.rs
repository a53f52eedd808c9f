//! Rigid bodies against closed forms, soft bodies that become rigid, and the plugin in an app.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

mod fragment;
mod laws;
mod meshes;
mod shapes;
mod tick;
