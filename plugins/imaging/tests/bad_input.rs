//! One clear error for each kind of bad input, and no panic and no large allocation for any bytes at all.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

mod common;
#[path = "common/ct.rs"]
mod ct;
#[path = "common/nifti.rs"]
mod nifti_bytes;

use common::labels;
use keyhole_imaging::dicom_series::Gaps;
use keyhole_imaging::phantom::{PhantomSettings, sample};
use keyhole_imaging::{
    Centring, ComponentChoice, ImagingError, LabelVolume, MeshOptions, Selection, dicom_series, dicom_write, input, pipeline,
};
use nifti_bytes::nifti;
use proptest::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

const DIMS: [usize; 3] = [16, 14, 12];

/// A block of 1 with a 2 in it, and a 3 at the border.
fn block() -> Vec<u8> {
    let mut voxels = vec![0; DIMS.iter().product()];
    for (i, v) in voxels.iter_mut().enumerate() {
        let [x, y, z] = [i % 16, i / 16 % 14, i / 224];
        *v = u8::from((4..12).contains(&x) && (4..10).contains(&y) && (3..9).contains(&z));
        *v += u8::from(*v == 1 && x > 8);
        if x == 0 && y == 0 {
            *v = 3;
        }
    }
    voxels
}

fn sform(sx: f32) -> Option<[[f32; 4]; 3]> {
    Some([[2.0, sx, 0.0, 0.0], [0.0, 2.0, 0.0, 0.0], [0.0, 0.0, 2.0, 0.0]])
}

fn valid() -> Vec<u8> {
    nifti(DIMS, [1.0, 2.0, 2.0, 2.0], sform(0.0), None, &block())
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut gz = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    std::io::Write::write_all(&mut gz, bytes).unwrap();
    gz.finish().unwrap()
}

fn read(bytes: &[u8], choices: &[(&str, i64)]) -> Result<LabelVolume, ImagingError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("input");
    std::fs::write(&path, bytes).unwrap();
    input::read(&path, &Selection::Labels(labels(choices)))
}

fn mesh(volume: LabelVolume, component: ComponentChoice, edge_mm: f64) -> Result<(), ImagingError> {
    let options = MeshOptions { edge_mm, core_doublings: 0, component, centring: Centring::Origin };
    pipeline::mesh(volume, &options, &mut |_| {}).map(|_| ())
}

#[test]
fn a_valid_volume_is_meshed_and_each_mistake_is_named() {
    let good = read(&valid(), &[("organ", 1), ("inner", 2)]).unwrap();
    mesh(good.clone(), ComponentChoice::Auto, 3.0).unwrap();
    assert!(matches!(mesh(good.clone(), ComponentChoice::Auto, f64::NAN), Err(ImagingError::Edge { .. })));
    assert!(matches!(mesh(good.clone(), ComponentChoice::Auto, -1.0), Err(ImagingError::Edge { .. })));
    assert!(matches!(mesh(good.clone(), ComponentChoice::Auto, 1e-3), Err(ImagingError::Edge { .. })));
    assert!(matches!(mesh(good.clone(), ComponentChoice::Auto, 500.0), Err(ImagingError::Edge { .. })));
    assert!(matches!(mesh(good.clone(), ComponentChoice::Rank(5), 3.0), Err(ImagingError::NoComponent { wanted: 5, count: 1, .. })));
    let outside = ComponentChoice::Seed(keyhole_tetmesh::DVec3::splat(900.0));
    assert!(matches!(mesh(good, outside, 3.0), Err(ImagingError::Seed { .. })));

    let border = read(&valid(), &[("organ", 3)]).unwrap();
    let options = MeshOptions { edge_mm: 1.0, core_doublings: 0, component: ComponentChoice::Auto, centring: Centring::Origin };
    let (_, report) = pipeline::mesh(border, &options, &mut |_| {}).unwrap();
    assert!(report.notes[0].contains("reaches the first x and the first y and the first z and the last z border"), "{:?}", report.notes);
    assert!(report.closed_manifold && report.volume_error_percent.abs() < 2.0, "{report}");
    let unknown = read(&valid(), &[("organ", 9)]).unwrap_err();
    assert!(unknown.to_string().contains("organ=9") && unknown.to_string().contains("0, 1, 2, 3"), "{unknown}");
    let empty = nifti(DIMS, [1.0, 2.0, 2.0, 2.0], sform(0.0), None, &vec![0; DIMS.iter().product()]);
    assert!(matches!(read(&empty, &[("organ", 1)]), Err(ImagingError::UnknownLabel { .. })));
    let sheared = nifti(DIMS, [1.0, 2.0, 2.0, 2.0], sform(0.4), None, &block());
    let straight = read(&sheared, &[("organ", 1)]).unwrap();
    assert!(straight.notes[0].contains("11.3 degrees"), "{:?}", straight.notes);
    let flattened = nifti(DIMS, [1.0, 2.0, 2.0, 2.0], sform(9.0), None, &block());
    assert!(matches!(read(&flattened, &[("organ", 1)]), Err(ImagingError::Sheared { .. })));
    let flat = nifti(DIMS, [1.0, 0.0, 2.0, 2.0], None, None, &block());
    assert!(matches!(read(&flat, &[("organ", 1)]), Err(ImagingError::Format { .. })));
    let nowhere = input::read(Path::new("no/such/file.nii"), &Selection::Labels(labels(&[("organ", 1)])));
    assert!(matches!(nowhere, Err(ImagingError::Io { .. })));
}

#[test]
fn truncated_foreign_and_boasting_files_are_refused() {
    let whole = valid();
    assert!(matches!(read(&whole[..whole.len() - 1], &[("organ", 1)]), Err(ImagingError::Truncated { .. })));
    let packed = gzip(&whole);
    read(&packed, &[("organ", 1)]).unwrap();
    assert!(matches!(
        read(&packed[..packed.len() / 2], &[("organ", 1)]),
        Err(ImagingError::Truncated { .. } | ImagingError::Format { .. })
    ));
    for foreign in [&b""[..], b"hello", &[0x1f, 0x8b, 8, 0], &[7; 4096]] {
        assert!(matches!(read(foreign, &[("organ", 1)]), Err(ImagingError::Format { .. })));
    }
    // A header of a few hundred bytes that declares 2^45 of them.
    for wrap in [|b: &[u8]| b.to_vec(), |b: &[u8]| gzip(b)] {
        let boast = nifti([32767, 32767, 32767], [1.0; 4], sform(0.0), None, &[0; 64]);
        assert!(matches!(read(&wrap(&boast), &[("organ", 1)]), Err(ImagingError::Format { .. } | ImagingError::Truncated { .. })));
        let boast = nifti([2000, 1000, 1000], [1.0; 4], sform(0.0), None, &[0; 64]);
        assert!(matches!(read(&wrap(&boast), &[("organ", 1)]), Err(ImagingError::Truncated { .. })));
    }
}

/// An archive of two stored members, with one field of the second's record in the central directory overwritten.
fn archive(member: &[u8], field: usize, value: u32) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for name in ["a", "b"] {
        zip.start_file(name, zip::write::SimpleFileOptions::default()).unwrap();
        std::io::Write::write_all(&mut zip, member).unwrap();
    }
    let mut bytes = zip.finish().unwrap().into_inner();
    let record = bytes.windows(4).rposition(|w| w == b"PK\x01\x02").unwrap();
    bytes[record + field..record + field + 4].copy_from_slice(&value.to_le_bytes());
    bytes
}

#[test]
fn archives_that_would_fill_a_disk_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("input.zip");
    let refusal = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        dicom_series::find(&path, None, Gaps::Refuse).map(|_| ()).unwrap_err().to_string()
    };
    let slice = &dicom()[0];
    // Fields of a record: compressed size at 20, size at 24, place of the member at 42.
    let shared = refusal(&archive(slice, 42, 0));
    assert!(shared.contains("share their bytes"), "{shared}");
    let bomb = refusal(&archive(slice, 24, 0xf000_0000));
    assert!(bomb.contains("3840 MB unpacked") && bomb.contains("200 times"), "{bomb}");
    let liar = refusal(&archive(slice, 24, 300));
    assert!(liar.contains("larger than its declared uncompressed size"), "{liar}");
    let beyond = refusal(&archive(slice, 20, 0x0fff_ffff));
    assert!(beyond.contains("share their bytes") || beyond.contains("broken zip"), "{beyond}");
}

#[test]
fn selections_that_do_not_fit_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let of = |s: &Selection, p: &Path| input::read(p, s).unwrap_err().to_string();
    let threshold = Selection::Threshold { low: 0.0, high: 1.0, series: None, gaps: Gaps::Refuse };
    assert!(of(&threshold, folder.path()).contains("holds no CT image"));
    assert!(of(&Selection::Labels(labels(&[("a", 1)])), folder.path()).contains("--threshold"));
    let file = folder.path().join("x.nii");
    std::fs::write(&file, valid()).unwrap();
    assert!(of(&threshold, &file).contains("holds no CT image"));
    assert!(of(&Selection::Labels(Vec::new()), &file).contains("--label"));
}

/// A small CT slice and a segmentation, as bytes.
fn dicom() -> &'static [Vec<u8>; 2] {
    static FILES: OnceLock<[Vec<u8>; 2]> = OnceLock::new();
    FILES.get_or_init(|| {
        let settings = PhantomSettings { pixel_mm: 10.0, slice_mm: 10.0, noise_hu: 0.0, seed: 0 };
        let folder = tempfile::tempdir().unwrap();
        let files: Vec<PathBuf> = dicom_write::write(folder.path(), &settings, &sample(&settings), &mut || {}).unwrap();
        [std::fs::read(&files[0]).unwrap(), std::fs::read(&files[files.len() - 1]).unwrap()]
    })
}

/// Bytes replaced, runs removed or doubled, the end cut off.
fn mutate(bytes: &[u8], changes: &[(usize, u8, u8)]) -> Vec<u8> {
    let mut out = bytes.to_vec();
    for (at, kind, value) in changes {
        if out.is_empty() {
            break;
        }
        let at = at % out.len();
        let end = (at + usize::from(*value)).min(out.len());
        match kind % 8 {
            0 => drop(out.drain(at..end)),
            1 => {
                let run = out[at..end].to_vec();
                out.splice(at..at, run);
            }
            2 => out.truncate(at.max(1)),
            3 => out[at] = 0xff,
            _ => out[at] = *value,
        }
    }
    out
}

/// Blobs of two labels, some bigger than what they lie in, some alone, some cut off by the border, on voxels of any shape.
fn blobs() -> impl Strategy<Value = Vec<([f64; 3], f64, u8)>> {
    prop::collection::vec((prop::array::uniform3(-2.0f64..26.0), 2.0f64..11.0, 1u8..3), 1..7)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn the_ugliest_labels_are_meshed_within_the_bounds(blobs in blobs(), spacing in prop::array::uniform3(0.7f32..4.5), edge in 2.0f64..6.0) {
        let dims = [24; 3];
        let voxels: Vec<u8> = (0..24 * 24 * 24)
            .map(|i| {
                let p = [i % 24, i / 24 % 24, i / 576].map(f64::from);
                let inside = |(c, r, _): &&([f64; 3], f64, u8)| (0..3).map(|a| (p[a] - c[a]).powi(2)).sum::<f64>() < r * r;
                blobs.iter().filter(inside).map(|(.., part)| *part).next_back().unwrap_or(0)
            })
            .collect();
        let form = |a: usize| std::array::from_fn(|c| if c == a { spacing[a] } else { 0.0 });
        let bytes = nifti(dims, [1.0, spacing[0], spacing[1], spacing[2]], Some([form(0), form(1), form(2)]), None, &voxels);
        let Ok(volume) = read(&bytes, &[("organ", 1), ("inner", 2)]) else { return Ok(()) };
        for (component, core_doublings) in [(ComponentChoice::Auto, 0), (ComponentChoice::All, 2)] {
            let options = MeshOptions { edge_mm: edge, core_doublings, component, centring: Centring::Patient };
            match pipeline::mesh(volume.clone(), &options, &mut |_| {}) {
                Ok((_, report)) => {
                    prop_assert!(report.closed_manifold && report.min_dihedral_deg > 10.65 && report.max_dihedral_deg < 164.85, "{report}");
                }
                Err(ImagingError::Edge { .. } | ImagingError::Unresolved { .. }) => {}
                Err(other) => prop_assert!(false, "{other}"),
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn mutated_nifti_never_panics(
        changes in prop::collection::vec((0usize..352 + 4096, any::<u8>(), any::<u8>()), 1..6),
        packed in any::<bool>(),
    ) {
        let bytes = mutate(&valid(), &changes);
        let bytes = if packed { mutate(&gzip(&bytes), &changes[..changes.len() / 2]) } else { bytes };
        if let Ok(volume) = read(&bytes, &[("organ", 1), ("inner", 2)]) {
            // What can be read can be meshed or is refused.
            drop(mesh(volume, ComponentChoice::Auto, 8.0));
        }
    }

    #[test]
    fn mutated_dicom_never_panics(changes in prop::collection::vec((any::<usize>(), any::<u8>(), any::<u8>()), 1..6), near in any::<bool>()) {
        let [slice, seg] = dicom();
        // Half of the changes hit the headers, where there is more to break.
        let changes: Vec<_> = changes.into_iter().map(|(at, k, v)| (if near { at % 3000 } else { at }, k, v)).collect();
        if let Ok(volume) = read(&mutate(seg, &changes), &[("organ", 1), ("inner", 2)]) {
            drop(mesh(volume, ComponentChoice::Auto, 30.0));
        }
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("a.dcm"), mutate(slice, &changes)).unwrap();
        std::fs::write(folder.path().join("b.dcm"), slice).unwrap();
        if let Ok(series) = dicom_series::find(folder.path(), None, Gaps::Interpolate) {
            drop(series.read());
        }
    }

    #[test]
    fn mutated_series_archives_and_directories_never_panic(
        changes in prop::collection::vec((any::<usize>(), any::<u8>(), any::<u8>()), 1..6),
        kind in 0usize..5,
        near in any::<bool>(),
    ) {
        let changes: Vec<_> = changes.into_iter().map(|(at, k, v)| (if near { at % 900 } else { at }, k, v)).collect();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("input");
        let place = if kind < 3 { folder.path() } else { &path };
        std::fs::write(&path, mutate(&kinds()[kind], &changes)).unwrap();
        for name in ["a", "b"] {
            std::fs::write(folder.path().join(name), &kinds()[0]).unwrap();
        }
        for gaps in [Gaps::Refuse, Gaps::Interpolate] {
            if let Ok(series) = dicom_series::find(place, None, gaps) {
                drop(series.read());
            }
        }
        drop(input::segments(place));
        drop(input::read(place, &Selection::Labels(labels(&[("organ", 1)]))));
    }
}

/// Three kinds of CT images, an archive and a directory, as bytes.
fn kinds() -> &'static [Vec<u8>; 5] {
    use dicom_dictionary_std::uids;
    static FILES: OnceLock<[Vec<u8>; 5]> = OnceLock::new();
    FILES.get_or_init(|| {
        let hu: Vec<i32> = (0..16 * 12).collect();
        let at = ct::Ct::default();
        let runs = ct::file(at.run_lengths(&hu), uids::CT_IMAGE_STORAGE, uids::RLE_LOSSLESS);
        let deflated = ct::file(at.image(&hu), uids::CT_IMAGE_STORAGE, uids::DEFLATED_EXPLICIT_VR_LITTLE_ENDIAN);
        let frames: Vec<_> = (0..4).map(|z| ([0.0, 0.0, f64::from(z)], -1000.0, hu.clone())).collect();
        let enhanced = ct::file(at.enhanced(&frames), uids::ENHANCED_CT_IMAGE_STORAGE, uids::EXPLICIT_VR_LITTLE_ENDIAN);
        let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
        for z in 0..3 {
            let image = ct::Ct { position: [0.0, 0.0, f64::from(z)], ..ct::Ct::default() }.image(&hu);
            zip.start_file(format!("{z}"), zip::write::SimpleFileOptions::default()).unwrap();
            std::io::Write::write_all(&mut zip, &ct::file(image, uids::CT_IMAGE_STORAGE, uids::EXPLICIT_VR_LITTLE_ENDIAN)).unwrap();
        }
        let list = ct::file(ct::directory(&[vec!["a"], vec!["b"]]), uids::MEDIA_STORAGE_DIRECTORY_STORAGE, uids::EXPLICIT_VR_LITTLE_ENDIAN);
        [runs, deflated, enhanced, zip.finish().unwrap().into_inner(), list]
    })
}
