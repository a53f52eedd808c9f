//! One clear error for each kind of bad input, and no panic and no large allocation for any bytes at all.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

mod common;
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
    let options = MeshOptions { edge_mm, component, centring: Centring::Origin };
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
    assert!(matches!(mesh(border, ComponentChoice::Auto, 3.0), Err(ImagingError::Border { side: "first x", .. })));
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
}
