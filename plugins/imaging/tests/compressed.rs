//! Compressed images as other encoders write them: what comes back is the picture, to the bit where the compression keeps it.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

#[path = "common/ct.rs"]
#[expect(dead_code, reason = "other tests use the rest")]
mod ct;

use ct::Ct;
use dicom_core::value::PixelFragmentSequence;
use dicom_core::{DataElement, PrimitiveValue, VR};
use dicom_dictionary_std::{tags, uids};
use keyhole_imaging::dicom_series::{self, Gaps};
use keyhole_imaging::{ImagingError, dicom_series::CtVolume};
use proptest::prelude::*;

const COLUMNS: u16 = 48;
const ROWS: u16 = 40;
const HIGH_THROUGHPUT: &str = "1.2.840.10008.1.2.4.201";

macro_rules! stream {
    ($name:literal) => {
        &include_bytes!(concat!("data/", $name))[..]
    };
}

/// The picture of `data/make_codestreams.py`, Hounsfield units.
fn picture() -> Vec<i32> {
    let at = |x: i32, y: i32| {
        if (x - 24).pow(2) + (y - 20).pow(2) < 300 { 40 + (x * 7 + y * 13) % 29 + x } else { -1000 + (x * y) % 7 }
    };
    (0..i32::from(ROWS)).flat_map(|y| (0..i32::from(COLUMNS)).map(move |x| at(x, y))).collect()
}

/// How words are stored.
#[derive(Clone, Copy)]
enum Stored {
    Eight,
    Unsigned,
    Signed,
}

/// A slice with these fragments in the place of its pixels.
fn slice(stored: Stored, z: u32, syntax: &str, fragments: Vec<Vec<u8>>) -> Vec<u8> {
    let ct = Ct { instance: z, columns: COLUMNS, rows: ROWS, position: [0.0, 0.0, f64::from(z)], ..Ct::default() };
    let ct = match stored {
        Stored::Eight => Ct { slope: 16.0, ..ct },
        Stored::Unsigned => ct,
        Stored::Signed => Ct { signed: true, stored: 16, intercept: 0.0, ..ct },
    };
    let mut set = ct.image(&picture());
    if matches!(stored, Stored::Eight) {
        for (tag, value) in [(tags::BITS_ALLOCATED, 8_u16), (tags::BITS_STORED, 8), (tags::HIGH_BIT, 7)] {
            set.put(DataElement::new(tag, VR::US, PrimitiveValue::from(value)));
        }
    }
    set.put(DataElement::new(tags::PIXEL_DATA, VR::OB, PixelFragmentSequence::new(Vec::<u32>::new(), fragments)));
    ct::file(set, uids::CT_IMAGE_STORAGE, syntax)
}

/// Three slices of the same codestream.
fn read(stored: Stored, syntax: &str, stream: &[u8]) -> Result<CtVolume, ImagingError> {
    let folder = tempfile::tempdir().unwrap();
    let mut padded = stream.to_vec();
    padded.resize(stream.len().next_multiple_of(2), 0);
    for z in 0..3 {
        std::fs::write(folder.path().join(z.to_string()), slice(stored, z, syntax, vec![padded.clone()])).unwrap();
    }
    dicom_series::find(folder.path(), None, Gaps::Refuse).and_then(|s| s.read())
}

#[test]
fn every_compression_comes_back_as_near_as_it_promises() {
    // Sixteen units a step in eight bits; a JPEG of quality 95 is off by some steps at an edge.
    let cases = [
        ("JPEG baseline", Stored::Eight, uids::JPEG_BASELINE8_BIT, stream!("baseline.jpg"), 16 * 12),
        ("JPEG lossless", Stored::Unsigned, uids::JPEG_LOSSLESS, stream!("lossless.jpg"), 0),
        ("JPEG lossless, first predictor", Stored::Unsigned, uids::JPEG_LOSSLESS_SV1, stream!("lossless.jpg"), 0),
        ("JPEG-LS", Stored::Unsigned, uids::JPEGLS_LOSSLESS, stream!("lossless.jls"), 0),
        ("JPEG-LS, near lossless", Stored::Unsigned, uids::JPEGLS_NEAR_LOSSLESS, stream!("near3.jls"), 3),
        ("JPEG-LS, 8 bits", Stored::Eight, uids::JPEGLS_LOSSLESS, stream!("eight.jls"), 15),
        ("JPEG 2000, reversible", Stored::Unsigned, uids::JPEG2000_LOSSLESS, stream!("reversible.j2k"), 0),
        ("JPEG 2000, signed", Stored::Signed, uids::JPEG2000_LOSSLESS, stream!("signed.j2k"), 0),
        ("JPEG 2000, irreversible", Stored::Unsigned, uids::JPEG2000, stream!("irreversible.j2k"), 8),
        ("JPEG 2000, 8 bits", Stored::Eight, uids::JPEG2000_LOSSLESS, stream!("eight.j2k"), 15),
    ];
    for (name, stored, syntax, stream, most) in cases {
        let volume = read(stored, syntax, stream).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert_eq!(volume.dims, [COLUMNS.into(), ROWS.into(), 3], "{name}");
        let off = volume.hu.iter().zip(picture().iter().cycle()).map(|(a, b)| (a - *b as f32).abs()).fold(0.0, f32::max);
        println!("{name}: off by {off} HU at most");
        assert!(off <= most as f32, "{name}: off by {off}, expected {most} at most");
    }
}

#[test]
fn what_is_refused_is_refused_by_name_with_what_to_do() {
    let refused = |syntax, stream| read(Stored::Unsigned, syntax, stream).unwrap_err().to_string();
    for (message, name) in [
        (refused(HIGH_THROUGHPUT, stream!("high_throughput.j2k")), "High-Throughput JPEG 2000"),
        // Under a wrong name, it is what it is.
        (refused(uids::JPEG2000_LOSSLESS, stream!("high_throughput.j2k")), "High-Throughput JPEG 2000"),
        (refused(uids::JPEGXL_LOSSLESS, stream!("reversible.j2k")), "JPEG XL"),
        (refused(uids::JPEGLS_LOSSLESS, stream!("reversible.j2k")), "JPEG-LS"),
        (refused(uids::JPEG2000, stream!("lossless.jls")), "JPEG 2000"),
    ] {
        assert!(message.contains(name) && message.contains("convert it"), "{message}");
    }
}

/// The decoder of JPEG copies what a frame declares to where the file's rows and columns end.
#[test]
fn a_jpeg_of_another_size_than_its_file_is_refused() {
    for (name, syntax, stream) in
        [("baseline", uids::JPEG_BASELINE8_BIT, stream!("baseline.jpg")), ("lossless", uids::JPEG_LOSSLESS, stream!("lossless.jpg"))]
    {
        let header = stream.windows(2).position(|w| w == [0xff, 0xc0] || w == [0xff, 0xc3]).unwrap();
        // Rows are at 5, columns at 7.
        for field in [5, 7] {
            let mut bytes = stream.to_vec();
            bytes[header + field] = 0x7f;
            let message = read(Stored::Eight, syntax, &bytes).unwrap_err().to_string();
            assert!(message.contains("frame headers") && message.contains("(48, 40, 1)"), "{name}: {message}");
        }
    }
}

#[test]
fn an_image_may_be_in_several_fragments() {
    let folder = tempfile::tempdir().unwrap();
    let stream = stream!("reversible.j2k");
    for z in 0..3 {
        let fragments = stream.chunks(400).map(|c| c.iter().copied().chain([0]).take(c.len().next_multiple_of(2)).collect()).collect();
        std::fs::write(folder.path().join(z.to_string()), slice(Stored::Unsigned, z, uids::JPEG2000_LOSSLESS, fragments)).unwrap();
    }
    let volume = dicom_series::find(folder.path(), None, Gaps::Refuse).unwrap().read().unwrap();
    assert!(volume.hu.iter().zip(picture().iter().cycle()).all(|(a, b)| *a == *b as f32));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn damaged_codestreams_never_panic(
        which in 0usize..6,
        changes in prop::collection::vec((any::<usize>(), any::<u8>(), any::<u8>()), 1..6),
        near in any::<bool>(),
    ) {
        let kinds = [
            (uids::JPEGLS_LOSSLESS, stream!("lossless.jls")),
            (uids::JPEGLS_NEAR_LOSSLESS, stream!("near3.jls")),
            (uids::JPEG2000_LOSSLESS, stream!("reversible.j2k")),
            (uids::JPEG2000, stream!("irreversible.j2k")),
            (uids::JPEG_LOSSLESS, stream!("lossless.jpg")),
            (uids::JPEG_BASELINE8_BIT, stream!("baseline.jpg")),
        ];
        let (syntax, stream) = kinds[which];
        let mut bytes = stream.to_vec();
        for (at, kind, value) in changes {
            // Half of the changes hit the headers.
            let at = if near { at % 120.min(bytes.len()) } else { at % bytes.len() };
            match kind % 4 {
                0 => bytes.truncate(at.max(1)),
                1 => bytes[at] = 0xff,
                2 => bytes[at] ^= 1 << (value % 8),
                _ => bytes[at] = value,
            }
        }
        drop(read(Stored::Unsigned, syntax, &bytes));
    }
}
