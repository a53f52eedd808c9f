#![doc = include_str!("../README.md")]

pub mod blade;
pub mod cutter;
mod grid;
pub mod kernel;
mod refine;
mod release;
mod separate;
pub mod sheet;
mod snap;
mod stroke;

pub use blade::{BladeError, BladeSample, read_blade};
pub use cutter::{Cutter, Operations, StepReport};
