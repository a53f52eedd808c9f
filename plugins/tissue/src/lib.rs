#![doc = include_str!("../README.md")]

pub mod adopt;
pub mod beam;
pub mod body;
pub mod clusters;
pub mod colouring;
pub mod element;
pub mod gradients;
pub mod graph;
pub mod guard;
pub mod hold;
pub mod implicit;
pub mod material;
pub mod multilevel;
pub mod newton;
pub mod plugin;
pub mod rescue;
pub mod rows;
pub mod settings;
pub mod sleep;
pub mod xpbd;

pub use body::{Body, Momentum};
pub use element::Element;
pub use guard::Guard;
pub use hold::Hold;
pub use material::{MaterialError, NeoHookean};
pub use plugin::{Quarantined, TissueBody, TissuePlugin, TissueReport};
pub use settings::{Solver, TissueSettings};
