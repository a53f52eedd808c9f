//! A folder with a CT series: slices in order, spacing from their positions, Hounsfield units, a threshold.

use crate::dicom_file::{self, Elements, Pixels, is_dicom};
use crate::error::ImagingError;
use crate::volume::LabelVolume;
use dicom_dictionary_std::{tags, uids};
use dicom_pixeldata::{ConvertOptions, ModalityLutOption, PixelDecoder};
use glam::{DAffine3, DMat3, DVec3};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Part of the median spacing by which a slice may be off its place.
const SPACING_TOLERANCE: f64 = 0.05;
/// Decimals to which orientations and pixel spacings of one stack agree.
const AGREE: f64 = 1e4;

/// What is known of a slice without its pixels.
#[derive(Clone, Debug)]
struct Slice {
    path: PathBuf,
    position: DVec3,
    orientation: [f64; 6],
    spacing: [f64; 2],
}

/// What the slices of one stack share. Numbers are rounded so that they can be compared.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct StackKey {
    series: String,
    rows: usize,
    columns: usize,
    orientation: [i64; 6],
    spacing: [i64; 2],
}

/// A regular stack of slices, not yet decoded.
#[derive(Clone, Debug)]
pub struct Series {
    folder: PathBuf,
    /// SeriesInstanceUID.
    pub uid: String,
    slices: Vec<PathBuf>,
    /// Columns, rows, slices.
    pub dims: [usize; 3],
    /// From voxel indices to patient LPS, mm.
    pub voxel_to_lps: DAffine3,
}

/// A decoded CT.
#[derive(Clone, Debug)]
pub struct CtVolume {
    /// Columns, rows, slices.
    pub dims: [usize; 3],
    /// From voxel indices to patient LPS, mm.
    pub voxel_to_lps: DAffine3,
    /// Hounsfield units, x fastest.
    pub hu: Vec<f32>,
}

/// Finds the CT series of a folder (not of folders in it) and puts its slices in order. `choice` is a SeriesInstanceUID or the number of a
/// series in the order of their UIDs, needed only when there are several. Images of another size or orientation than most (localisers)
/// are left out.
///
/// # Errors
/// No series, several without a choice, slices that are missing, irregular or tilted: with the slices' names.
pub fn find(folder: &Path, choice: Option<&str>) -> Result<Series, ImagingError> {
    let irregular = |reason: String| ImagingError::Irregular { path: folder.into(), reason };
    let mut files: Vec<PathBuf> = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(ImagingError::io(folder))? {
        let path = entry.map_err(ImagingError::io(folder))?.path();
        let mut head = Vec::new();
        if path.is_file() && std::fs::File::open(&path).and_then(|f| f.take(132).read_to_end(&mut head)).is_ok() && is_dicom(&head) {
            files.push(path);
        }
    }
    files.sort();
    let slices: Vec<Option<(StackKey, Slice)>> = files.par_iter().map(|p| slice(p)).collect::<Result<_, _>>()?;
    let mut stacks: BTreeMap<StackKey, Vec<Slice>> = BTreeMap::new();
    for (key, slice) in slices.into_iter().flatten() {
        stacks.entry(key).or_default().push(slice);
    }
    let mut names: Vec<String> = stacks.keys().map(|k| k.series.clone()).collect();
    names.dedup();
    let uid = match (choice, names.as_slice()) {
        (_, []) => return Err(irregular("holds no CT image: give the folder of one CT series".into())),
        (None, [one]) => one.clone(),
        (None, _) => return Err(irregular(format!("holds {} CT series: choose one with --series: {}", names.len(), list(&names)))),
        (Some(wanted), _) => {
            let number = wanted.parse::<usize>().ok().and_then(|n| names.get(n).cloned());
            match names.iter().find(|n| *n == wanted).cloned().or(number) {
                Some(name) => name,
                None => return Err(irregular(format!("holds no CT series {wanted}; it holds {}", list(&names)))),
            }
        }
    };
    // The largest stack is the scan; `max_by_key` takes the last of equals.
    let stack = stacks.into_iter().filter(|(k, _)| k.series == uid).max_by_key(|(_, s)| s.len());
    let Some((key, slices)) = stack else { return Err(irregular("holds no CT image: give the folder of one CT series".into())) };
    stack_up(folder, &key, slices)
}

fn list(names: &[String]) -> String {
    names.iter().enumerate().map(|(i, n)| format!("{i} = {n}")).collect::<Vec<_>>().join(", ")
}

/// A CT image's place, `None` for other objects.
fn slice(path: &Path) -> Result<Option<(StackKey, Slice)>, ImagingError> {
    let object = dicom_file::open(path, Pixels::Skip)?;
    let e = Elements::new(path, &object);
    match e.text(tags::SOP_CLASS_UID).as_str() {
        uids::CT_IMAGE_STORAGE => {}
        uids::ENHANCED_CT_IMAGE_STORAGE => {
            return Err(e.wrong(tags::SOP_CLASS_UID, "is Enhanced CT (multi-frame): convert it to a series of single CT images"));
        }
        _ => return Ok(None),
    }
    // Localisers have no place in the patient's axes or another orientation: those without one are left out here.
    if e.set.get(tags::IMAGE_POSITION_PATIENT).is_none() && e.text(tags::IMAGE_TYPE).contains("LOCALIZER") {
        return Ok(None);
    }
    let orientation: [f64; 6] = e.numbers(tags::IMAGE_ORIENTATION_PATIENT)?;
    let spacing: [f64; 2] = e.numbers(tags::PIXEL_SPACING)?;
    let key = StackKey {
        series: e.text(tags::SERIES_INSTANCE_UID),
        rows: e.count(tags::ROWS)?,
        columns: e.count(tags::COLUMNS)?,
        orientation: orientation.map(|v| (v * AGREE).round() as i64),
        spacing: spacing.map(|v| (v * AGREE).round() as i64),
    };
    let position = e.numbers(tags::IMAGE_POSITION_PATIENT)?.into();
    Ok(Some((key, Slice { path: path.into(), position, orientation, spacing })))
}

/// Orders slices along their normal and checks that they are regular.
fn stack_up(folder: &Path, key: &StackKey, mut slices: Vec<Slice>) -> Result<Series, ImagingError> {
    let irregular = |path: &Path, reason: String| Err(ImagingError::Irregular { path: path.into(), reason });
    let o = slices[0].orientation;
    let (row, column) = (DVec3::new(o[0], o[1], o[2]), DVec3::new(o[3], o[4], o[5]));
    let normal = row.cross(column);
    if (normal.length() - 1.0).abs() > 1e-2 {
        return irregular(&slices[0].path, format!("row direction {row} and column direction {column} are not perpendicular unit vectors"));
    }
    let (row, column, normal) = (row.normalize(), column.normalize(), normal.normalize());
    slices.sort_by(|a, b| a.position.dot(normal).total_cmp(&b.position.dot(normal)).then_with(|| a.path.cmp(&b.path)));
    let smallest = slices[0].spacing[0].min(slices[0].spacing[1]);
    slices.dedup_by(|b, a| b.position.distance(a.position) < 0.01 * smallest);
    if slices.len() < 3 {
        return irregular(folder, format!("has {} slices at different places: expected a stack of three or more", slices.len()));
    }
    let steps: Vec<f64> = slices.windows(2).map(|w| (w[1].position - w[0].position).dot(normal)).collect();
    let mut sorted = steps.clone();
    sorted.sort_by(f64::total_cmp);
    let step = sorted[sorted.len() / 2];
    if let Some(i) = steps.iter().position(|s| (s - step).abs() > SPACING_TOLERANCE * step) {
        let times = steps[i] / step;
        let next = slices[i + 1].path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let what = if times > 1.5 && (times - times.round()).abs() < 2.0 * SPACING_TOLERANCE {
            format!("{} slice(s) are missing between this one and {next}", times.round() as i64 - 1)
        } else {
            format!("slices are irregular: {next} follows this one after {:.3} mm, the others after {step:.3} mm", steps[i])
        };
        return irregular(&slices[i].path, format!("{what}: complete the series, or resample it to even slices"));
    }
    let last = slices.len() - 1;
    let along = (slices[last].position - slices[0].position) / last as f64;
    let degrees = along.angle_between(normal).to_degrees();
    let drift = (along - normal * along.dot(normal)).length() * last as f64;
    // A tilt that shifts the last slice by less than half a pixel is no tilt.
    if drift > 0.5 * smallest {
        return Err(ImagingError::Sheared { path: folder.into(), degrees });
    }
    let spacing = slices[0].spacing;
    // PixelSpacing is (between rows, between columns): x steps between columns.
    let matrix3 = DMat3::from_cols(row * spacing[1], column * spacing[0], normal * along.dot(normal));
    Ok(Series {
        folder: folder.into(),
        uid: key.series.clone(),
        dims: [key.columns, key.rows, slices.len()],
        voxel_to_lps: DAffine3 { matrix3, translation: slices[0].position },
        slices: slices.into_iter().map(|s| s.path).collect(),
    })
}

impl Series {
    /// Decodes all slices to Hounsfield units.
    ///
    /// # Errors
    /// Pixel data that cannot be decoded: with the slice and its transfer syntax.
    pub fn read(&self) -> Result<CtVolume, ImagingError> {
        crate::volume::check_geometry(&self.folder, &self.voxel_to_lps)?;
        let plane = self.dims[0] * self.dims[1];
        let slices: Vec<Vec<f32>> = self.slices.par_iter().map(|p| pixels(p, plane)).collect::<Result<_, _>>()?;
        Ok(CtVolume { dims: self.dims, voxel_to_lps: self.voxel_to_lps, hu: slices.concat() })
    }
}

impl CtVolume {
    /// The voxels from `low` to `high` Hounsfield units, both included, as a label.
    #[must_use]
    pub fn threshold(&self, path: &Path, low: f64, high: f64) -> LabelVolume {
        let parts = self.hu.par_iter().map(|v| u8::from((low..=high).contains(&f64::from(*v)))).collect();
        LabelVolume { path: path.into(), dims: self.dims, parts, names: vec![format!("{low}..{high} HU")], voxel_to_lps: self.voxel_to_lps }
    }
}

fn pixels(path: &Path, plane: usize) -> Result<Vec<f32>, ImagingError> {
    let object = dicom_file::open(path, Pixels::Read)?;
    let e = Elements::new(path, &object);
    let size = std::fs::metadata(path).map_err(ImagingError::io(path))?.len() as usize;
    if plane > size.saturating_mul(1000) {
        return Err(e.wrong(tags::ROWS, format!("declares {plane} pixels in a file of {size} bytes: it is damaged")));
    }
    let syntax = object.meta().transfer_syntax().to_string();
    let bad = |why: String| {
        e.wrong(tags::PIXEL_DATA, format!("cannot be decoded ({why}; transfer syntax {syntax}): convert it to an uncompressed one"))
    };
    let decoded = object.decode_pixel_data().map_err(|e| bad(e.to_string()))?;
    let stored: Vec<f32> =
        decoded.to_vec_with_options(&ConvertOptions::new().with_modality_lut(ModalityLutOption::None)).map_err(|e| bad(e.to_string()))?;
    if stored.len() != plane {
        return Err(bad(format!("{} pixels, expected {plane}", stored.len())));
    }
    let number = |tag, default| if e.set.get(tag).is_some() { e.numbers::<1>(tag).map(|[v]| v) } else { Ok(default) };
    let slope = number(tags::RESCALE_SLOPE, 1.0)?;
    let intercept = number(tags::RESCALE_INTERCEPT, 0.0)?;
    // Padding is stored in the pixels' own representation; the dictionary cannot know its sign.
    let padding = e.set.get(tags::PIXEL_PADDING_VALUE).and_then(|p| p.to_int::<i32>().ok()).map(|p| {
        let signed = e.count(tags::PIXEL_REPRESENTATION).is_ok_and(|r| r == 1);
        if signed { p as i16 as f32 } else { p as u16 as f32 }
    });
    let hu = |v: f32| if Some(v) == padding { -1000.0 } else { (f64::from(v) * slope + intercept) as f32 };
    Ok(stored.into_iter().map(hu).collect())
}
