#![doc = include_str!("../README.md")]

pub mod advice;
pub mod calibrate;
pub mod descriptor;
pub mod error;
pub mod filter;
pub mod force;
mod guard;
pub mod hidraw;
pub mod keeper;
pub mod mapping;
pub mod plugin;
pub mod profile;
pub mod report;
mod rules;
pub mod service;
pub mod session;
pub mod shipped;
pub mod source;
pub mod transport;
pub mod virtual_bus;
pub mod watch;

pub use descriptor::Layout;
pub use error::{DescriptorError, FitError, ProfileError, TransportError};
pub use hidraw::HidBus;
pub use mapping::{Dof, HandReading, Mapping};
pub use plugin::HidPlugin;
pub use profile::Profile;
pub use session::{Line, Session, Snapshot};
pub use transport::{Bus, DeviceInfo, Transport};
pub use virtual_bus::{VirtualBus, VirtualDevice, Wire, WireField};
