#![doc = include_str!("../README.md")]

pub mod chain;
pub mod drive;
pub mod grips;
pub mod knots;
pub mod plugin;
pub mod settings;
pub mod skyline;
mod slide;
mod solve;
pub mod stitch;
mod tie;
pub mod tissue;

pub use plugin::SuturingPlugin;
pub use settings::SutureSettings;
