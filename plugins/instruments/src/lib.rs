//! Instruments: trocar kinematics, the trainee's hands on mouse and keyboard, the scripted demonstration, tool models, jaws and blades.
//!
//! [`kinematics`], [`hands`], [`mod@device`], [`script`], [`mod@line`], [`mod@proxy`], [`force`] and [`tools`] are plain functions over plain data; [`plugin`] is the glue. Whatever moves an
//! instrument, a mouse, a device or a script, moves its [`TrocarState`], and the pose follows from that and
//! from what holds the instrument off the hand ([`mod@proxy`]): the shaft cannot leave its port.

mod applier;
pub mod device;
pub mod error;
pub mod exchange;
pub mod force;
pub mod hands;
pub mod kinematics;
pub mod line;
mod model;
pub mod plugin;
pub mod proxy;
pub mod script;
mod suction;
pub mod tools;

pub use device::DeviceClutch;
pub use error::ScriptError;
pub use hands::{HandSettings, KEYS};
pub use kinematics::{PortFrame, TrocarLimits, TrocarState};
pub use plugin::InstrumentsPlugin;
pub use proxy::{Proxy, ProxySettings};
pub use script::{HandKey, HandTrack, Script, ViewKey};
pub use tools::{cutting_line, tool_model, working_reach};
