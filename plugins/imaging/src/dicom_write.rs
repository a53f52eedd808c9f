//! The phantom as files: a CT series and a DICOM-SEG with a segment a structure.

use crate::error::ImagingError;
use crate::phantom::{PhantomSettings, PhantomVolume};
use dicom_core::value::DataSetSequence;
use dicom_core::{DataElement, PrimitiveValue, Tag, VR, dicom_value};
use dicom_dictionary_std::{tags, uids};
use dicom_object::{FileMetaTableBuilder, InMemDicomObject};
use std::path::{Path, PathBuf};

/// Added to Hounsfield units in the file, as scanners do: air is near zero.
const OFFSET: i32 = 1024;
/// Name of the segmentation's file.
pub const SEGMENTATION_FILE: &str = "seg.dcm";

/// Names of one study, derived from the settings: the same settings write the same bytes.
struct Names {
    base: u64,
}

impl Names {
    fn new(settings: &PhantomSettings) -> Self {
        // FNV-1a.
        let words = [settings.pixel_mm.to_bits(), settings.slice_mm.to_bits(), settings.noise_hu.to_bits(), settings.seed];
        let base = words
            .iter()
            .flat_map(|w| w.to_le_bytes())
            .fold(0xcbf2_9ce4_8422_2325, |h: u64, b| (h ^ u64::from(b)).wrapping_mul(0x100_0000_01b3));
        Self { base }
    }

    /// A UID under the root for integers (PS3.5 B.2).
    fn uid(&self, kind: u64, index: usize) -> String {
        format!("2.25.{}", (u128::from(self.base) << 64) | (u128::from(kind) << 32) | index as u128)
    }
}

/// Writes `ct_0000.dcm` and so on and [`SEGMENTATION_FILE`] into a folder that exists; what was written, the segmentation last.
/// `progress` hears of each file.
///
/// # Errors
/// When a file cannot be written.
pub fn write(
    folder: &Path,
    settings: &PhantomSettings,
    volume: &PhantomVolume,
    progress: &mut dyn FnMut(),
) -> Result<Vec<PathBuf>, ImagingError> {
    let names = Names::new(settings);
    let mut written = Vec::new();
    for z in 0..volume.dims[2] {
        let path = folder.join(format!("ct_{z:04}.dcm"));
        save(ct_slice(volume, &names, z), uids::CT_IMAGE_STORAGE, &path)?;
        written.push(path);
        progress();
    }
    let path = folder.join(SEGMENTATION_FILE);
    save(segmentation(volume, &names), uids::SEGMENTATION_STORAGE, &path)?;
    written.push(path);
    progress();
    Ok(written)
}

fn text(set: &mut InMemDicomObject, tag: Tag, vr: VR, value: &str) {
    set.put(DataElement::new(tag, vr, PrimitiveValue::from(value)));
}

/// Decimal strings of at most 16 characters.
fn decimals(set: &mut InMemDicomObject, tag: Tag, values: &[f64]) {
    let words: Vec<String> =
        values.iter().map(|v| format!("{:.6}", v + 0.0)).map(|s| s.trim_end_matches('0').trim_end_matches('.').to_string()).collect();
    text(set, tag, VR::DS, &words.join("\\"));
}

fn short(set: &mut InMemDicomObject, tag: Tag, value: u16) {
    set.put(DataElement::new(tag, VR::US, PrimitiveValue::from(value)));
}

fn sequence(set: &mut InMemDicomObject, tag: Tag, items: Vec<InMemDicomObject>) {
    set.put(DataElement::new(tag, VR::SQ, DataSetSequence::from(items)));
}

fn item(fill: impl FnOnce(&mut InMemDicomObject)) -> InMemDicomObject {
    let mut set = InMemDicomObject::new_empty();
    fill(&mut set);
    set
}

/// Patient, study, frame of reference, equipment, image matrix.
fn common(set: &mut InMemDicomObject, volume: &PhantomVolume, names: &Names, class: &str, instance: &str, series: (u64, &str, &str)) {
    text(set, tags::SOP_CLASS_UID, VR::UI, class);
    text(set, tags::SOP_INSTANCE_UID, VR::UI, instance);
    text(set, tags::STUDY_DATE, VR::DA, "20260101");
    text(set, tags::STUDY_TIME, VR::TM, "120000");
    text(set, tags::CONTENT_DATE, VR::DA, "20260101");
    text(set, tags::CONTENT_TIME, VR::TM, "120000");
    text(set, tags::ACCESSION_NUMBER, VR::SH, "");
    text(set, tags::REFERRING_PHYSICIAN_NAME, VR::PN, "");
    text(set, tags::MANUFACTURER, VR::LO, "Keyhole");
    text(set, tags::MANUFACTURER_MODEL_NAME, VR::LO, "phantom");
    text(set, tags::DEVICE_SERIAL_NUMBER, VR::LO, "1");
    text(set, tags::SOFTWARE_VERSIONS, VR::LO, env!("CARGO_PKG_VERSION"));
    text(set, tags::PATIENT_NAME, VR::PN, "Phantom^Abdomen");
    text(set, tags::PATIENT_ID, VR::LO, "PHANTOM");
    text(set, tags::PATIENT_BIRTH_DATE, VR::DA, "");
    text(set, tags::PATIENT_SEX, VR::CS, "O");
    text(set, tags::STUDY_INSTANCE_UID, VR::UI, &names.uid(1, 0));
    text(set, tags::STUDY_ID, VR::SH, "1");
    text(set, tags::FRAME_OF_REFERENCE_UID, VR::UI, &names.uid(2, 0));
    text(set, tags::POSITION_REFERENCE_INDICATOR, VR::LO, "");
    let (kind, modality, description) = series;
    text(set, tags::SERIES_INSTANCE_UID, VR::UI, &names.uid(kind, 0));
    text(set, tags::SERIES_NUMBER, VR::IS, &kind.to_string());
    text(set, tags::SERIES_DESCRIPTION, VR::LO, description);
    text(set, tags::MODALITY, VR::CS, modality);
    short(set, tags::ROWS, volume.dims[1] as u16);
    short(set, tags::COLUMNS, volume.dims[0] as u16);
    short(set, tags::SAMPLES_PER_PIXEL, 1);
    text(set, tags::PHOTOMETRIC_INTERPRETATION, VR::CS, "MONOCHROME2");
    short(set, tags::PIXEL_REPRESENTATION, 0);
}

fn orientation(set: &mut InMemDicomObject, volume: &PhantomVolume) {
    let m = volume.voxel_to_lps.matrix3;
    let (row, column) = (m.x_axis.normalize(), m.y_axis.normalize());
    decimals(set, tags::IMAGE_ORIENTATION_PATIENT, &[row.to_array(), column.to_array()].concat());
}

fn position(set: &mut InMemDicomObject, volume: &PhantomVolume, z: usize) {
    let p = volume.voxel_to_lps.transform_point3(glam::DVec3::Z * z as f64);
    decimals(set, tags::IMAGE_POSITION_PATIENT, &p.to_array());
}

/// Distances between rows and columns, thickness.
fn measures(set: &mut InMemDicomObject, volume: &PhantomVolume) {
    let spacing = crate::frame::spacing(&volume.voxel_to_lps);
    decimals(set, tags::PIXEL_SPACING, &[spacing.y, spacing.x]);
    decimals(set, tags::SLICE_THICKNESS, &[spacing.z]);
}

fn ct_slice(volume: &PhantomVolume, names: &Names, z: usize) -> InMemDicomObject {
    let plane = volume.dims[0] * volume.dims[1];
    item(|s| {
        common(s, volume, names, uids::CT_IMAGE_STORAGE, &names.uid(10, z), (3, "CT", "synthetic abdomen"));
        text(s, tags::IMAGE_TYPE, VR::CS, "DERIVED\\PRIMARY\\AXIAL");
        text(s, tags::INSTANCE_NUMBER, VR::IS, &(z + 1).to_string());
        text(s, tags::PATIENT_POSITION, VR::CS, "HFS");
        text(s, tags::KVP, VR::DS, "120");
        orientation(s, volume);
        position(s, volume, z);
        measures(s, volume);
        short(s, tags::BITS_ALLOCATED, 16);
        short(s, tags::BITS_STORED, 16);
        short(s, tags::HIGH_BIT, 15);
        decimals(s, tags::RESCALE_INTERCEPT, &[-f64::from(OFFSET)]);
        decimals(s, tags::RESCALE_SLOPE, &[1.0]);
        text(s, tags::RESCALE_TYPE, VR::LO, "HU");
        decimals(s, tags::WINDOW_CENTER, &[60.0]);
        decimals(s, tags::WINDOW_WIDTH, &[500.0]);
        let stored: Vec<u16> =
            volume.hu[z * plane..(z + 1) * plane].iter().map(|v| (i32::from(*v) + OFFSET).clamp(0, 65535) as u16).collect();
        s.put(DataElement::new(tags::PIXEL_DATA, VR::OW, PrimitiveValue::U16(stored.into())));
    })
}

/// Code sequence item (PS3.3 8.8).
fn code(value: &str, scheme: &str, meaning: &str) -> Vec<InMemDicomObject> {
    vec![item(|s| {
        text(s, tags::CODE_VALUE, VR::SH, value);
        text(s, tags::CODING_SCHEME_DESIGNATOR, VR::SH, scheme);
        text(s, tags::CODE_MEANING, VR::LO, meaning);
    })]
}

fn segmentation(volume: &PhantomVolume, names: &Names) -> InMemDicomObject {
    let [nx, ny, nz] = volume.dims;
    let plane = nx * ny;
    let frames: Vec<(usize, usize)> = (0..volume.structures.len())
        .flat_map(|s| (0..nz).map(move |z| (s, z)))
        .filter(|(s, z)| volume.masks[*s][z * plane..(z + 1) * plane].iter().any(|v| *v != 0))
        .collect();
    let mut bits = vec![0_u8; (frames.len() * plane).div_ceil(8)];
    for (f, (s, z)) in frames.iter().enumerate() {
        for (i, v) in volume.masks[*s][z * plane..(z + 1) * plane].iter().enumerate() {
            let at = f * plane + i;
            bits[at / 8] |= (*v & 1) << (at % 8);
        }
    }
    // A value of bytes has an even length (PS3.5 7.1.1).
    if bits.len() % 2 == 1 {
        bits.push(0);
    }
    item(|s| {
        common(s, volume, names, uids::SEGMENTATION_STORAGE, &names.uid(11, 0), (4, "SEG", "synthetic abdomen, segments"));
        text(s, tags::IMAGE_TYPE, VR::CS, "DERIVED\\PRIMARY");
        text(s, tags::INSTANCE_NUMBER, VR::IS, "1");
        text(s, tags::CONTENT_LABEL, VR::CS, "PHANTOM");
        text(s, tags::CONTENT_DESCRIPTION, VR::LO, "structures of the phantom");
        text(s, tags::CONTENT_CREATOR_NAME, VR::PN, "Keyhole");
        text(s, tags::SEGMENTATION_TYPE, VR::CS, "BINARY");
        text(s, tags::LOSSY_IMAGE_COMPRESSION, VR::CS, "00");
        short(s, tags::BITS_ALLOCATED, 1);
        short(s, tags::BITS_STORED, 1);
        short(s, tags::HIGH_BIT, 0);
        text(s, tags::NUMBER_OF_FRAMES, VR::IS, &frames.len().to_string());
        sequence(
            s,
            tags::REFERENCED_SERIES_SEQUENCE,
            vec![item(|r| {
                text(r, tags::SERIES_INSTANCE_UID, VR::UI, &names.uid(3, 0));
                let instances = (0..nz).map(|z| {
                    item(|i| {
                        text(i, tags::REFERENCED_SOP_CLASS_UID, VR::UI, uids::CT_IMAGE_STORAGE);
                        text(i, tags::REFERENCED_SOP_INSTANCE_UID, VR::UI, &names.uid(10, z));
                    })
                });
                sequence(r, tags::REFERENCED_INSTANCE_SEQUENCE, instances.collect());
            })],
        );
        let organization = names.uid(5, 0);
        sequence(
            s,
            tags::DIMENSION_ORGANIZATION_SEQUENCE,
            vec![item(|d| text(d, tags::DIMENSION_ORGANIZATION_UID, VR::UI, &organization))],
        );
        let index = |pointer: Tag, group: Tag| {
            item(|d| {
                text(d, tags::DIMENSION_ORGANIZATION_UID, VR::UI, &organization);
                d.put(DataElement::new(tags::DIMENSION_INDEX_POINTER, VR::AT, dicom_value!(Tags, [pointer])));
                d.put(DataElement::new(tags::FUNCTIONAL_GROUP_POINTER, VR::AT, dicom_value!(Tags, [group])));
            })
        };
        let indices = vec![
            index(tags::REFERENCED_SEGMENT_NUMBER, tags::SEGMENT_IDENTIFICATION_SEQUENCE),
            index(tags::IMAGE_POSITION_PATIENT, tags::PLANE_POSITION_SEQUENCE),
        ];
        sequence(s, tags::DIMENSION_INDEX_SEQUENCE, indices);
        let segments = volume.structures.iter().map(|structure| {
            item(|g| {
                short(g, tags::SEGMENT_NUMBER, u16::from(structure.number));
                text(g, tags::SEGMENT_LABEL, VR::LO, structure.name);
                text(g, tags::SEGMENT_ALGORITHM_TYPE, VR::CS, "AUTOMATIC");
                text(g, tags::SEGMENT_ALGORITHM_NAME, VR::LO, "implicit functions");
                sequence(g, tags::SEGMENTED_PROPERTY_CATEGORY_CODE_SEQUENCE, code("123037004", "SCT", "Anatomical Structure"));
                sequence(g, tags::SEGMENTED_PROPERTY_TYPE_CODE_SEQUENCE, code("85756007", "SCT", "Tissue"));
            })
        });
        sequence(s, tags::SEGMENT_SEQUENCE, segments.collect());
        let shared = item(|g| {
            sequence(g, tags::PLANE_ORIENTATION_SEQUENCE, vec![item(|o| orientation(o, volume))]);
            let spacing = crate::frame::spacing(&volume.voxel_to_lps);
            let m = item(|m| {
                measures(m, volume);
                decimals(m, tags::SPACING_BETWEEN_SLICES, &[spacing.z]);
            });
            sequence(g, tags::PIXEL_MEASURES_SEQUENCE, vec![m]);
        });
        sequence(s, tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE, vec![shared]);
        let per_frame = frames.iter().map(|(structure, z)| {
            let number = volume.structures[*structure].number;
            item(|g| {
                let content = item(|c| {
                    c.put(DataElement::new(tags::DIMENSION_INDEX_VALUES, VR::UL, dicom_value!(U32, [u32::from(number), *z as u32 + 1])));
                });
                sequence(g, tags::FRAME_CONTENT_SEQUENCE, vec![content]);
                sequence(
                    g,
                    tags::SEGMENT_IDENTIFICATION_SEQUENCE,
                    vec![item(|i| short(i, tags::REFERENCED_SEGMENT_NUMBER, number.into()))],
                );
                sequence(g, tags::PLANE_POSITION_SEQUENCE, vec![item(|p| position(p, volume, *z))]);
            })
        });
        sequence(s, tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE, per_frame.collect());
        s.put(DataElement::new(tags::PIXEL_DATA, VR::OB, PrimitiveValue::from(bits)));
    })
}

fn save(set: InMemDicomObject, class: &str, path: &Path) -> Result<(), ImagingError> {
    let fail = |e: Box<dyn std::error::Error + Send + Sync>| ImagingError::Io { path: path.into(), source: std::io::Error::other(e) };
    let instance = set.get(tags::SOP_INSTANCE_UID).and_then(|e| e.to_str().ok()).map(|s| s.into_owned()).unwrap_or_default();
    let meta = FileMetaTableBuilder::new()
        .media_storage_sop_class_uid(class)
        .media_storage_sop_instance_uid(instance)
        .transfer_syntax(uids::EXPLICIT_VR_LITTLE_ENDIAN);
    let object = set.with_meta(meta).map_err(|e| fail(Box::new(e)))?;
    crate::publish::whole_file(path, |out| object.write_all(out).map_err(|e| fail(Box::new(e))))
}
