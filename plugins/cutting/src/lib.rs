#![doc = include_str!("../README.md")]

pub mod batch;
mod before;
pub mod blade;
mod course;
pub mod cutter;
pub mod fragment;
mod grid;
mod kerf;
pub mod kernel;
mod lips;
mod locate;
pub mod material_map;
mod meet;
mod plugin;
mod refine;
mod release;
mod separate;
pub mod sheet;
pub(crate) mod sides;
mod snap;
mod step;
mod stroke;

pub use batch::{BatchCut, BatchRow, Moved};
pub use blade::{BladeError, BladeSample, read_blade};
pub use course::BladeId;
pub use cutter::{Cutter, Operations, StepReport};
pub use plugin::CuttingPlugin;
