//! The head-up display: which view and method, what a tick costs, what cutting has done, and every key. An app without a window leaves it
//! out.

pub mod bleeding;
pub mod costs;
pub mod devices;
pub mod figures;
pub mod guide;
pub mod help;
pub mod intent;
pub mod panel;
pub mod plugin;
pub mod replay;
pub mod results;
pub mod start;
pub mod tools;

pub use guide::{Guide, Notices};
pub use plugin::{HudEye, HudPlugin, hud_over_others};
pub use replay::ReplayBar;
pub use results::{ResultSheet, ResultTable, ResultsScreen};
pub use start::{SceneCard, StartScreen};
