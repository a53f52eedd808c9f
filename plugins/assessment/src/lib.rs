//! Recording, replay, metrics and scores.
//!
//! [`recording`] takes down what comes from outside and plays it to the same bits.

pub mod recording;
