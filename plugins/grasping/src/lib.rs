#![doc = include_str!("../README.md")]

pub mod bruise;
pub mod friction;
pub mod locate;
pub mod pads;
pub mod plugin;
pub mod settings;

pub use plugin::GraspingPlugin;
pub use settings::GraspSettings;
