//! The phantom goes out as DICOM and comes back as what it was.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

mod common;

use common::labels;
use keyhole_imaging::dicom_series::Gaps;
use keyhole_imaging::phantom::{PhantomSettings, abdomen, sample};
use keyhole_imaging::{
    Centring, ComponentChoice, ImagingError, MeshOptions, Selection, dicom_seg, dicom_series, dicom_write, frame, input, pipeline,
};
use keyhole_tetmesh::{Boundary, DVec3};

/// Coarse, and with an odd number of pixels a slice, so that frames of bits do not start on bytes.
const COARSE: PhantomSettings = PhantomSettings { pixel_mm: 3.0, slice_mm: 4.0, noise_hu: 10.0, seed: 7 };

fn written(settings: &PhantomSettings) -> (tempfile::TempDir, keyhole_imaging::phantom::PhantomVolume) {
    let folder = tempfile::tempdir().unwrap();
    let volume = sample(settings);
    dicom_write::write(folder.path(), settings, &volume, &mut || {}).unwrap();
    (folder, volume)
}

#[test]
fn the_ct_comes_back_in_order_and_the_same() {
    let (folder, volume) = written(&COARSE);
    // Names tell nothing: the first becomes the last.
    std::fs::rename(folder.path().join("ct_0000.dcm"), folder.path().join("zzz.dcm")).unwrap();
    let series = dicom_series::find(folder.path(), None, Gaps::Refuse).unwrap();
    let ct = series.read().unwrap();
    assert_eq!(ct.dims, volume.dims);
    assert!(ct.hu.iter().zip(&volume.hu).all(|(a, b)| *a == f32::from(*b)));
    let corner = DVec3::from_array(volume.dims.map(|n| n as f64));
    assert!(ct.voxel_to_lps.transform_point3(corner).distance(volume.voxel_to_lps.transform_point3(corner)) < 1e-3);

    std::fs::remove_file(folder.path().join("ct_0030.dcm")).unwrap();
    let error = dicom_series::find(folder.path(), None, Gaps::Refuse).unwrap_err();
    assert!(matches!(error, ImagingError::Irregular { .. }));
    let message = error.to_string();
    assert!(message.contains("ct_0029.dcm") && message.contains("1 slice(s) are missing") && message.contains("ct_0031.dcm"), "{message}");
    let filled = dicom_series::find(folder.path(), None, Gaps::Interpolate).unwrap();
    assert!(filled.notes[0].contains("1 missing slice(s)"), "{:?}", filled.notes);
    let filled = filled.read().unwrap();
    assert_eq!(filled.dims, volume.dims);
    let plane = volume.dims[0] * volume.dims[1];
    assert!((0..plane).all(|i| (filled.hu[30 * plane + i] - (ct.hu[29 * plane + i] + ct.hu[31 * plane + i]) / 2.0).abs() < 0.1));
}

#[test]
fn every_segment_comes_back_bit_for_bit() {
    let (folder, volume) = written(&COARSE);
    let plane = volume.dims[0] * volume.dims[1];
    assert_ne!(plane % 8, 0);
    for (structure, mask) in volume.structures.iter().zip(&volume.masks) {
        let path = folder.path().join(dicom_write::SEGMENTATION_FILE);
        let read = dicom_seg::read_labels(&path, &labels(&[(structure.name, structure.number.into())])).unwrap();
        // Slices without a frame are left out of the file: the offset is found through the patient.
        let origin = read.voxel_to_lps.transform_point3(DVec3::ZERO);
        let shift = (volume.voxel_to_lps.inverse().transform_point3(origin)).round();
        let shift = shift.z as isize;
        let mut seen = 0;
        for (i, v) in read.parts.iter().enumerate().filter(|(_, v)| **v != 0) {
            let at = i as isize + shift * plane as isize;
            assert_eq!((*v, mask[at as usize]), (1, 1), "{} at {i}", structure.name);
            seen += 1;
        }
        assert_eq!(seen, mask.iter().filter(|v| **v != 0).count(), "{}", structure.name);
    }
}

#[test]
fn the_kidney_has_the_volume_of_its_functions() {
    let (folder, _) = written(&PhantomSettings { noise_hu: 0.0, ..PhantomSettings::default() });
    let selection = Selection::Labels(labels(&[("kidney", 1), ("tumour", 2)]));
    let read = input::read(&folder.path().join(dicom_write::SEGMENTATION_FILE), &selection).unwrap();
    let options = MeshOptions { edge_mm: 4.0, core_doublings: 0, component: ComponentChoice::Auto, centring: Centring::Patient };
    let (mesh, report) = pipeline::mesh(read, &options, &mut |_| {}).unwrap();
    // The functions themselves, on a grid that has nothing to do with the scan's.
    let structures = abdomen();
    let (step, mut count) = (0.7, 0_u32);
    let n = |length: f64| (length / step) as i32;
    for x in n(-40.0)..n(45.0) {
        for y in n(-45.0)..n(40.0) {
            for z in n(-70.0)..n(70.0) {
                let p = DVec3::new(f64::from(x) + 0.31, f64::from(y) + 0.17, f64::from(z) + 0.53) * step;
                count += u32::from(structures[..2].iter().any(|s| s.shape.distance(p) < 0.0));
            }
        }
    }
    let analytic = f64::from(count) * step.powi(3) * 1e-9;
    assert!((mesh.total_volume() / analytic - 1.0).abs() < 0.01, "{} m3, functions {analytic} m3", mesh.total_volume());
    assert!(report.closed_manifold && report.euler_characteristic == 2 && report.components == 1);
    assert!(Boundary::of(&mesh).is_closed_manifold());
    assert!(report.min_dihedral_deg >= 10.7 && report.max_dihedral_deg <= 164.8);
    // Its surface and the tumour's border lie where the functions have them.
    let boundary = Boundary::of(&mesh);
    let (mut off, mut most) = (0.0, 0.0_f64);
    for n in boundary.triangles.iter().flatten() {
        let p = frame::patient_from_world(mesh.rest(*n));
        let d = structures[..2].iter().map(|s| s.shape.distance(p)).fold(f64::INFINITY, f64::min).abs();
        (off, most) = (off + d, most.max(d));
    }
    off /= 3.0 * boundary.triangles.len() as f64;
    // Voxels of 1.5 mm; the crease between kidney and tumour is rounder than in the functions.
    assert!(off < 0.3 && most < 3.0, "the surface is off by {off}, at most {most} mm");
    assert!(report.borders[0].faces > 100 && report.borders[0].off.mean_mm < 0.3, "{:?}", report.borders);
    // The tumour: left, anterior, inferior of the kidney's middle, a ball of 30 mm.
    let (mut sum, mut volume) = (DVec3::ZERO, 0.0);
    for (t, _) in mesh.iter().filter(|(t, _)| mesh.tet(*t).material.0 == 1) {
        sum += mesh.points(t).iter().sum::<DVec3>() / 4.0 * mesh.volume(t);
        volume += mesh.volume(t);
    }
    let at = sum / volume * 1e3;
    assert!(at.distance(DVec3::new(17.0, -14.0, 17.5)) < 1.0, "{at}");
    assert!((volume * 1e9 / 14137.0 - 1.0).abs() < 0.05, "{volume}");
}

#[test]
fn thresholds_find_bone_and_the_border_is_told() {
    let (folder, _) = written(&PhantomSettings { noise_hu: 0.0, ..COARSE });
    let selection = |low, high| Selection::Threshold { low, high, series: None, gaps: Gaps::Refuse };
    let bone = input::read(folder.path(), &selection(449.0, 451.0)).unwrap();
    assert!(bone.parts.iter().any(|p| *p != 0));
    let whole = input::read(folder.path(), &selection(-100.0, 3000.0)).unwrap();
    let options = MeshOptions { edge_mm: 30.0, core_doublings: 0, component: ComponentChoice::Auto, centring: Centring::Patient };
    let notes = pipeline::mesh(whole, &options, &mut |_| {}).unwrap().1.notes;
    assert!(notes.iter().any(|n| n.contains("first z")), "{notes:?}");
    let seg = folder.path().join(dicom_write::SEGMENTATION_FILE);
    let body = input::read(&seg, &Selection::Labels(labels(&[("body", 12)]))).unwrap();
    let notes = pipeline::mesh(body, &options, &mut |_| {}).unwrap().1.notes;
    assert!(notes.iter().any(|n| n.contains("last z")), "a segment on every image is cut off: {notes:?}");
    let absent = dicom_seg::read_labels(&seg, &labels(&[("liver", 40)])).unwrap_err().to_string();
    assert!(absent.contains("liver=40") && absent.contains("1 (kidney_left)"), "{absent}");
}

/// Another library reads what was written, where Python has one.
#[test]
fn pydicom_reads_the_same() {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/common/pydicom_check.py");
    let python = |args: &[&std::ffi::OsStr]| std::process::Command::new("python3").args(args).output();
    if !python(&["-c".as_ref(), "import pydicom, numpy".as_ref()]).is_ok_and(|o| o.status.success()) {
        println!("skipped: python3 has no pydicom with numpy");
        return;
    }
    let (folder, volume) = written(&COARSE);
    let out = python(&[script.as_ref(), folder.path().as_ref()]).unwrap();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let [nx, ny, nz] = volume.dims;
    let sum: i64 = volume.hu.iter().map(|v| i64::from(*v)).sum();
    let mut want = format!("slices {nz} {nx} {ny}\nclass CT Image Storage\nunique {nz} 1\nsum {sum}\n");
    want += "segmentation Segmentation Storage BINARY True\nreferenced True\n";
    for (s, mask) in volume.structures.iter().zip(&volume.masks) {
        want += &format!("segment {} {} {}\n", s.number, s.name, mask.iter().filter(|v| **v != 0).count());
    }
    assert_eq!(String::from_utf8_lossy(&out.stdout), want);
}

/// Every surface that is only drawn keeps the volume of its voxels, thin vessels too.
#[test]
fn drawn_surfaces_keep_their_volume() {
    let (folder, volume) = written(&PhantomSettings { noise_hu: 0.0, pixel_mm: 2.0, slice_mm: 2.0, seed: 0 });
    for structure in volume.structures.iter().filter(|s| s.name != "body") {
        let file = folder.path().join(dicom_write::SEGMENTATION_FILE);
        let labels = dicom_seg::read_labels(&file, &labels(&[(structure.name, structure.number.into())])).unwrap();
        let (_, report) = keyhole_imaging::drawn::draw(labels, ComponentChoice::All, 2.0).unwrap();
        assert!(
            (report.surface_ml / report.mask_ml - 1.0).abs() < 0.01,
            "{}: {} of {} ml",
            structure.name,
            report.surface_ml,
            report.mask_ml
        );
    }
}

#[test]
fn a_contact_sheet_shows_the_ct_that_lies_beside_the_labels() {
    let (folder, _) = written(&COARSE);
    let selection = Selection::Labels(labels(&[("kidney", 1), ("tumour", 2)]));
    let options = MeshOptions { edge_mm: 8.0, core_doublings: 0, component: ComponentChoice::Auto, centring: Centring::Origin };
    let made = pipeline::make(input::read(folder.path(), &selection).unwrap(), &options, &mut |_| {}).unwrap();
    let ct = input::ct(folder.path(), &selection).unwrap();
    let [with, without] = [Some(&ct), None].map(|ct| made.contact_sheet(ct));
    // Fat in front of the kidney, -80 HU with 10 HU of noise, in a window from -160 to 240.
    assert_eq!(without.rgb[..3], [14, 16, 20]);
    let fat = &with.rgb[..3];
    assert!(fat[0] == fat[1] && fat[1] == fat[2] && fat[0].abs_diff(51) < 26, "{fat:?}");
    // The row of surfaces is the same, and so is every point of an outline.
    let surfaces = with.rgb.len() / 4 * 3;
    assert_eq!(with.rgb[surfaces..], without.rgb[surfaces..]);
    assert_ne!(with.rgb[..surfaces], without.rgb[..surfaces]);
    let seg = folder.path().join(dicom_write::SEGMENTATION_FILE);
    assert!(input::ct(&seg, &selection).is_none(), "labels alone have no CT");
}
