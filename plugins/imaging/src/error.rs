//! What can be wrong with a scan or with the job asked of it.

use std::path::PathBuf;

/// Why a scan could not become a mesh. Every message names the place, what was expected and what to do.
#[derive(Debug, thiserror::Error)]
pub enum ImagingError {
    /// A file or folder that could not be opened, read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file that is neither NIfTI nor DICOM, or a broken one.
    #[error("{path}: {reason}")]
    Format {
        /// The file.
        path: PathBuf,
        /// What was found, what was expected and what to do.
        reason: String,
    },
    /// A gzip or raw file that ends before its voxels do.
    #[error("{path}: the file ends after {found} of {expected} bytes of voxels: it is truncated, copy or export it again")]
    Truncated {
        /// The file.
        path: PathBuf,
        /// Bytes that are there.
        found: u64,
        /// Bytes that the header declares.
        expected: u64,
    },
    /// A DICOM element that is missing or has a value nothing can be done with.
    #[error("{path}: element {element}: {reason}")]
    Element {
        /// The file.
        path: PathBuf,
        /// Tag and name of the element.
        element: String,
        /// What was found, what was expected and what to do.
        reason: String,
    },
    /// A series whose slices do not make a volume.
    #[error("{path}: {reason}")]
    Irregular {
        /// The slice at fault, or the folder.
        path: PathBuf,
        /// Which slices, what was expected and what to do.
        reason: String,
    },
    /// A label value or segment that the file does not hold.
    #[error("label {name}={value}: the input holds no such value; it holds {present}: give one of those")]
    UnknownLabel {
        /// Name given to the label.
        name: String,
        /// Value or segment number asked for.
        value: i64,
        /// What there is.
        present: String,
    },
    /// Nothing to mesh.
    #[error("{what} is empty: no voxel of the {dims:?} volume belongs to it; choose other label values or another threshold")]
    Empty {
        /// The label or the threshold.
        what: String,
        /// Voxels along each axis.
        dims: [usize; 3],
    },
    /// A component that is not there.
    #[error("component {wanted} was asked for, but there are {count}, numbered from 0 by volume: {list}")]
    NoComponent {
        /// The number asked for.
        wanted: usize,
        /// How many there are.
        count: usize,
        /// The components.
        list: String,
    },
    /// A seed outside every component.
    #[error("seed {seed:?} (patient LPS, mm) is voxel {voxel:?}, which is in no component: choose a point inside the organ")]
    Seed {
        /// The seed, mm.
        seed: [f64; 3],
        /// The voxel it falls into.
        voxel: [i64; 3],
    },
    /// A cell that is no positive length, or one so small that the lattice would not fit into memory.
    #[error("a lattice cell of {edge_mm} mm on a body of {extent_mm:?} mm: {reason}")]
    Edge {
        /// The cell, mm.
        edge_mm: f64,
        /// Extent of the body, mm.
        extent_mm: [f64; 3],
        /// What is wrong and what to do.
        reason: &'static str,
    },
    /// The lattice does not resolve the body.
    #[error(
        "the body is thinner than the lattice cell of {edge_mm} mm near {place_mm:?} (patient LPS, mm): {reason}; use a smaller --edge"
    )]
    Unresolved {
        /// The cell, mm.
        edge_mm: f64,
        /// Where, mm.
        place_mm: [f64; 3],
        /// What happened there.
        reason: &'static str,
    },
    /// Voxel axes that are too far from perpendicular to be resampled.
    #[error("{path}: the voxel axes are {degrees:.2} degrees off a right angle, more than any tilt of a gantry: repair the header")]
    Sheared {
        /// The file or folder.
        path: PathBuf,
        /// Deviation from a right angle, degrees.
        degrees: f64,
    },
}

impl ImagingError {
    /// An error of the file system at a path.
    pub(crate) fn io(path: &std::path::Path) -> impl FnOnce(std::io::Error) -> Self + '_ {
        move |source| Self::Io { path: path.into(), source }
    }
}
