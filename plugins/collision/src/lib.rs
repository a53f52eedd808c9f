//! Collision.

pub(crate) mod cells;
pub mod detect;
pub mod inside;
pub mod shape;

pub use detect::{Body, Detector, Grading, Hit, mean_edge_m};
pub use inside::Weights;
pub use shape::{Role, Shape};
