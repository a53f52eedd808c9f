//! The phantom: an abdomen of smooth implicit functions, sampled as a CT with its segmentation.
//!
//! Its own frame is the patient's (LPS+, mm) with the origin at the centre of the left kidney, so that everything made of it shares one
//! frame in which the organ lies at the origin.

pub mod anatomy;
pub mod sampling;
pub mod shape;

pub use anatomy::{Structure, abdomen};
pub use sampling::{PhantomSettings, PhantomVolume, sample};
