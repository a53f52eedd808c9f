#![doc = include_str!("../README.md")]

pub mod adopt;
pub mod beam;
pub mod body;
pub mod colouring;
pub mod conjugate;
pub mod element;
pub mod graph;
pub mod guard;
pub mod hold;
pub mod material;
pub mod membrane;
pub mod metric;
pub mod model;
pub mod plugin;
pub mod reference;
pub mod rescue;
pub mod semi_implicit;
pub mod settings;
pub mod teschner;
pub mod vbd;
pub mod xpbd;

pub use body::{Body, Momentum};
pub use element::Element;
pub use guard::Guard;
pub use hold::Hold;
pub use material::{MaterialError, NeoHookean};
pub use membrane::{Capsule, Membrane};
pub use model::{ModelState, TissueModel};
pub use plugin::{Quarantined, TissueBody, TissuePlugin, TissueReport};
pub use settings::{Solver, TissueSettings};
pub use teschner::TeschnerSettings;
pub use vbd::VbdSettings;
pub use xpbd::{Constraints, XpbdSettings};
