//! Scan to volume mesh: NIfTI and DICOM in, labels, a smooth field, tetrahedra out.
//!
//! An offline room: no engine, no schedule.

pub mod components;
pub mod distance;
pub mod error;
pub mod field;
pub mod frame;
mod lattice;
pub mod nifti_file;
pub mod phantom;
pub mod pipeline;
pub mod report;
mod stencil;
pub mod stuffing;
pub mod surface_distance;
mod topology;
pub mod volume;

pub use components::{ComponentChoice, ComponentReport};
pub use error::ImagingError;
pub use pipeline::{Centring, MeshOptions, Stage};
pub use report::MeshReport;
pub use volume::{LabelChoice, LabelVolume};
