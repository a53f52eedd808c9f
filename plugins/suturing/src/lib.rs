#![doc = include_str!("../README.md")]

pub mod chain;
pub mod drive;
pub mod grips;
pub mod knots;
pub mod plugin;
pub mod settings;
pub mod skyline;
pub mod stitch;
pub mod tissue;

pub use plugin::SuturingPlugin;
pub use settings::SutureSettings;
