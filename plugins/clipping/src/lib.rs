#![doc = include_str!("../README.md")]

pub mod bleed;
pub mod hold;
pub mod legs;
pub mod locate;
pub mod lumen;
pub mod plugin;
pub mod pool;
pub mod settings;

pub use plugin::ClippingPlugin;
pub use settings::ClipSettings;
