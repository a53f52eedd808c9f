//! CT series of a folder, an archive or a DICOMDIR: slices in order, their geometry, Hounsfield units on a straight grid, a threshold.
//!
//! Slices are ordered by their positions along the normal of the images, never by their numbers. Where the table moved along a tilted
//! gantry, or at uneven steps, the images are read where they are and the volume is resampled (see [`crate::resample`]).

use crate::dicom_file::{self, Elements, Pixels};
use crate::dicom_pixels::{Frames, Rescale, rescale};
use crate::error::ImagingError;
use crate::files::{self, InputFile};
use crate::resample::{self, Plane};
use crate::volume::LabelVolume;
use dicom_dictionary_std::{tags, uids};
use dicom_object::InMemDicomObject;
use glam::{DAffine3, DMat3, DVec3};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Part of the median spacing by which a slice may be off its place.
const SPACING_TOLERANCE: f64 = 0.05;
/// Part of all slices from which on places that hold several are told to be phases.
const PHASES: f64 = 0.5;
/// Decimals to which orientations and pixel spacings of one stack agree.
const AGREE: f64 = 1e4;
/// Voxels that resampling may make of one that was read: more tilt than any gantry has.
const MAX_GROWTH: usize = 8;

/// What becomes of a series in which slices are missing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Gaps {
    /// An error that names them.
    #[default]
    Refuse,
    /// The slices beside them are interpolated.
    Interpolate,
}

/// What is known of a slice without its pixels.
#[derive(Clone, Debug)]
struct Slice {
    file: usize,
    frame: usize,
    /// Acquisition and instance number, by which duplicates are ordered.
    order: (usize, usize),
    position: DVec3,
    orientation: [f64; 6],
    spacing: [f64; 2],
    rescale: Rescale,
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

/// What a series is called, for choosing one.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct SeriesEntry {
    /// SeriesInstanceUID.
    pub uid: String,
    /// SeriesDescription.
    pub description: String,
    /// Columns, rows, slices of its largest stack.
    pub dims: [usize; 3],
}

/// A stack of slices in order, not yet decoded.
#[derive(Clone, Debug)]
pub struct Series {
    place: PathBuf,
    files: Vec<InputFile>,
    /// SeriesInstanceUID.
    pub uid: String,
    slices: Vec<Slice>,
    /// Columns, rows, slices that are there.
    pub dims: [usize; 3],
    /// Unit vectors along a row, along a column, and their normal.
    axes: [DVec3; 3],
    /// Distance of columns, of rows, and of most slices, mm.
    spacing: DVec3,
    straight: bool,
    /// What a reader should know: what was left out, filled in or resampled.
    pub notes: Vec<String>,
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

/// The stacks of CT slices of an input, each with the description of its series.
type Stacks = BTreeMap<StackKey, (String, Vec<Slice>)>;

/// The CT series of an input in the order of their UIDs.
///
/// # Errors
/// Files that cannot be read, images without geometry.
pub fn series_of(place: &Path) -> Result<Vec<SeriesEntry>, ImagingError> {
    Ok(entries(&stacks(&dicom_files(place)?)?))
}

/// Finds a CT series in a folder (and those in it), a zip archive or a DICOMDIR, and puts its slices in order. `choice` is a
/// SeriesInstanceUID or the number of a series in the order of their UIDs, needed only when there are several. Images of another size or
/// orientation than most (localisers) are left out.
///
/// # Errors
/// No series, several without a choice, slices that are missing: with their names.
pub fn find(place: &Path, choice: Option<&str>, gaps: Gaps) -> Result<Series, ImagingError> {
    let irregular = |reason: String| ImagingError::Irregular { path: place.into(), reason };
    let files = dicom_files(place)?;
    let stacks = stacks(&files)?;
    let series = entries(&stacks);
    let list = || {
        let line = |(i, s): (usize, &SeriesEntry)| {
            format!("\n  {i} = {} \"{}\", {} slices of {} x {}", s.uid, s.description, s.dims[2], s.dims[0], s.dims[1])
        };
        series.iter().enumerate().map(line).collect::<String>()
    };
    let uid = match (choice, series.as_slice()) {
        (_, []) => return Err(irregular("holds no CT image: give the folder of one CT series".into())),
        (None, [one]) => one.uid.clone(),
        (None, _) => return Err(irregular(format!("holds {} CT series: choose one with --series:{}", series.len(), list()))),
        (Some(wanted), _) => {
            let number = wanted.parse::<usize>().ok().and_then(|n| series.get(n));
            match series.iter().find(|s| s.uid == wanted).or(number) {
                Some(s) => s.uid.clone(),
                None => return Err(irregular(format!("holds no CT series {wanted}; it holds:{}", list()))),
            }
        }
    };
    // The largest stack is the scan; `max_by_key` takes the last of equals.
    let (of_series, others): (Vec<_>, Vec<_>) = stacks.into_iter().partition(|(k, _)| k.series == uid);
    drop(others);
    let left_out: usize = of_series.iter().map(|(_, (_, s))| s.len()).sum();
    let stack = of_series.into_iter().max_by_key(|(_, (_, s))| s.len());
    let Some((key, (_, slices))) = stack else { return Err(irregular("holds no CT image: give the folder of one CT series".into())) };
    let left_out = left_out - slices.len();
    let mut found = stack_up(place, files, &key, slices, gaps)?;
    if left_out > 0 {
        found.notes.push(format!("left out {left_out} image(s) of another size or orientation"));
    }
    Ok(found)
}

fn dicom_files(place: &Path) -> Result<Vec<InputFile>, ImagingError> {
    let all = match files::list(place)? {
        Some(all) => all,
        None => vec![InputFile::OnDisk(place.into())],
    };
    Ok(all.into_par_iter().filter(InputFile::is_dicom).collect())
}

fn stacks(files: &[InputFile]) -> Result<Stacks, ImagingError> {
    let slices: Vec<Vec<(StackKey, String, Slice)>> =
        files.par_iter().enumerate().map(|(i, f)| slices(i, f)).collect::<Result<_, ImagingError>>()?;
    let mut stacks = Stacks::new();
    for (key, description, slice) in slices.into_iter().flatten() {
        stacks.entry(key).or_insert_with(|| (description, Vec::new())).1.push(slice);
    }
    Ok(stacks)
}

fn entries(stacks: &Stacks) -> Vec<SeriesEntry> {
    let mut series: Vec<SeriesEntry> = Vec::new();
    for (key, (description, slices)) in stacks {
        let dims = [key.columns, key.rows, slices.len()];
        match series.last_mut().filter(|s| s.uid == key.series) {
            Some(same) if same.dims[2] >= dims[2] => {}
            Some(same) => same.dims = dims,
            None => series.push(SeriesEntry { uid: key.series.clone(), description: description.clone(), dims }),
        }
    }
    series
}

/// The CT images of a file, none for other objects.
fn slices(file: usize, from: &InputFile) -> Result<Vec<(StackKey, String, Slice)>, ImagingError> {
    let path = from.name();
    let object = dicom_file::parse(path, &from.read()?, Pixels::Skip)?;
    let e = Elements::new(path, &object);
    let description = e.text(tags::SERIES_DESCRIPTION);
    let number = |tag| e.count(tag).unwrap_or(0);
    let order = (number(tags::ACQUISITION_NUMBER), number(tags::INSTANCE_NUMBER));
    let slice = |frame: usize, orientation: [f64; 6], spacing: [f64; 2], position: [f64; 3], rescale: Option<Rescale>| {
        let key = StackKey {
            series: e.text(tags::SERIES_INSTANCE_UID),
            rows: e.count(tags::ROWS)?,
            columns: e.count(tags::COLUMNS)?,
            orientation: orientation.map(|v| (v * AGREE).round() as i64),
            spacing: spacing.map(|v| (v * AGREE).round() as i64),
        };
        let rescale = rescale.unwrap_or(Rescale { slope: 1.0, intercept: 0.0 });
        Ok((
            key,
            description.clone(),
            Slice { file, frame, order: (order.0, order.1 + frame), position: position.into(), orientation, spacing, rescale },
        ))
    };
    match e.text(tags::SOP_CLASS_UID).as_str() {
        uids::CT_IMAGE_STORAGE => {
            // Localisers have no place in the patient's axes or another orientation: those without one are left out here.
            if e.set.get(tags::IMAGE_POSITION_PATIENT).is_none() && e.text(tags::IMAGE_TYPE).contains("LOCALIZER") {
                return Ok(Vec::new());
            }
            let (orientation, spacing) = (e.numbers(tags::IMAGE_ORIENTATION_PATIENT)?, e.numbers(tags::PIXEL_SPACING)?);
            Ok(vec![slice(0, orientation, spacing, e.numbers(tags::IMAGE_POSITION_PATIENT)?, rescale(&e)?)?])
        }
        uids::ENHANCED_CT_IMAGE_STORAGE => {
            let shared = e.item(tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE);
            let per_frame = e.items(tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE);
            // A functional group may be shared by all frames or stand with each (PS3.3 C.7.6.16).
            let group = |own: &'_ InMemDicomObject, tag| {
                let own = own.get(tag).and_then(|e| e.items()).and_then(|i| i.first()).cloned();
                own.or_else(|| shared.and_then(|s| s.item(tag)).map(|s| s.set.clone()))
            };
            per_frame
                .iter()
                .enumerate()
                .map(|(frame, own)| {
                    let need = |tag| group(own, tag).ok_or_else(|| e.wrong(tag, format!("is missing for frame {}", frame + 1)));
                    let (o, m, p) = (
                        need(tags::PLANE_ORIENTATION_SEQUENCE)?,
                        need(tags::PIXEL_MEASURES_SEQUENCE)?,
                        need(tags::PLANE_POSITION_SEQUENCE)?,
                    );
                    let scale = group(own, tags::PIXEL_VALUE_TRANSFORMATION_SEQUENCE);
                    let scale = scale.map(|s| rescale(&Elements::new(path, &s))).transpose()?.flatten();
                    let of = |set| Elements::new(path, set);
                    let orientation = of(&o).numbers(tags::IMAGE_ORIENTATION_PATIENT)?;
                    let position = of(&p).numbers(tags::IMAGE_POSITION_PATIENT)?;
                    slice(frame, orientation, of(&m).numbers(tags::PIXEL_SPACING)?, position, scale)
                })
                .collect()
        }
        _ => Ok(Vec::new()),
    }
}

/// Orders slices along their normal and finds out how regular they are.
fn stack_up(place: &Path, files: Vec<InputFile>, key: &StackKey, mut slices: Vec<Slice>, gaps: Gaps) -> Result<Series, ImagingError> {
    let name = |s: &Slice| files[s.file].name().to_path_buf();
    let short = |s: &Slice| files[s.file].name().file_name().unwrap_or_default().to_string_lossy().into_owned();
    let irregular = |path: PathBuf, reason: String| Err(ImagingError::Irregular { path, reason });
    let o = slices[0].orientation;
    let (row, column) = (DVec3::new(o[0], o[1], o[2]), DVec3::new(o[3], o[4], o[5]));
    let normal = row.cross(column);
    if !((row.length() - 1.0).abs() < 1e-2 && (column.length() - 1.0).abs() < 1e-2 && (normal.length() - 1.0).abs() < 1e-2) {
        return irregular(
            name(&slices[0]),
            format!("row direction {row} and column direction {column} are not perpendicular unit vectors"),
        );
    }
    let (row, normal) = (row.normalize(), normal.normalize());
    let column = normal.cross(row);
    slices.sort_by(|a, b| {
        let along = a.position.dot(normal).total_cmp(&b.position.dot(normal));
        along.then(a.order.cmp(&b.order)).then_with(|| files[a.file].name().cmp(files[b.file].name())).then(a.frame.cmp(&b.frame))
    });
    let mut notes = Vec::new();
    let smallest = slices[0].spacing[0].min(slices[0].spacing[1]);
    let all = slices.len();
    slices.dedup_by(|b, a| (b.position - a.position).dot(normal) < 0.01 * smallest);
    let doubled = all - slices.len();
    if doubled as f64 > PHASES * slices.len() as f64 {
        notes.push(format!("several images at most places (phases): the first acquisition was taken, {doubled} image(s) left out"));
    } else if doubled > 0 {
        notes.push(format!("left out {doubled} image(s) at a place that another one has"));
    }
    if slices.len() < 3 {
        return irregular(place.into(), format!("has {} slices at different places: expected a stack of three or more", slices.len()));
    }
    let steps: Vec<f64> = slices.windows(2).map(|w| (w[1].position - w[0].position).dot(normal)).collect();
    let mut sorted = steps.clone();
    sorted.sort_by(f64::total_cmp);
    let step = sorted[sorted.len() / 2];
    let whole = |s: f64| (s / step - (s / step).round()).abs() <= SPACING_TOLERANCE * (s / step) && s / step > 0.5;
    let even = steps.iter().filter(|s| (**s - step).abs() <= SPACING_TOLERANCE * step).count();
    if even < steps.len() {
        // Steps that are all multiples of one are those of an even series with slices missing.
        if steps.iter().all(|s| whole(*s)) && even * 2 >= steps.len() {
            let missing: usize = steps.iter().map(|s| (s / step).round() as usize - 1).sum();
            let first = steps.iter().position(|s| s / step > 1.5).unwrap_or(0);
            let n = (steps[first] / step).round() as i64 - 1;
            let (before, after) = (&slices[first], &slices[first + 1]);
            if gaps == Gaps::Refuse {
                let reason = format!(
                    "{n} slice(s) are missing between this one and {}: complete the series, or interpolate {missing} in all with --fill-gaps",
                    short(after)
                );
                return irregular(name(before), reason);
            }
            notes.push(format!("interpolated {missing} missing slice(s), the first after {}", short(before)));
        } else {
            let (least, most) = (sorted[0], sorted[sorted.len() - 1]);
            notes.push(format!("slices at {least:.2} to {most:.2} mm from each other, resampled to {step:.2} mm"));
        }
    }
    let in_plane = |s: &Slice| {
        let d = s.position - slices[0].position;
        d - normal * d.dot(normal)
    };
    let drift = slices.iter().map(|s| in_plane(s).length()).fold(0.0, f64::max);
    // A tilt that shifts no slice by half a pixel is no tilt.
    let tilted = drift > 0.5 * smallest;
    if tilted {
        let last = slices.len() - 1;
        let along = slices[last].position - slices[0].position;
        notes.push(format!("gantry tilt of {:.1} degrees, resampled to a straight grid", along.angle_between(normal).to_degrees()));
    }
    let s = slices[0].spacing;
    Ok(Series {
        place: place.into(),
        uid: key.series.clone(),
        dims: [key.columns, key.rows, slices.len()],
        axes: [row, column, normal],
        // PixelSpacing is (between rows, between columns): x steps between columns.
        spacing: DVec3::new(s[1], s[0], step),
        straight: even == steps.len() && !tilted,
        files,
        slices,
        notes,
    })
}

impl Series {
    /// From the voxel indices of a straight stack that starts at the first slice to patient LPS, mm.
    fn voxel_to_lps(&self) -> DAffine3 {
        let [row, column, normal] = self.axes;
        let (first, last) = (self.slices[0].position, self.slices[self.slices.len() - 1].position);
        let step = if self.straight { (last - first).dot(normal) / (self.slices.len() - 1) as f64 } else { self.spacing.z };
        DAffine3 { matrix3: DMat3::from_cols(row * self.spacing.x, column * self.spacing.y, normal * step), translation: first }
    }

    /// Decodes all slices to Hounsfield units, on several threads, and resamples them if they are no straight and even stack.
    ///
    /// # Errors
    /// Pixel data that cannot be decoded: with the slice and its transfer syntax.
    pub fn read(&self) -> Result<CtVolume, ImagingError> {
        let planes = self.planes()?;
        let voxel_to_lps = self.voxel_to_lps();
        crate::volume::check_geometry(&self.place, &voxel_to_lps)?;
        if self.straight {
            let hu = planes.iter().flat_map(|p| p.pixels.iter().copied()).collect();
            return Ok(CtVolume { dims: self.dims, voxel_to_lps, hu });
        }
        let most = self.dims.iter().product::<usize>().saturating_mul(MAX_GROWTH);
        resample::straighten(&planes, [self.dims[0], self.dims[1]], self.spacing, voxel_to_lps, most).ok_or_else(|| {
            let reason = "its slices are so far from each other or so tilted that a straight grid would be many times larger: the positions are damaged";
            ImagingError::Irregular { path: self.place.clone(), reason: reason.into() }
        })
    }

    /// The decoded slices as they are, each with its place relative to the first one's corner.
    ///
    /// # Errors
    /// As [`Series::read`].
    pub fn planes(&self) -> Result<Vec<Plane>, ImagingError> {
        let plane = self.dims[0] * self.dims[1];
        // Files in order, each with its slices: a file is read once.
        let mut of_file: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for (i, s) in self.slices.iter().enumerate() {
            of_file.entry(s.file).or_default().push(i);
        }
        let decoded: Vec<Vec<(usize, Vec<f32>)>> = of_file
            .into_par_iter()
            .map(|(file, slices)| {
                let file = &self.files[file];
                let bytes = file.read()?;
                let object = dicom_file::parse(file.name(), &bytes, Pixels::Read)?;
                let e = Elements::new(file.name(), &object);
                let frames = Frames::decode(e, &object, plane, bytes.len())?;
                slices.into_iter().map(|i| Ok((i, frames.hounsfield(self.slices[i].frame, self.slices[i].rescale)?))).collect()
            })
            .collect::<Result<_, ImagingError>>()?;
        let mut pixels: Vec<(usize, Vec<f32>)> = decoded.into_iter().flatten().collect();
        pixels.sort_by_key(|(i, _)| *i);
        let [row, column, normal] = self.axes;
        let first = self.slices[0].position;
        let place = |i: usize| {
            let d = self.slices[i].position - first;
            DVec3::new(d.dot(row), d.dot(column), d.dot(normal))
        };
        Ok(pixels.into_iter().map(|(i, pixels)| Plane { at: place(i), pixels }).collect())
    }
}

impl CtVolume {
    /// The voxels from `low` to `high` Hounsfield units, both included, as a label.
    #[must_use]
    pub fn threshold(&self, path: &Path, low: f64, high: f64) -> LabelVolume {
        let parts = self.hu.par_iter().map(|v| u8::from((low..=high).contains(&f64::from(*v)))).collect();
        LabelVolume {
            path: path.into(),
            dims: self.dims,
            parts,
            names: vec![format!("{low}..{high} HU")],
            voxel_to_lps: self.voxel_to_lps,
            notes: Vec::new(),
        }
    }
}
