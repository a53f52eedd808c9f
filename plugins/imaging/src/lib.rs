#![doc = include_str!("../README.md")]

pub mod cleave;
pub mod components;
pub mod contact_sheet;
pub mod decimate;
mod dicom_codecs;
pub mod dicom_file;
mod dicom_pixels;
pub mod dicom_seg;
pub mod dicom_series;
pub mod dicom_write;
mod disjoint_sets;
pub mod distance;
pub mod drawn;
pub mod error;
pub mod field;
pub mod files;
pub mod frame;
pub mod glb;
mod graded;
pub mod input;
mod lattice;
pub mod nifti_file;
mod passage;
pub mod phantom;
pub mod pipeline;
mod publish;
pub mod report;
pub mod resample;
mod stencil;
pub mod stuffing;
#[cfg(test)]
mod stuffing_bound;
pub mod surface;
pub mod surface_distance;
mod topology;
pub mod volume;

pub use components::{ComponentChoice, ComponentReport};
pub use error::ImagingError;
pub use input::Selection;
pub use pipeline::{Centring, MeshOptions, Stage};
pub use report::MeshReport;
pub use volume::{LabelChoice, LabelVolume};
