//! No file takes memory out of proportion to its size, whatever it declares.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

mod common;
#[path = "common/ct.rs"]
#[expect(dead_code, reason = "other tests use the rest")]
mod ct;
#[path = "common/nifti.rs"]
mod nifti_bytes;

use common::labels;
use ct::Ct;
use dicom_dictionary_std::{tags, uids};
use keyhole_imaging::dicom_series::{self, Gaps};
use keyhole_imaging::{Selection, input};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};
use std::alloc::System;

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// What any file may take, and what for each of its bytes: deflate makes a thousand of one, and buffers double as they grow.
const ANY: usize = 16 << 20;
const EACH: usize = 4200;

#[test]
fn boasting_files_take_little() {
    let gzip = |bytes: &[u8]| {
        let mut gz = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
        std::io::Write::write_all(&mut gz, bytes).unwrap();
        gz.finish().unwrap()
    };
    let boast = nifti_bytes::nifti([2000, 2000, 1000], [1.0; 4], None, None, &[0; 64]);
    let hu: Vec<i32> = vec![0; 16 * 12];
    let enlarged = |rows: u16, frames: &str| {
        let mut set = Ct::default().run_lengths(&hu);
        set.put(dicom_core::DataElement::new(tags::ROWS, dicom_core::VR::US, dicom_core::PrimitiveValue::from(rows)));
        set.put(dicom_core::DataElement::new(tags::NUMBER_OF_FRAMES, dicom_core::VR::IS, dicom_core::PrimitiveValue::from(frames)));
        ct::file(set, uids::CT_IMAGE_STORAGE, uids::RLE_LOSSLESS)
    };
    let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    zip.start_file("zeros", zip::write::SimpleFileOptions::default()).unwrap();
    std::io::Write::write_all(&mut zip, &vec![0; 8 << 20]).unwrap();
    let cases = [
        ("header", boast.clone()),
        ("packed header", gzip(&boast)),
        ("rows", enlarged(60000, "1")),
        ("frames", enlarged(12, "2000000000")),
        ("zip", zip.finish().unwrap().into_inner()),
    ];
    for (name, bytes) in cases {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("input");
        std::fs::write(&path, &bytes).unwrap();
        for copy in ["a", "b"] {
            std::fs::write(
                folder.path().join(copy),
                ct::file(
                    Ct { position: [0.0, 0.0, copy.len() as f64], ..Ct::default() }.image(&hu),
                    uids::CT_IMAGE_STORAGE,
                    uids::EXPLICIT_VR_LITTLE_ENDIAN,
                ),
            )
            .unwrap();
        }
        let region = Region::new(ALLOCATOR);
        drop(input::read(&path, &Selection::Labels(labels(&[("organ", 1)]))));
        for place in [&path, folder.path()] {
            if let Ok(series) = dicom_series::find(place, None, Gaps::Interpolate) {
                drop(series.read());
            }
        }
        let taken = region.change().bytes_allocated;
        assert!(taken < ANY + EACH * bytes.len(), "{name}: {taken} bytes for a file of {}", bytes.len());
    }
}
