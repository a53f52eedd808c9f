//! Pixels of one frame as Hounsfield units, whatever their bits, sign and transfer syntax.

use crate::dicom_codecs::{Codec, check_jpeg, is_jpeg};
use crate::dicom_file::Elements;
use crate::error::ImagingError;
use dicom_core::DicomValue;
use dicom_dictionary_std::tags;
use dicom_object::DefaultDicomObject;
use dicom_pixeldata::PixelDecoder;

/// What air is in the place of pixels that the scanner did not measure, Hounsfield units.
pub const AIR: f32 = -1000.0;
/// Pixels that a compressed file may have for each of its bytes: an empty slice in JPEG or run lengths stays below.
const PIXELS_PER_BYTE: usize = 1000;

/// How stored values become Hounsfield units: `slope * stored + intercept`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Rescale {
    pub slope: f64,
    pub intercept: f64,
}

/// The rescale of a data set, which is that of an image or of a functional group.
pub(crate) fn rescale(e: &Elements) -> Result<Option<Rescale>, ImagingError> {
    let number = |tag, default| if e.set.get(tag).is_some() { e.numbers::<1>(tag).map(|[v]| v) } else { Ok(default) };
    let there = e.set.get(tags::RESCALE_SLOPE).is_some() || e.set.get(tags::RESCALE_INTERCEPT).is_some();
    Ok(if there {
        Some(Rescale { slope: number(tags::RESCALE_SLOPE, 1.0)?, intercept: number(tags::RESCALE_INTERCEPT, 0.0)? })
    } else {
        None
    })
}

/// The frames of a file, decoded, each of `plane` pixels.
pub(crate) struct Frames<'a> {
    e: Elements<'a>,
    bytes: std::borrow::Cow<'a, [u8]>,
    plane: usize,
    count: usize,
    /// Bytes of a pixel.
    width: usize,
    signed: bool,
    stored: u32,
    shift: u32,
    padding: Option<i64>,
}

impl<'a> Frames<'a> {
    /// Decodes the pixel data of a file of `size` bytes.
    pub fn decode(e: Elements<'a>, object: &'a DefaultDicomObject, plane: usize, size: usize) -> Result<Self, ImagingError> {
        let count = if e.set.get(tags::NUMBER_OF_FRAMES).is_some() { e.count(tags::NUMBER_OF_FRAMES)? } else { 1 };
        if plane.saturating_mul(count) > size.saturating_mul(PIXELS_PER_BYTE) {
            return Err(e.wrong(tags::ROWS, format!("declares {count} x {plane} pixels in a file of {size} bytes: it is damaged")));
        }
        let samples = if e.set.get(tags::SAMPLES_PER_PIXEL).is_some() { e.count(tags::SAMPLES_PER_PIXEL)? } else { 1 };
        if samples != 1 {
            return Err(e.wrong(tags::SAMPLES_PER_PIXEL, format!("is {samples}: expected 1, colour images are no CT")));
        }
        let allocated = e.count(tags::BITS_ALLOCATED)?;
        let stored = if e.set.get(tags::BITS_STORED).is_some() { e.count(tags::BITS_STORED)? } else { allocated };
        let high = if e.set.get(tags::HIGH_BIT).is_some() { e.count(tags::HIGH_BIT)? } else { stored.saturating_sub(1) };
        if ![8, 16, 32].contains(&allocated) || stored == 0 || stored > allocated || high >= allocated || high + 1 < stored {
            let reason =
                format!("is {allocated} with {stored} bits stored up to bit {high}: expected 8, 16 or 32 bits that hold those stored");
            return Err(e.wrong(tags::BITS_ALLOCATED, reason));
        }
        let signed = e.set.get(tags::PIXEL_REPRESENTATION).is_some() && e.count(tags::PIXEL_REPRESENTATION)? == 1;
        let syntax = object.meta().transfer_syntax().trim_end_matches(['\0', ' ']).to_string();
        let name = syntax_name(&syntax);
        let bad = |why: String| {
            e.wrong(
                tags::PIXEL_DATA,
                format!("cannot be decoded ({why}; transfer syntax {syntax}{name}): convert it to an uncompressed one"),
            )
        };
        let pixels = e.set.get(tags::PIXEL_DATA).ok_or_else(|| e.wrong(tags::PIXEL_DATA, "is missing"))?;
        let (width, needed) = (allocated / 8, plane * count * allocated / 8);
        let bytes = match (pixels.value(), Codec::of(&syntax)) {
            (DicomValue::PixelSequence(fragments), Some(codec)) => {
                let size = [e.count(tags::COLUMNS)?, e.count(tags::ROWS)?];
                codec.decode(fragments, size, count, width).map_err(bad)?.into()
            }
            (DicomValue::PixelSequence(fragments), None) => {
                if is_jpeg(&syntax) {
                    check_jpeg(fragments, [e.count(tags::COLUMNS)?, e.count(tags::ROWS)?], count).map_err(bad)?;
                }
                object.decode_pixel_data().map_err(|e| bad(e.to_string()))?.into_data().into()
            }
            _ => pixels.to_bytes().map_err(|e| bad(e.to_string()))?,
        };
        if bytes.len() < needed {
            return Err(bad(format!("{} bytes of pixels, expected {needed}: the file is truncated", bytes.len())));
        }
        let mut frames =
            Self { e, bytes, plane, count, width, signed, stored: stored as u32, shift: (high + 1 - stored) as u32, padding: None };
        // Padding is stored in the pixels' own representation; the dictionary cannot know its sign.
        let padding = e.set.get(tags::PIXEL_PADDING_VALUE).and_then(|p| p.to_int::<i64>().ok());
        frames.padding = padding.map(|p| frames.value((p as u64) << frames.shift));
        Ok(frames)
    }

    /// Masks and signs a stored word.
    fn value(&self, word: u64) -> i64 {
        let value = (word >> self.shift) & ((1 << self.stored) - 1);
        if self.signed && value >> (self.stored - 1) == 1 { value as i64 - (1 << self.stored) } else { value as i64 }
    }

    /// One frame in Hounsfield units; padding is air.
    pub fn hounsfield(&self, index: usize, rescale: Rescale) -> Result<Vec<f32>, ImagingError> {
        if index >= self.count {
            return Err(self.e.wrong(tags::NUMBER_OF_FRAMES, format!("is {}, but frame {} is described", self.count, index + 1)));
        }
        let size = self.plane * self.width;
        let unit = |word: u64| {
            let v = self.value(word);
            if Some(v) == self.padding { AIR } else { (v as f64 * rescale.slope + rescale.intercept) as f32 }
        };
        let bytes = &self.bytes[index * size..(index + 1) * size];
        Ok(match self.width {
            1 => bytes.iter().map(|b| unit((*b).into())).collect(),
            2 => bytes.chunks_exact(2).map(|b| unit(u16::from_ne_bytes([b[0], b[1]]).into())).collect(),
            _ => bytes.chunks_exact(4).map(|b| unit(u32::from_ne_bytes([b[0], b[1], b[2], b[3]]).into())).collect(),
        })
    }
}

/// What a transfer syntax is called, behind a comma.
fn syntax_name(uid: &str) -> &'static str {
    match uid.strip_prefix("1.2.840.10008.1.2.4.").and_then(|n| n.parse::<u32>().ok()) {
        Some(50..=70) => ", JPEG",
        Some(80 | 81) => ", JPEG-LS",
        Some(90 | 91) => ", JPEG 2000",
        Some(92 | 93) => ", JPEG 2000 of several components",
        Some(94 | 95 | 204 | 205) => ", JPIP: the pixels are not in the file",
        Some(100..=108) => ", video",
        Some(110..=112) => ", JPEG XL",
        Some(201..=203) => ", High-Throughput JPEG 2000",
        _ => "",
    }
}
