//! The head-up display: which view and method, what a tick costs, what cutting has done, and every key. An app without a window leaves it
//! out.

pub mod bleeding;
pub mod devices;
pub mod figures;
pub mod help;
pub mod intent;
pub mod panel;
pub mod plugin;
pub mod tools;

pub use plugin::HudPlugin;
