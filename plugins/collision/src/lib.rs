#![doc = include_str!("../README.md")]

pub mod anatomy;
mod calm;
pub(crate) mod cells;
pub mod contacts;
mod convert;
pub mod depth;
pub mod detect;
pub mod folds;
pub mod fresh;
pub mod inside;
pub mod meet;
pub mod pad;
mod parts;
pub mod patches;
pub mod plugin;
pub mod rest;
pub mod settings;
pub mod shape;
mod sweep;
pub mod tool;
pub mod touch;
pub mod walk;
pub mod within;

pub use depth::{Depths, Penetration};
pub use detect::{Body, Detector, Grading, Hit, mean_edge_m, mean_rest_edge_m};
pub use folds::Folds;
pub use fresh::FreshCuts;
pub use inside::Weights;
pub use patches::Patches;
pub use plugin::{CollisionPlugin, CollisionReport};
pub use rest::Rest;
pub use settings::{CollisionSettings, SelfCollision};
pub use shape::{Role, Shape};
pub use walk::{Deformed, Exit};
