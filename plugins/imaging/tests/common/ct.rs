//! CT slices as hospitals write them, made of plain numbers.

use dicom_core::value::{DataSetSequence, PixelFragmentSequence};
use dicom_core::{DataElement, PrimitiveValue, Tag, VR};
use dicom_dictionary_std::{tags, uids};
use dicom_object::{FileMetaTableBuilder, InMemDicomObject};

/// What a slice is like.
#[derive(Clone)]
pub struct Ct {
    pub series: &'static str,
    pub instance: u32,
    pub columns: u16,
    pub rows: u16,
    pub spacing: [f64; 2],
    pub orientation: [f64; 6],
    pub position: [f64; 3],
    pub slope: f64,
    pub intercept: f64,
    pub signed: bool,
    pub stored: u16,
    pub photometric: &'static str,
}

impl Default for Ct {
    fn default() -> Self {
        Self {
            series: "1.2.3",
            instance: 1,
            columns: 16,
            rows: 12,
            spacing: [1.0, 1.0],
            orientation: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0],
            position: [0.0; 3],
            slope: 1.0,
            intercept: -1024.0,
            signed: false,
            stored: 12,
            photometric: "MONOCHROME2",
        }
    }
}

fn put(set: &mut InMemDicomObject, tag: Tag, vr: VR, value: &str) {
    set.put(DataElement::new(tag, vr, PrimitiveValue::from(value)));
}

fn decimals(values: &[f64]) -> String {
    values.iter().map(|v| format!("{v:.9}").chars().take(16).collect::<String>()).collect::<Vec<_>>().join("\\")
}

fn item(fill: impl FnOnce(&mut InMemDicomObject)) -> InMemDicomObject {
    let mut set = InMemDicomObject::new_empty();
    fill(&mut set);
    set
}

fn sequence(set: &mut InMemDicomObject, tag: Tag, items: Vec<InMemDicomObject>) {
    set.put(DataElement::new(tag, VR::SQ, DataSetSequence::from(items)));
}

impl Ct {
    fn base(&self, class: &str) -> InMemDicomObject {
        item(|s| {
            put(s, tags::SOP_CLASS_UID, VR::UI, class);
            put(s, tags::SOP_INSTANCE_UID, VR::UI, &format!("1.2.3.4.{}", self.instance));
            put(s, tags::SERIES_INSTANCE_UID, VR::UI, self.series);
            put(s, tags::SERIES_DESCRIPTION, VR::LO, "abdomen");
            put(s, tags::INSTANCE_NUMBER, VR::IS, &self.instance.to_string());
            put(s, tags::PHOTOMETRIC_INTERPRETATION, VR::CS, self.photometric);
            let shorts = [
                (tags::ROWS, self.rows),
                (tags::COLUMNS, self.columns),
                (tags::SAMPLES_PER_PIXEL, 1),
                (tags::BITS_ALLOCATED, 16),
                (tags::BITS_STORED, self.stored),
                (tags::HIGH_BIT, self.stored - 1),
                (tags::PIXEL_REPRESENTATION, u16::from(self.signed)),
            ];
            for (tag, value) in shorts {
                s.put(DataElement::new(tag, VR::US, PrimitiveValue::from(value)));
            }
        })
    }

    fn words(&self, hu: &[i32]) -> Vec<u16> {
        let mask = ((1_u32 << self.stored) - 1) as u16;
        hu.iter().map(|v| ((f64::from(*v) - self.intercept) / self.slope).round() as i32 as u16 & mask).collect()
    }

    /// A single image of these Hounsfield units.
    pub fn image(&self, hu: &[i32]) -> InMemDicomObject {
        let mut s = self.base(uids::CT_IMAGE_STORAGE);
        put(&mut s, tags::IMAGE_ORIENTATION_PATIENT, VR::DS, &decimals(&self.orientation));
        put(&mut s, tags::IMAGE_POSITION_PATIENT, VR::DS, &decimals(&self.position));
        put(&mut s, tags::PIXEL_SPACING, VR::DS, &decimals(&self.spacing));
        put(&mut s, tags::RESCALE_SLOPE, VR::DS, &self.slope.to_string());
        put(&mut s, tags::RESCALE_INTERCEPT, VR::DS, &self.intercept.to_string());
        s.put(DataElement::new(tags::PIXEL_DATA, VR::OW, PrimitiveValue::U16(self.words(hu).into())));
        s
    }

    /// The same with run lengths (PS3.5 annex G).
    pub fn run_lengths(&self, hu: &[i32]) -> InMemDicomObject {
        let mut s = self.image(hu);
        let words = self.words(hu);
        let mut segments = Vec::new();
        for shift in [8, 0] {
            let bytes: Vec<u8> = words.iter().map(|w| (w >> shift) as u8).collect();
            let mut packed = pack(&bytes);
            packed.resize(packed.len().next_multiple_of(2), 0);
            segments.push(packed);
        }
        let mut fragment: Vec<u8> = Vec::new();
        let offsets = [2, 64, 64 + segments[0].len() as u32].into_iter().chain([0; 13]);
        offsets.for_each(|o| fragment.extend(o.to_le_bytes()));
        segments.iter().for_each(|p| fragment.extend(p));
        s.put(DataElement::new(tags::PIXEL_DATA, VR::OB, PixelFragmentSequence::new(Vec::<u32>::new(), vec![fragment])));
        s
    }

    /// An enhanced image with these frames, each with its position and its rescale intercept.
    pub fn enhanced(&self, frames: &[([f64; 3], f64, Vec<i32>)]) -> InMemDicomObject {
        let mut s = self.base(uids::ENHANCED_CT_IMAGE_STORAGE);
        put(&mut s, tags::NUMBER_OF_FRAMES, VR::IS, &frames.len().to_string());
        let shared = item(|g| {
            sequence(
                g,
                tags::PLANE_ORIENTATION_SEQUENCE,
                vec![item(|o| put(o, tags::IMAGE_ORIENTATION_PATIENT, VR::DS, &decimals(&self.orientation)))],
            );
            sequence(g, tags::PIXEL_MEASURES_SEQUENCE, vec![item(|m| put(m, tags::PIXEL_SPACING, VR::DS, &decimals(&self.spacing)))]);
        });
        sequence(&mut s, tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE, vec![shared]);
        let own = frames.iter().map(|(position, intercept, _)| {
            item(|g| {
                sequence(
                    g,
                    tags::PLANE_POSITION_SEQUENCE,
                    vec![item(|p| put(p, tags::IMAGE_POSITION_PATIENT, VR::DS, &decimals(position)))],
                );
                let scale = item(|r| {
                    put(r, tags::RESCALE_SLOPE, VR::DS, "1");
                    put(r, tags::RESCALE_INTERCEPT, VR::DS, &intercept.to_string());
                });
                sequence(g, tags::PIXEL_VALUE_TRANSFORMATION_SEQUENCE, vec![scale]);
            })
        });
        sequence(&mut s, tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE, own.collect());
        let words: Vec<u16> = frames.iter().flat_map(|(_, intercept, hu)| Ct { intercept: *intercept, ..self.clone() }.words(hu)).collect();
        s.put(DataElement::new(tags::PIXEL_DATA, VR::OW, PrimitiveValue::U16(words.into())));
        s
    }
}

/// Run lengths of bytes: repeats and literals.
fn pack(bytes: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    let mut i = 0;
    while i < bytes.len() {
        let run = bytes[i..].iter().take(128).take_while(|b| **b == bytes[i]).count();
        if run > 1 {
            out.extend([(1 - run as i16) as i8 as u8, bytes[i]]);
            i += run;
        } else {
            let rest = &bytes[i..];
            let literal = (1..rest.len().min(128)).find(|k| rest[*k] == rest[*k - 1]).map_or(rest.len().min(128), |k| k - 1).max(1);
            out.push(literal as u8 - 1);
            out.extend(&rest[..literal]);
            i += literal;
        }
    }
    out
}

/// The directory of a medium with these files, each by its folders and name.
pub fn directory(files: &[Vec<&str>]) -> InMemDicomObject {
    item(|s| {
        let records = files.iter().map(|f| {
            item(|r| {
                put(r, tags::DIRECTORY_RECORD_TYPE, VR::CS, "IMAGE");
                put(r, tags::REFERENCED_FILE_ID, VR::CS, &f.join("\\"));
            })
        });
        sequence(s, tags::DIRECTORY_RECORD_SEQUENCE, records.collect());
    })
}

/// A data set as a file in a transfer syntax.
pub fn file(set: InMemDicomObject, class: &str, syntax: &str) -> Vec<u8> {
    let meta =
        FileMetaTableBuilder::new().media_storage_sop_class_uid(class).media_storage_sop_instance_uid("1.2.3.4").transfer_syntax(syntax);
    let mut bytes = Vec::new();
    set.with_meta(meta).unwrap().write_all(&mut bytes).unwrap();
    bytes
}
