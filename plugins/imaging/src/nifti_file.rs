//! NIfTI-1 label volumes, `.nii` and `.nii.gz`.

use crate::error::ImagingError;
use crate::frame;
use crate::volume::{LabelChoice, LabelVolume};
use flate2::bufread::MultiGzDecoder;
use glam::{DAffine3, DMat3, DQuat, DVec3};
use nifti::{Endianness, NiftiHeader, NiftiType};
use std::collections::BTreeSet;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

/// Bytes of a NIfTI-1 header.
const HEADER: usize = 348;
/// A deflate stream cannot expand more than this (258 bytes out of two bits), so a header that declares more than the file can hold is
/// refused before anything is allocated.
const MAX_EXPANSION: u64 = 1032;
/// Voxels beyond which a volume is refused: 2048 cubed.
const MAX_VOXELS: u64 = 1 << 33;
/// Voxels decoded at a time.
const CHUNK: usize = 1 << 16;

/// Reads the voxels whose values were asked for.
///
/// `choices` in order of priority: organ first, then what lies in it. The affine is the sform's, else the qform's, else the voxel size
/// (NIfTI-1 standard, methods 3, 2, 1).
///
/// # Errors
/// Foreign, broken and truncated files, values that are not in the volume, sheared axes.
pub fn read_labels(path: &Path, choices: &[LabelChoice]) -> Result<LabelVolume, ImagingError> {
    let file = File::open(path).map_err(ImagingError::io(path))?;
    let file_bytes = file.metadata().map_err(ImagingError::io(path))?.len();
    let mut reader = BufReader::with_capacity(1 << 16, file);
    let start = reader.fill_buf().map_err(ImagingError::io(path))?;
    if start.starts_with(&[0x1f, 0x8b]) {
        parse(path, &mut MultiGzDecoder::new(reader), file_bytes.saturating_mul(MAX_EXPANSION), choices)
    } else {
        parse(path, &mut reader, file_bytes, choices)
    }
}

/// Reads labels from the bytes of a file, gzip or not.
pub(crate) fn parse_bytes(path: &Path, bytes: &[u8], choices: &[LabelChoice]) -> Result<LabelVolume, ImagingError> {
    let size = bytes.len() as u64;
    if bytes.starts_with(&[0x1f, 0x8b]) {
        parse(path, &mut MultiGzDecoder::new(bytes), size.saturating_mul(MAX_EXPANSION), choices)
    } else {
        parse(path, &mut &bytes[..], size, choices)
    }
}

/// Reads labels from an uncompressed stream that cannot hold more than `max_bytes`.
pub(crate) fn parse(path: &Path, stream: &mut impl Read, max_bytes: u64, choices: &[LabelChoice]) -> Result<LabelVolume, ImagingError> {
    let format = |reason: String| ImagingError::Format { path: path.into(), reason };
    let mut head = Vec::with_capacity(HEADER);
    let got = stream.by_ref().take(HEADER as u64).read_to_end(&mut head);
    if head.len() < HEADER {
        let why = got.err().map_or_else(|| "ends".into(), |e| format!("cannot be decoded ({e})"));
        return Err(format(format!(
            "the file {why} after {} of the {HEADER} bytes of a NIfTI-1 header: give a .nii or .nii.gz file",
            head.len()
        )));
    }
    if &head[344..348] != b"n+1\0" {
        let what = match &head[..] {
            h if &h[344..348] == b"ni1\0" => "a header of an .hdr/.img pair: join the pair into one .nii file",
            h if &h[4..8] == b"n+2\0" => "NIfTI-2: write it again as NIfTI-1",
            _ => "not NIfTI (no magic n+1 at byte 344): give a .nii, .nii.gz, a DICOM-SEG or a DICOM folder",
        };
        return Err(format(format!("this is {what}")));
    }
    let header = NiftiHeader::from_reader(&head[..]).map_err(|e| format(format!("broken NIfTI header: {e}")))?;
    let dims = dims(&header).map_err(format)?;
    let format = |reason: String| ImagingError::Format { path: path.into(), reason };
    let kind = header.data_type().map_err(|e| format(format!("{e}: labels must be stored as integers or real numbers")))?;
    let size = kind.size_of() as u64;
    let voxels = dims.iter().map(|d| *d as u64).product::<u64>();
    let offset = header.vox_offset;
    if !(offset >= HEADER as f32 && offset < 1e9) {
        return Err(format(format!("vox_offset is {offset}: expected 352 or more")));
    }
    let offset = offset as u64;
    if voxels > MAX_VOXELS {
        return Err(format(format!("the header declares {dims:?} voxels, more than {MAX_VOXELS}: crop the volume")));
    }
    let expected = voxels * size;
    if expected.saturating_add(offset) > max_bytes {
        return Err(ImagingError::Truncated { path: path.into(), found: max_bytes.saturating_sub(offset), expected });
    }
    let skipped = std::io::copy(&mut stream.by_ref().take(offset - HEADER as u64), &mut std::io::sink());
    if skipped.is_err() {
        return Err(ImagingError::Truncated { path: path.into(), found: 0, expected });
    }
    let voxel_to_lps = frame::lps_from_ras(affine(&header));
    crate::volume::check_size(path, &voxel_to_lps)?;
    let slope = if header.scl_slope.is_finite() && header.scl_slope != 0.0 { f64::from(header.scl_slope) } else { 1.0 };
    let inter = if header.scl_inter.is_finite() { f64::from(header.scl_inter) } else { 0.0 };

    let decode =
        decoder(kind).ok_or_else(|| format(format!("voxels of type {kind:?} are no labels: expected integers or real numbers")))?;
    let swap = header.endianness != Endianness::native();
    let mut present: BTreeSet<i64> = BTreeSet::new();
    let mut parts = Vec::new();
    let mut buffer = Vec::new();
    let mut left = voxels;
    let mut last = None;
    while left > 0 {
        let now = left.min(CHUNK as u64);
        buffer.clear();
        let read = stream.by_ref().take(now * size).read_to_end(&mut buffer);
        if read.is_err() || (buffer.len() as u64) < now * size {
            let found = (voxels - left) * size + buffer.len() as u64;
            return Err(ImagingError::Truncated { path: path.into(), found, expected });
        }
        for raw in buffer.chunks_exact_mut(size as usize) {
            if swap {
                raw.reverse();
            }
            let stored = decode(raw);
            if let Some((value, part)) = last
                && value == stored
            {
                parts.push(part);
                continue;
            }
            let value = stored * slope + inter;
            let label = value.round();
            if (value - label).abs() > 1e-3 {
                return Err(format(format!("voxel {} has value {value}: this is no label volume, expected whole numbers", parts.len())));
            }
            let label = label as i64;
            if present.len() < 4096 {
                present.insert(label);
            }
            let part = choices.iter().rposition(|c| c.value == label).map_or(0, |i| i as u8 + 1);
            parts.push(part);
            last = Some((stored, part));
        }
        left -= now;
    }
    for choice in choices {
        if !present.contains(&choice.value) {
            let list: Vec<String> = present.iter().take(40).map(ToString::to_string).collect();
            return Err(ImagingError::UnknownLabel {
                name: choice.name.clone(),
                value: choice.value,
                present: format!("values {}", list.join(", ")),
            });
        }
    }
    let names = choices.iter().map(|c| c.name.clone()).collect();
    LabelVolume { path: path.into(), dims, parts, names, voxel_to_lps, notes: Vec::new() }.straight()
}

/// The three spatial dimensions; further ones must be 1.
fn dims(header: &NiftiHeader) -> Result<[usize; 3], String> {
    let dim = header.dim().map_err(|e| e.to_string())?;
    let at = |i: usize| dim.get(i).map_or(1, |d| usize::from(*d));
    if dim.len() < 3 || dim.iter().skip(3).any(|d| *d > 1) {
        return Err(format!("the volume has dimensions {dim:?}: expected three; extract one 3D volume"));
    }
    Ok([at(0), at(1), at(2)])
}

/// From voxels to NIfTI's RAS+, mm.
fn affine(h: &NiftiHeader) -> DAffine3 {
    let unit = match h.xyzt_units & 7 {
        1 => 1e3,
        3 => 1e-3,
        _ => 1.0,
    };
    let pixdim = |i: usize| f64::from(h.pixdim[i]);
    let rows = [h.srow_x, h.srow_y, h.srow_z].map(|r| r.map(f64::from));
    let ras = if h.sform_code > 0 {
        let column = |c: usize| DVec3::new(rows[0][c], rows[1][c], rows[2][c]);
        DAffine3 { matrix3: DMat3::from_cols(column(0), column(1), column(2)), translation: column(3) }
    } else if h.qform_code > 0 {
        let [b, c, d] = [h.quatern_b, h.quatern_c, h.quatern_d].map(f64::from);
        let a = (1.0 - (b * b + c * c + d * d)).max(0.0).sqrt();
        let qfac = if h.pixdim[0] < 0.0 { -1.0 } else { 1.0 };
        let turn = DMat3::from_quat(DQuat::from_xyzw(b, c, d, a).normalize());
        let size = DMat3::from_diagonal(DVec3::new(pixdim(1), pixdim(2), pixdim(3) * qfac));
        DAffine3 { matrix3: turn * size, translation: DVec3::new(h.quatern_x.into(), h.quatern_y.into(), h.quatern_z.into()) }
    } else {
        DAffine3::from_scale(DVec3::new(pixdim(1), pixdim(2), pixdim(3)))
    };
    DAffine3::from_scale(DVec3::splat(unit)) * ras
}

/// How a stored value in native byte order becomes a number; `None` for colours and complex numbers.
fn decoder(kind: NiftiType) -> Option<fn(&[u8]) -> f64> {
    /// The bytes of one value.
    fn bytes<const N: usize>(raw: &[u8]) -> [u8; N] {
        std::array::from_fn(|i| raw[i])
    }
    Some(match kind {
        NiftiType::Uint8 => |b| f64::from(b[0]),
        NiftiType::Int8 => |b| f64::from(b[0] as i8),
        NiftiType::Int16 => |b| f64::from(i16::from_ne_bytes(bytes(b))),
        NiftiType::Uint16 => |b| f64::from(u16::from_ne_bytes(bytes(b))),
        NiftiType::Int32 => |b| f64::from(i32::from_ne_bytes(bytes(b))),
        NiftiType::Uint32 => |b| f64::from(u32::from_ne_bytes(bytes(b))),
        NiftiType::Int64 => |b| i64::from_ne_bytes(bytes(b)) as f64,
        NiftiType::Uint64 => |b| u64::from_ne_bytes(bytes(b)) as f64,
        NiftiType::Float32 => |b| f64::from(f32::from_ne_bytes(bytes(b))),
        NiftiType::Float64 => |b| f64::from_ne_bytes(bytes(b)),
        _ => return None,
    })
}
