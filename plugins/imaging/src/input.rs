//! What a path holds, and its labels.

use crate::dicom_file::is_dicom;
use crate::dicom_seg::Segment;
use crate::dicom_series::{CtVolume, Gaps};
use crate::error::ImagingError;
use crate::files::{self, InputFile};
use crate::volume::{LabelChoice, LabelVolume};
use crate::{dicom_seg, dicom_series, nifti_file};
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
        /// SeriesInstanceUID or number, when the input holds several.
        series: Option<String>,
        /// What becomes of missing slices.
        gaps: Gaps,
    },
}

/// Reads a NIfTI file, a DICOM-SEG, or a folder, zip archive or DICOMDIR with a CT series or with one file of labels, whatever its name.
///
/// # Errors
/// Those of the format, and a selection that does not fit it.
pub fn read(path: &Path, selection: &Selection) -> Result<LabelVolume, ImagingError> {
    match selection {
        Selection::Threshold { low, high, series, gaps } => {
            let found = dicom_series::find(path, series.as_deref(), *gaps)?;
            let mut labels = found.read()?.threshold(path, *low, *high);
            labels.notes = found.notes;
            Ok(labels)
        }
        Selection::Labels(choices) => {
            if choices.is_empty() || choices.len() > 200 {
                let reason = "no label was chosen (or more than 200): give --label NAME=VALUE, the organ first";
                return Err(ImagingError::Format { path: path.into(), reason: reason.into() });
            }
            match files::list(path)? {
                Some(files) => labels_among(path, &files, choices),
                None => labels_of(&InputFile::OnDisk(path.into()), choices),
            }
        }
    }
}

/// The CT to draw under what [`read`] gives: the series of the selection, or the only one beside the labels. `None` when there is none or it
/// cannot be read: labels are whole without it.
#[must_use]
pub fn ct(path: &Path, selection: &Selection) -> Option<CtVolume> {
    let (series, gaps) = match selection {
        Selection::Threshold { series, gaps, .. } => (series.as_deref(), *gaps),
        Selection::Labels(_) => (None, Gaps::Interpolate),
    };
    files::list(path).ok()??;
    dicom_series::find(path, series, gaps).ok()?.read().ok()
}

/// The segments of a DICOM-SEG, or of those in a folder, archive or DICOMDIR; none for other files.
///
/// # Errors
/// Files that cannot be read.
pub fn segments(path: &Path) -> Result<Vec<Segment>, ImagingError> {
    let files = match files::list(path)? {
        Some(files) => files,
        None => vec![InputFile::OnDisk(path.into())],
    };
    let mut found = Vec::new();
    for file in files.iter().filter(|f| f.is_dicom()) {
        found.extend(dicom_seg::segments_of(file)?);
    }
    Ok(found)
}

/// The labels of the one file among several that holds some.
fn labels_among(path: &Path, files: &[InputFile], choices: &[LabelChoice]) -> Result<LabelVolume, ImagingError> {
    let is_nifti = |f: &&InputFile| {
        let name = f.name().to_string_lossy().to_lowercase();
        name.ends_with(".nii") || name.ends_with(".nii.gz")
    };
    let mut found: Vec<&InputFile> = files.iter().filter(is_nifti).collect();
    for file in files.iter().filter(|f| f.is_dicom()) {
        if dicom_seg::is_segmentation(file)? {
            found.push(file);
        }
    }
    match found.as_slice() {
        [one] => labels_of(one, choices),
        [] => {
            let reason = "holds no DICOM-SEG and no NIfTI file: give --threshold LO..HI for a CT series, or a file of labels with --label";
            Err(ImagingError::Format { path: path.into(), reason: reason.into() })
        }
        several => {
            let names: Vec<String> = several.iter().map(|f| f.name().display().to_string()).collect();
            Err(ImagingError::Format {
                path: path.into(),
                reason: format!("holds several files of labels: give one of {}", names.join(", ")),
            })
        }
    }
}

fn labels_of(file: &InputFile, choices: &[LabelChoice]) -> Result<LabelVolume, ImagingError> {
    match file {
        InputFile::OnDisk(path) if !file.is_dicom() => nifti_file::read_labels(path, choices),
        _ => {
            let bytes = file.read()?;
            if is_dicom(&bytes) {
                dicom_seg::parse(file.name(), &bytes, choices)
            } else {
                nifti_file::parse_bytes(file.name(), &bytes, choices)
            }
        }
    }
}
