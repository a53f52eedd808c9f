//! Scenes: the format, its loader, its checker, and the starter that `keyhole scene new` writes.
//!
//! A scene is a RON file, version [`VERSION`], in SI units but for angles, which are degrees because people write them. Paths in it are
//! relative to the file. [`load()`] gives the [`Scene`] with paths that can be opened; [`check()`] lists every problem with its line;
//! [`starter::new_scene`] writes a scene that plays. Nothing here knows the engine's app.

pub mod check;
pub mod ellipsoid;
pub mod error;
pub mod format;
pub mod hilum;
pub mod load;
mod locate;
pub mod place;
mod rules;
pub mod section;
pub mod solid;
pub mod starter;
pub mod surface;
pub mod suture;
pub mod task;
pub mod vessel;

pub use check::{Problem, check};
pub use error::SceneError;
pub use format::*;
pub use load::{load, parse};
pub use task::{SceneBox, SceneGoal, SceneMishap, ScenePenalty, ScenePublished, SceneScore, SceneTask, SceneWant};
pub use vessel::{SceneClips, SceneVessel, SceneVesselEnd};
