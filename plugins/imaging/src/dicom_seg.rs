//! DICOM-SEG, BINARY and FRACTIONAL: bits, segments and positions to a label volume.
//!
//! Binary frames follow each other bit by bit, least significant first, without padding in between (PS3.5 8.1.1): a frame whose
//! rows x columns is no multiple of 8 does not start on a byte.

use crate::dicom_file::{self, Elements, Pixels};
use crate::error::ImagingError;
use crate::files::InputFile;
use crate::volume::{LabelChoice, LabelVolume};
use dicom_dictionary_std::{tags, uids};
use glam::{DAffine3, DMat3, DVec3};
use std::path::Path;

/// Part of the slice spacing by which a frame may be off its place.
const PLACE_TOLERANCE: f64 = 0.05;
/// Voxels that any file may have.
const MIN_VOXELS: usize = 1 << 26;
/// Voxels that a file may have for each of its bytes: a binary frame has eight, and a thousand slices may be left out for each.
const VOXELS_PER_BYTE: usize = 1 << 13;

/// A segment's number and label.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Segment {
    /// SegmentNumber.
    pub number: i64,
    /// SegmentLabel.
    pub label: String,
}

/// Reads the segments that were asked for; where several hold a voxel, the last one asked for has it. Slices that no frame mentions are
/// empty.
///
/// # Errors
/// Foreign and broken files, segments that are not there, frames off the grid.
pub fn read_labels(path: &Path, choices: &[LabelChoice]) -> Result<LabelVolume, ImagingError> {
    let bytes = std::fs::read(path).map_err(ImagingError::io(path))?;
    parse(path, &bytes, choices)
}

/// Whether a DICOM file is a segmentation.
///
/// # Errors
/// Those of broken files.
pub fn is_segmentation(file: &InputFile) -> Result<bool, ImagingError> {
    let object = dicom_file::parse(file.name(), &file.read()?, Pixels::Skip)?;
    Ok(Elements::new(file.name(), &object).text(tags::SOP_CLASS_UID) == uids::SEGMENTATION_STORAGE)
}

/// The segments of a DICOM file, none when it is no segmentation.
///
/// # Errors
/// Those of broken files.
pub fn segments_of(file: &InputFile) -> Result<Vec<Segment>, ImagingError> {
    let object = dicom_file::parse(file.name(), &file.read()?, Pixels::Skip)?;
    let e = Elements::new(file.name(), &object);
    if e.text(tags::SOP_CLASS_UID) == uids::SEGMENTATION_STORAGE { segments(&e) } else { Ok(Vec::new()) }
}

fn segments(e: &Elements) -> Result<Vec<Segment>, ImagingError> {
    let segment = |item| {
        let s = Elements::new(e.path, item);
        Ok(Segment { number: s.count(tags::SEGMENT_NUMBER)? as i64, label: s.text(tags::SEGMENT_LABEL) })
    };
    e.items(tags::SEGMENT_SEQUENCE).iter().map(segment).collect()
}

/// A frame that is wanted.
struct Frame {
    index: usize,
    part: u8,
    position: DVec3,
}

/// As [`read_labels`], from bytes.
pub(crate) fn parse(path: &Path, bytes: &[u8], choices: &[LabelChoice]) -> Result<LabelVolume, ImagingError> {
    let object = dicom_file::parse(path, bytes, Pixels::Read)?;
    let e = Elements::new(path, &object);
    if e.text(tags::SOP_CLASS_UID) != uids::SEGMENTATION_STORAGE {
        return Err(e.wrong(tags::SOP_CLASS_UID, "is no DICOM-SEG: give a segmentation, or the folder of a CT series with --threshold"));
    }
    let threshold = match e.text(tags::SEGMENTATION_TYPE).as_str() {
        "BINARY" => None,
        // Half of the maximum counts as inside.
        "FRACTIONAL" => Some(e.count(tags::MAXIMUM_FRACTIONAL_VALUE)?.div_ceil(2).clamp(1, 255) as u8),
        other => return Err(e.wrong(tags::SEGMENTATION_TYPE, format!("is {other:?}: expected BINARY or FRACTIONAL"))),
    };
    let (rows, columns, count) = (e.count(tags::ROWS)?, e.count(tags::COLUMNS)?, e.count(tags::NUMBER_OF_FRAMES)?);
    let plane = rows * columns;
    let pixels = e.set.get(tags::PIXEL_DATA).ok_or_else(|| e.wrong(tags::PIXEL_DATA, "is missing"))?;
    let pixels = pixels.to_bytes().map_err(|_| {
        let syntax = object.meta().transfer_syntax();
        e.wrong(tags::PIXEL_DATA, format!("is encapsulated (transfer syntax {syntax}): write the segmentation uncompressed"))
    })?;
    let bits = if threshold.is_none() { 1 } else { 8 };
    let needed = (plane as u64 * count as u64 * bits).div_ceil(8);
    if plane == 0 || (pixels.len() as u64) < needed {
        let reason = format!("holds {} bytes; {count} frames of {rows} x {columns} need {needed}: the file is truncated", pixels.len());
        return Err(e.wrong(tags::PIXEL_DATA, reason));
    }
    let segments = segments(&e)?;
    for c in choices {
        if !segments.iter().any(|s| s.number == c.value) {
            let present: Vec<String> = segments.iter().map(|s| format!("{} ({})", s.number, s.label)).collect();
            let present = format!("segments {}", present.join(", "));
            return Err(ImagingError::UnknownLabel { name: c.name.clone(), value: c.value, present });
        }
    }
    let shared = e.item(tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE);
    let per_frame = e.items(tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE);
    if per_frame.len() != count {
        let reason = format!("has {} items for {count} frames", per_frame.len());
        return Err(e.wrong(tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE, reason));
    }
    // A functional group may be shared by all frames or stand with each.
    let group = |frame: usize, tag| {
        let own = Elements::new(path, &per_frame[frame]).item(tag);
        own.or_else(|| shared.and_then(|s| s.item(tag))).ok_or_else(|| e.wrong(tag, format!("is missing for frame {}", frame + 1)))
    };
    let mut frames = Vec::new();
    let mut axes: Option<(DVec3, DVec3)> = None;
    let mut size: Option<[f64; 2]> = None;
    let mut declared_step = None;
    for index in 0..count {
        let number = group(index, tags::SEGMENT_IDENTIFICATION_SEQUENCE)?.count(tags::REFERENCED_SEGMENT_NUMBER)? as i64;
        let Some(part) = choices.iter().rposition(|c| c.value == number) else { continue };
        let o: [f64; 6] = group(index, tags::PLANE_ORIENTATION_SEQUENCE)?.numbers(tags::IMAGE_ORIENTATION_PATIENT)?;
        let measures = group(index, tags::PIXEL_MEASURES_SEQUENCE)?;
        let spacing: [f64; 2] = measures.numbers(tags::PIXEL_SPACING)?;
        if measures.set.get(tags::SPACING_BETWEEN_SLICES).is_some() {
            declared_step = Some(measures.numbers::<1>(tags::SPACING_BETWEEN_SLICES)?[0].abs());
        } else if declared_step.is_none() && measures.set.get(tags::SLICE_THICKNESS).is_some() {
            declared_step = Some(measures.numbers::<1>(tags::SLICE_THICKNESS)?[0].abs());
        }
        let own = (DVec3::new(o[0], o[1], o[2]), DVec3::new(o[3], o[4], o[5]));
        let first = *axes.get_or_insert(own);
        let first_size = *size.get_or_insert(spacing);
        let same_size = (0..2).all(|i| (first_size[i] - spacing[i]).abs() <= 1e-4 * first_size[i].abs());
        if first.0.distance(own.0) > 1e-4 || first.1.distance(own.1) > 1e-4 || !same_size {
            return Err(e.wrong(tags::PLANE_ORIENTATION_SEQUENCE, format!("of frame {} differs from the first's: resample it", index + 1)));
        }
        let position = group(index, tags::PLANE_POSITION_SEQUENCE)?.numbers(tags::IMAGE_POSITION_PATIENT)?.into();
        frames.push(Frame { index, part: part as u8 + 1, position });
    }
    let names: Vec<String> = choices.iter().map(|c| c.name.clone()).collect();
    let (Some((row, column)), Some(size)) = (axes, size) else {
        return Err(ImagingError::Empty { what: names.join(" + "), dims: [columns, rows, 0] });
    };
    let normal = row.cross(column);
    if (normal.length() - 1.0).abs() > 1e-2 || size.iter().any(|s| *s <= 0.0) {
        return Err(
            e.wrong(tags::PLANE_ORIENTATION_SEQUENCE, "is no pair of perpendicular unit vectors, or the pixel spacing is not positive")
        );
    }
    let heights: Vec<f64> = frames.iter().map(|f| f.position.dot(normal)).collect();
    let (base, step, slices) = levels(&heights, declared_step).map_err(|reason| e.wrong(tags::PLANE_POSITION_SEQUENCE, reason))?;
    // Frames that are not there are empty. When there is one for every image of the scan, nothing is known beyond the first and the last.
    let images = e.item(tags::REFERENCED_SERIES_SEQUENCE).map_or(0, |r| r.items(tags::REFERENCED_INSTANCE_SEQUENCE).len());
    let pad = usize::from(images == 0 || slices < images);
    let dims = [columns, rows, slices + 2 * pad];
    let most = MIN_VOXELS.max(bytes.len().saturating_mul(VOXELS_PER_BYTE));
    if plane.saturating_mul(dims[2]) > most {
        let reason = format!("spreads {slices} slices of {rows} x {columns}: more than {most} voxels for a file of {} bytes", bytes.len());
        return Err(e.wrong(tags::PLANE_POSITION_SEQUENCE, reason));
    }
    // The frames' first corner, brought down to the first slice.
    let corner = frames[0].position;
    // With a tilted gantry each slice is shifted against the one before, by this vector for a millimetre along the normal.
    let by_height = |a: &&Frame, b: &&Frame| a.position.dot(normal).total_cmp(&b.position.dot(normal));
    let (lowest, highest) = (frames.iter().min_by(by_height), frames.iter().max_by(by_height));
    let along = lowest.zip(highest).map_or(DVec3::ZERO, |(l, h)| h.position - l.position);
    let height = along.dot(normal);
    let tilt = if height > 0.5 * step { along / height - normal } else { DVec3::ZERO };
    let slant = normal + tilt;
    let translation = corner + slant * (base - step * pad as f64 - corner.dot(normal));
    let mut parts = vec![0_u8; plane * dims[2]];
    // In the order of the choices, so that the last one asked for has the voxel.
    frames.sort_by_key(|f| (f.part, f.index));
    for f in &frames {
        let slice = ((f.position.dot(normal) - base) / step).round();
        let off = f.position - (corner + slant * (base + slice * step - corner.dot(normal)));
        if off.length() > PLACE_TOLERANCE * step.max(size[0]) {
            let reason = format!("frame {} is {:.3} mm off the grid of the others: resample the segmentation", f.index + 1, off.length());
            return Err(e.wrong(tags::PLANE_POSITION_SEQUENCE, reason));
        }
        let to = &mut parts[plane * (slice as usize + pad)..][..plane];
        for (i, voxel) in to.iter_mut().enumerate() {
            let at = f.index * plane + i;
            let inside = match threshold {
                None => pixels[at / 8] >> (at % 8) & 1 == 1,
                Some(least) => pixels[at] >= least,
            };
            if inside {
                *voxel = f.part;
            }
        }
    }
    let matrix3 = DMat3::from_cols(row * size[1], column * size[0], slant * step);
    let volume = LabelVolume { path: path.into(), dims, parts, names, voxel_to_lps: DAffine3 { matrix3, translation }, notes: Vec::new() };
    volume.straight()
}

/// The lowest height, the distance of slices and their number, from the heights of frames in any order and with any slices left out.
fn levels(heights: &[f64], declared: Option<f64>) -> Result<(f64, f64, usize), String> {
    let mut sorted = heights.to_vec();
    sorted.sort_by(f64::total_cmp);
    let (low, high) = (sorted[0], sorted[sorted.len() - 1]);
    let noise = 1e-4 * declared.filter(|d| *d > 0.0).unwrap_or(1.0);
    let nearest = sorted.windows(2).map(|w| w[1] - w[0]).filter(|d| *d > noise).fold(f64::INFINITY, f64::min);
    let step = match declared.filter(|d| *d > 0.0 && d.is_finite()) {
        // Positions count more than what is declared, unless slices between them were left out.
        Some(d)
            if nearest.is_infinite() || ((nearest / d).round() >= 1.0 && (nearest / d - (nearest / d).round()).abs() < PLACE_TOLERANCE) =>
        {
            d
        }
        _ if nearest.is_finite() => nearest,
        _ => return Err("there is one slice only, and no SpacingBetweenSlices or SliceThickness".into()),
    };
    let slices = ((high - low) / step).round() + 1.0;
    if slices > 1e6 {
        return Err(format!("frames spread over {:.0} mm at a distance of {step} mm: the positions are damaged", high - low));
    }
    Ok((low, step, slices as usize))
}
