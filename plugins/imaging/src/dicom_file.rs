//! Opening DICOM files without trusting their lengths, and reading elements with errors that name them.

use crate::error::ImagingError;
use dicom_core::VR;
use dicom_core::dictionary::{DataDictionary, DataDictionaryEntry};
use dicom_core::header::Tag;
use dicom_dictionary_std::{StandardDataDictionary, tags, uids};
use dicom_object::{DefaultDicomObject, InMemDicomObject, OpenFileOptions};
use std::io::Read;
use std::path::Path;

/// Nesting of sequences beyond which a file is refused: standard objects stay below ten, and the reader recurses.
const MAX_DEPTH: usize = 32;
/// A deflate stream cannot expand more than this (258 bytes out of two bits).
const MAX_EXPANSION: u64 = 1032;
/// "Undefined length".
const UNDEFINED: u32 = u32::MAX;

/// Whether the bytes are a DICOM file (PS3.10).
#[must_use]
pub fn is_dicom(head: &[u8]) -> bool {
    head.get(128..132) == Some(b"DICM")
}

/// Opens a DICOM file after checking that every element lies within it: the parser allocates what a length declares.
///
/// # Errors
/// Foreign, truncated and unreadable files; transfer syntaxes without pure Rust decoder, by name.
pub fn open(path: &Path, read_pixels: Pixels) -> Result<DefaultDicomObject, ImagingError> {
    let bytes = std::fs::read(path).map_err(ImagingError::io(path))?;
    parse(path, &bytes, read_pixels)
}

/// Whether pixel data is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pixels {
    /// Up to the pixel data.
    Skip,
    /// All.
    Read,
}

/// As [`open`], from bytes.
pub(crate) fn parse(path: &Path, bytes: &[u8], read_pixels: Pixels) -> Result<DefaultDicomObject, ImagingError> {
    let format = |reason: String| ImagingError::Format { path: path.into(), reason };
    if !is_dicom(bytes) {
        return Err(format("not a DICOM file (no DICM at byte 128): give a DICOM-SEG, a folder of DICOM slices, .nii or .nii.gz".into()));
    }
    let layout = check_lengths(bytes, 132, None).map_err(format)?;
    let bad = |e: &dyn std::error::Error| {
        let mut reason = e.to_string();
        let mut source = e.source();
        while let Some(cause) = source {
            reason = format!("{reason}: {cause}");
            source = cause.source();
        }
        format(format!("broken DICOM file: {reason}; export it again"))
    };
    if let Some(from) = layout.deflated_from {
        let packed = &bytes[from..];
        let mut inflated = Vec::new();
        let most = (packed.len() as u64).saturating_mul(MAX_EXPANSION);
        flate2::read::DeflateDecoder::new(packed).take(most).read_to_end(&mut inflated).map_err(|e| bad(&e))?;
        check_lengths(&inflated, 0, Some(Layout::default())).map_err(format)?;
    }
    let options = match read_pixels {
        Pixels::Skip => OpenFileOptions::new().read_until(tags::PIXEL_DATA),
        Pixels::Read => OpenFileOptions::new(),
    };
    options.from_reader(bytes).map_err(|e| bad(&e))
}

/// How elements are written.
#[derive(Clone, Copy)]
struct Layout {
    explicit: bool,
    big_endian: bool,
    /// Where a deflated data set starts.
    deflated_from: Option<usize>,
}

impl Default for Layout {
    fn default() -> Self {
        Self { explicit: true, big_endian: false, deflated_from: None }
    }
}

/// Walks over all element headers from `at` on; the first length that leaves the bytes is an error. Without a layout the bytes start with
/// the file's meta group, which tells it.
fn check_lengths(bytes: &[u8], mut at: usize, known: Option<Layout>) -> Result<Layout, String> {
    let mut syntax = String::new();
    let mut in_meta = known.is_none();
    let mut layout = known.unwrap_or_default();
    // Where each open container of defined length ends; `usize::MAX` for undefined ones. Fragments hold bytes, not elements.
    let mut open: Vec<(usize, bool)> = Vec::new();
    while at < bytes.len() {
        while open.last().is_some_and(|(end, _)| at >= *end) {
            open.pop();
        }
        let short = || format!("the file ends within an element at byte {at}: it is truncated, copy or export it again");
        if in_meta && bytes.get(at..at + 2).ok_or_else(short)? != [2, 0] {
            in_meta = false;
            match syntax.as_str() {
                uids::IMPLICIT_VR_LITTLE_ENDIAN => layout.explicit = false,
                // Retired, and still on disks.
                "1.2.840.10008.1.2.2" => layout.big_endian = true,
                uids::DEFLATED_EXPLICIT_VR_LITTLE_ENDIAN => {
                    layout.deflated_from = Some(at);
                    return Ok(layout);
                }
                _ => {}
            }
        }
        let (explicit, big) = (layout.explicit, layout.big_endian);
        let word =
            |i: usize| bytes.get(i..i + 2).map(|b| [b[0], b[1]]).map(|b| if big { u16::from_be_bytes(b) } else { u16::from_le_bytes(b) });
        let long = |i: usize| {
            let four = bytes.get(i..i + 4).map(|b| [b[0], b[1], b[2], b[3]]);
            four.map(|b| if big { u32::from_be_bytes(b) } else { u32::from_le_bytes(b) })
        };
        let (group, element) = (word(at).ok_or_else(short)?, word(at + 2).ok_or_else(short)?);
        if group == 0xfffe {
            let length = long(at + 4).ok_or_else(short)?;
            at += 8;
            match element {
                0xe000 => {
                    let raw = open.last().is_some_and(|(_, raw)| *raw);
                    if raw {
                        at = within(bytes, at, length)?;
                    } else if length != UNDEFINED {
                        open.push((within(bytes, at, length)?, false));
                    } else {
                        open.push((usize::MAX, false));
                    }
                }
                _ => {
                    open.pop();
                }
            }
            if open.len() > MAX_DEPTH {
                return Err(format!("sequences are nested deeper than {MAX_DEPTH} at byte {at}: the file is damaged"));
            }
            continue;
        }
        let tag = Tag(group, element);
        let (vr, length, head) = if explicit {
            let code = bytes.get(at + 4..at + 6).ok_or_else(short)?;
            let vr = VR::from_binary([code[0], code[1]]).unwrap_or(VR::UN);
            match vr {
                VR::OB | VR::OD | VR::OF | VR::OL | VR::OV | VR::OW | VR::SQ | VR::SV | VR::UC | VR::UN | VR::UR | VR::UT | VR::UV => {
                    (vr, long(at + 8).ok_or_else(short)?, 12)
                }
                _ => (vr, u32::from(word(at + 6).ok_or_else(short)?), 8),
            }
        } else {
            let vr = StandardDataDictionary.by_tag(tag).map_or(VR::UN, |e| e.vr().relaxed());
            (vr, long(at + 4).ok_or_else(short)?, 8)
        };
        at += head;
        if vr == VR::SQ || length == UNDEFINED {
            let end = if length == UNDEFINED { usize::MAX } else { within(bytes, at, length)? };
            open.push((end, vr != VR::SQ && tag == tags::PIXEL_DATA));
            if open.len() > MAX_DEPTH {
                return Err(format!("sequences are nested deeper than {MAX_DEPTH} at byte {at}: the file is damaged"));
            }
        } else {
            let end = within(bytes, at, length)?;
            if tag == tags::TRANSFER_SYNTAX_UID {
                syntax = String::from_utf8_lossy(&bytes[at..end]).trim_end_matches(['\0', ' ']).into();
            }
            at = end;
        }
    }
    Ok(layout)
}

fn within(bytes: &[u8], at: usize, length: u32) -> Result<usize, String> {
    let end = at.saturating_add(length as usize);
    if end > bytes.len() {
        let left = bytes.len().saturating_sub(at);
        return Err(format!(
            "an element at byte {at} declares {length} bytes but {left} are left: the file is truncated or damaged, export it again"
        ));
    }
    Ok(end)
}

/// A data set with the file it is from, for errors.
#[derive(Clone, Copy)]
pub(crate) struct Elements<'a> {
    pub path: &'a Path,
    pub set: &'a InMemDicomObject,
}

impl<'a> Elements<'a> {
    pub fn new(path: &'a Path, set: &'a InMemDicomObject) -> Self {
        Self { path, set }
    }

    /// An error about an element.
    pub fn wrong(&self, tag: Tag, reason: impl Into<String>) -> ImagingError {
        let name = StandardDataDictionary.by_tag(tag).map_or("unknown", |e| e.alias());
        ImagingError::Element { path: self.path.into(), element: format!("{tag} {name}"), reason: reason.into() }
    }

    /// `N` finite numbers.
    pub fn numbers<const N: usize>(&self, tag: Tag) -> Result<[f64; N], ImagingError> {
        let element = self.set.get(tag).ok_or_else(|| self.wrong(tag, "is missing"))?;
        let values = element.to_multi_float64().map_err(|e| self.wrong(tag, format!("is no list of numbers ({e})")))?;
        let got = values.len();
        let numbers: [f64; N] = values.try_into().map_err(|_| self.wrong(tag, format!("has {got} values: expected {N}")))?;
        if numbers.iter().any(|v| !v.is_finite()) {
            return Err(self.wrong(tag, "is not finite"));
        }
        Ok(numbers)
    }

    /// A whole number of at least 0.
    pub fn count(&self, tag: Tag) -> Result<usize, ImagingError> {
        let element = self.set.get(tag).ok_or_else(|| self.wrong(tag, "is missing"))?;
        element.to_int::<u32>().map(|n| n as usize).map_err(|e| self.wrong(tag, format!("is no whole number ({e})")))
    }

    /// Text, empty when missing.
    pub fn text(&self, tag: Tag) -> String {
        self.set.get(tag).and_then(|e| e.to_str().ok()).map(|s| s.trim_end_matches(['\0', ' ']).to_string()).unwrap_or_default()
    }

    /// The items of a sequence, none when it is missing.
    pub fn items(&self, tag: Tag) -> &'a [InMemDicomObject] {
        self.set.get(tag).and_then(|e| e.items()).unwrap_or_default()
    }

    /// The first item of a sequence.
    pub fn item(&self, tag: Tag) -> Option<Self> {
        self.items(tag).first().map(|set| Self { path: self.path, set })
    }
}
