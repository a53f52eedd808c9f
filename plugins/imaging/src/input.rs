//! What a path holds, and its labels.

use crate::dicom_file::is_dicom;
use crate::error::ImagingError;
use crate::volume::{LabelChoice, LabelVolume};
use crate::{dicom_seg, dicom_series, nifti_file};
use std::io::Read;
use std::path::Path;

/// What to take from the input.
#[derive(Clone, Debug, PartialEq)]
pub enum Selection {
    /// Label values or segments, the organ first.
    Labels(Vec<LabelChoice>),
    /// Hounsfield units from the first to the second, of the given series.
    Threshold {
        /// Lowest, HU.
        low: f64,
        /// Highest, HU.
        high: f64,
        /// SeriesInstanceUID or number, when the folder holds several.
        series: Option<String>,
    },
}

/// Reads a DICOM folder, a DICOM-SEG or a NIfTI file, whatever its name.
///
/// # Errors
/// Those of the format, and a selection that does not fit it.
pub fn read(path: &Path, selection: &Selection) -> Result<LabelVolume, ImagingError> {
    let format = |reason: &str| Err(ImagingError::Format { path: path.into(), reason: reason.into() });
    if path.is_dir() {
        return match selection {
            Selection::Threshold { low, high, series } => {
                Ok(dicom_series::find(path, series.as_deref())?.read()?.threshold(path, *low, *high))
            }
            Selection::Labels(_) => format("a DICOM folder has no labels: give --threshold LO..HI, or a DICOM-SEG file with --label"),
        };
    }
    let Selection::Labels(choices) = selection else {
        return format("--threshold needs the folder of a CT series, this is a file: give the folder, or --label NAME=VALUE");
    };
    if choices.is_empty() || choices.len() > 200 {
        return format("no label was chosen (or more than 200): give --label NAME=VALUE, the organ first");
    }
    let mut head = Vec::new();
    std::fs::File::open(path).and_then(|f| f.take(132).read_to_end(&mut head)).map_err(ImagingError::io(path))?;
    if is_dicom(&head) { dicom_seg::read_labels(path, choices) } else { nifti_file::read_labels(path, choices) }
}
