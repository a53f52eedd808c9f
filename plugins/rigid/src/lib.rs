#![doc = include_str!("../README.md")]

mod convert;
pub mod fragment;
pub mod mass;
pub mod plugin;
pub mod settings;
pub mod shape;
pub mod surface;
pub mod tool;
pub mod view;
pub mod world;

pub use plugin::RigidPlugin;
pub use settings::RigidSettings;
