//! The report of a performance: what was cut, what came of it, what it cost, and whether it is the same as last time.
//!
//! [`recorder`] watches an app tick by tick, [`digest`] puts a state into one number, [`cost`] sums up what ticks cost, [`folder`] writes
//! a folder that appears under its name only when it is complete, [`summary`] is what stands in it.

pub mod bleeding;
pub mod cost;
pub mod digest;
pub mod folder;
pub mod recorder;
pub mod summary;

pub use recorder::Recorder;
pub use summary::Summary;
