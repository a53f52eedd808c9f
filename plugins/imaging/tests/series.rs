//! CT series as they come: every way to write the same slices gives the same Hounsfield units in the same place.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

#[path = "common/ct.rs"]
mod ct;

use ct::{Ct, directory, file};
use dicom_dictionary_std::uids;
use keyhole_imaging::dicom_series::{CtVolume, Gaps, find, series_of};
use keyhole_tetmesh::DVec3;
use std::io::Write;
use std::path::Path;

const BIG_ENDIAN: &str = "1.2.840.10008.1.2.2";

/// Hounsfield units of a slice: no two alike.
fn hu(slice: usize) -> Vec<i32> {
    (0..16 * 12).map(|i| (i * 7 + slice as i32 * 131) % 2000 - 1000).collect()
}

fn at(slice: usize) -> Ct {
    Ct { instance: slice as u32 + 1, position: [5.0, -7.0, 2.5 * slice as f64], ..Ct::default() }
}

/// Reads files that were given names.
fn read(files: &[(&str, Vec<u8>)]) -> CtVolume {
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in files {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
    find(folder.path(), None, Gaps::Refuse).unwrap().read().unwrap()
}

fn assert_is_the_series(volume: &CtVolume, what: &str) {
    assert_eq!(volume.dims, [16, 12, 4], "{what}");
    for z in 0..4 {
        let want: Vec<f32> = hu(z).iter().map(|v| *v as f32).collect();
        assert_eq!(volume.hu[z * 192..(z + 1) * 192], want[..], "{what}: slice {z}");
    }
    let p = volume.voxel_to_lps.transform_point3(DVec3::new(2.0, 3.0, 1.0));
    assert!(p.distance(DVec3::new(7.0, -4.0, 2.5)) < 1e-6, "{what}: {p}");
}

fn single(make: impl Fn(usize) -> Vec<u8>) -> Vec<(&'static str, Vec<u8>)> {
    // Neither names nor folders tell the order.
    ["d.dcm", "deep/er/c", "b", "a.ima"].into_iter().enumerate().map(|(i, name)| (name, make(i))).collect()
}

#[test]
fn every_way_to_write_a_slice() {
    let class = uids::CT_IMAGE_STORAGE;
    for syntax in [uids::IMPLICIT_VR_LITTLE_ENDIAN, uids::EXPLICIT_VR_LITTLE_ENDIAN, BIG_ENDIAN, uids::DEFLATED_EXPLICIT_VR_LITTLE_ENDIAN] {
        assert_is_the_series(&read(&single(|z| file(at(z).image(&hu(z)), class, syntax))), syntax);
    }
    let plain = |ct: Ct, z| file(ct.image(&hu(z)), class, uids::EXPLICIT_VR_LITTLE_ENDIAN);
    assert_is_the_series(&read(&single(|z| file(at(z).run_lengths(&hu(z)), class, uids::RLE_LOSSLESS))), "run lengths");
    assert_is_the_series(&read(&single(|z| plain(Ct { signed: true, intercept: 0.0, ..at(z) }, z))), "signed");
    assert_is_the_series(
        &read(&single(|z| plain(Ct { intercept: -1000.0 - z as f64, ..at(z) }, z))),
        "a rescale of its own for each slice",
    );
    assert_is_the_series(&read(&single(|z| plain(Ct { photometric: "MONOCHROME1", ..at(z) }, z))), "drawn inverted");
    let frames: Vec<_> = [2, 0, 3, 1].map(|z| (at(z).position, -1000.0 - 3.0 * z as f64, hu(z))).into();
    let enhanced = file(at(0).enhanced(&frames), uids::ENHANCED_CT_IMAGE_STORAGE, uids::EXPLICIT_VR_LITTLE_ENDIAN);
    assert_is_the_series(&read(&[("one", enhanced)]), "enhanced");
}

#[test]
fn duplicates_localisers_and_other_series_are_left_out() {
    let class = uids::CT_IMAGE_STORAGE;
    let plain = |ct: Ct, z| file(ct.image(&hu(z)), class, uids::EXPLICIT_VR_LITTLE_ENDIAN);
    let mut files = single(|z| plain(at(z), z));
    files.push(("again", plain(Ct { instance: 99, ..at(1) }, 3)));
    files.push(("scout", plain(Ct { orientation: [1.0, 0.0, 0.0, 0.0, 0.0, -1.0], ..at(0) }, 0)));
    files.push(("readme.txt", b"not an image".to_vec()));
    assert_is_the_series(&read(&files), "with others beside");
    for z in 0..3 {
        files.push((["x", "y", "z"][z], plain(Ct { series: "1.2.4", ..at(z) }, z)));
    }
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in &files {
        std::fs::create_dir_all(folder.path().join("deep/er")).unwrap();
        std::fs::write(folder.path().join(name), bytes).unwrap();
    }
    let two = find(folder.path(), None, Gaps::Refuse).unwrap_err().to_string();
    assert!(two.contains("0 = 1.2.3 \"abdomen\"") && two.contains("1 = 1.2.4"), "{two}");
    assert_eq!(series_of(folder.path()).unwrap().len(), 2);
    for choice in ["0", "1.2.3"] {
        let found = find(folder.path(), Some(choice), Gaps::Refuse).unwrap();
        assert_eq!(found.notes.len(), 2, "{:?}", found.notes);
        assert_is_the_series(&found.read().unwrap(), choice);
    }
}

#[test]
fn archives_and_media_directories() {
    let folder = tempfile::tempdir().unwrap();
    let class = uids::CT_IMAGE_STORAGE;
    let files = single(|z| file(at(z).image(&hu(z)), class, uids::EXPLICIT_VR_LITTLE_ENDIAN));
    let zipped = folder.path().join("scan.zip");
    let mut zip = zip::ZipWriter::new(std::fs::File::create(&zipped).unwrap());
    for (name, bytes) in &files {
        zip.start_file(*name, zip::write::SimpleFileOptions::default()).unwrap();
        zip.write_all(bytes).unwrap();
    }
    zip.finish().unwrap();
    assert_is_the_series(&find(&zipped, None, Gaps::Refuse).unwrap().read().unwrap(), "zip");

    let medium = folder.path().join("medium");
    std::fs::create_dir_all(medium.join("DICOM")).unwrap();
    for (z, name) in ["I0", "I1", "I2", "I3"].into_iter().enumerate() {
        std::fs::write(medium.join("DICOM").join(name), &files[z].1).unwrap();
    }
    let listed = |names: &[&'static str]| {
        let ids: Vec<Vec<&str>> = names.iter().map(|n| vec!["DICOM", *n]).collect();
        let bytes = file(directory(&ids), uids::MEDIA_STORAGE_DIRECTORY_STORAGE, uids::EXPLICIT_VR_LITTLE_ENDIAN);
        std::fs::write(medium.join("DICOMDIR"), bytes).unwrap();
        find(&medium.join("DICOMDIR"), None, Gaps::Refuse)
    };
    assert_is_the_series(&listed(&["I0", "I1", "I2", "I3"]).unwrap().read().unwrap(), "DICOMDIR");
    let absent = listed(&["I0", "I7"]).unwrap_err().to_string();
    assert!(absent.contains("I7") && absent.contains("not there"), "{absent}");
    assert!(listed(&["..", "I0"]).unwrap_err().to_string().contains("expected names"));
}

/// A ball of 100 HU seen by a tilted gantry whose table moves unevenly.
#[test]
fn tilt_and_uneven_steps_are_straightened() {
    let centre = DVec3::new(30.0, 28.0, 40.0);
    let (tilt, size) = (20.0_f64.to_radians(), 64_usize);
    let (row, column) = (DVec3::X, DVec3::new(0.0, tilt.cos(), tilt.sin()));
    let mut z = 10.0;
    let mut files = Vec::new();
    let mut slice = 0;
    let names: Vec<String> = (0..60).map(|i| format!("{i}")).collect();
    while z < 70.0 {
        // The table moves along the patient while the images lean.
        let corner = DVec3::new(0.0, 0.0, z);
        let pixels: Vec<i32> = (0..size * size)
            .map(|i| {
                let p = corner + row * (i % size) as f64 + column * (i / size) as f64;
                if p.distance(centre) < 18.0 { 100 } else { -1000 }
            })
            .collect();
        let ct = Ct {
            instance: slice as u32,
            columns: size as u16,
            rows: size as u16,
            orientation: [row.x, row.y, row.z, column.x, column.y, column.z],
            position: corner.to_array(),
            ..Ct::default()
        };
        files.push((names[slice].as_str(), file(ct.image(&pixels), uids::CT_IMAGE_STORAGE, uids::EXPLICIT_VR_LITTLE_ENDIAN)));
        z += [1.2, 1.5, 1.1][slice % 3];
        slice += 1;
    }
    let volume = read(&files);
    let (mut sum, mut extent, mut count) = (DVec3::ZERO, [(f64::INFINITY, f64::NEG_INFINITY); 3], 0.0);
    for (i, v) in volume.hu.iter().enumerate().filter(|(_, v)| **v > -450.0) {
        let [nx, ny, _] = volume.dims;
        let p = volume.voxel_to_lps.transform_point3(DVec3::new((i % nx) as f64, (i / nx % ny) as f64, (i / (nx * ny)) as f64));
        sum += p;
        count += 1.0;
        for (a, e) in extent.iter_mut().enumerate() {
            *e = (e.0.min(p[a]), e.1.max(p[a]));
        }
        assert!(*v <= 100.0);
    }
    let middle: DVec3 = sum / count;
    assert!(middle.distance(centre) < 0.5, "{middle}");
    for (a, (low, high)) in extent.into_iter().enumerate() {
        assert!((high - low - 36.0).abs() < 2.5, "axis {a}: {low}..{high}");
    }
    let ball = 4.0 / 3.0 * std::f64::consts::PI * 18.0_f64.powi(3);
    let got = count * volume.voxel_to_lps.matrix3.determinant().abs();
    assert!((got / ball - 1.0).abs() < 0.03, "{got} mm3, ball {ball}");
}

/// Landmarks of a real series with 18.5 degrees of tilt and uneven steps.
#[test]
fn a_tilted_scan_keeps_its_distances() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/ct_ge");
    if !folder.is_dir() {
        println!("skipped: there is no {}", folder.display());
        return;
    }
    let series = find(&folder, None, Gaps::Refuse).unwrap();
    assert!(series.notes.iter().any(|n| n.contains("tilt of 18.5")), "{:?}", series.notes);
    assert!(series.notes.iter().any(|n| n.contains("1.08 to 7.00 mm")), "{:?}", series.notes);
    let planes = series.planes().unwrap();
    let volume = series.read().unwrap();
    let axes = volume.voxel_to_lps.matrix3;
    let spacing = DVec3::new(axes.x_axis.length(), axes.y_axis.length(), axes.z_axis.length());
    let [nx, ny] = [series.dims[0], series.dims[1]];
    // The middle of bone in an image, relative to the first image's corner; and on the grid, in the layer at a height.
    let of_pixels = |pixels: &[f32], nx: usize| {
        let (mut sum, mut n) = (DVec3::ZERO, 0.0);
        for (i, _) in pixels.iter().enumerate().filter(|(_, v)| **v > 300.0) {
            sum += DVec3::new((i % nx) as f64, (i / nx) as f64, 0.0) * spacing;
            n += 1.0;
        }
        sum / n
    };
    let origin = {
        // Of the straight grid, seen from the first image's corner: columns and rows were added for the tilt.
        let first = planes[0].at;
        assert_eq!(first, DVec3::ZERO);
        let added = DVec3::new(volume.dims[0] as f64 - nx as f64, volume.dims[1] as f64 - ny as f64, 0.0);
        assert!(added.x <= 1.0 && added.y > 20.0, "{added}: the rows shift, the columns do not");
        let down = planes.iter().map(|p| p.at.y).fold(0.0, f64::min);
        DVec3::new((planes.iter().map(|p| p.at.x).fold(0.0, f64::min) / spacing.x).floor(), (down / spacing.y).floor(), 0.0) * spacing
    };
    let plane = volume.dims[0] * volume.dims[1];
    let (mut compared, mut worst_sheared) = (0, 0.0_f64);
    for p in &planes {
        let layer = p.at.z / spacing.z;
        let truth = of_pixels(&p.pixels, nx) + p.at;
        // Only where a layer of the grid stands at the image's own height.
        if (layer - layer.round()).abs() > 0.1 || !truth.is_finite() || layer.round() as usize >= volume.dims[2] {
            continue;
        }
        let layer = layer.round() as usize;
        let got = of_pixels(&volume.hu[layer * plane..(layer + 1) * plane], volume.dims[0]) + origin;
        let voxel = spacing.length();
        assert!((got.truncate() - truth.truncate()).length() < voxel, "layer {layer}: {got} but {truth}");
        // Without the correction images are stacked as if each stood on the one before, at even steps.
        let sheared = of_pixels(&p.pixels, nx);
        worst_sheared = worst_sheared.max(sheared.distance(DVec3::new(truth.x, truth.y, 0.0)));
        compared += 1;
    }
    assert!(compared >= 3, "{compared} heights compared");
    assert!(worst_sheared > 20.0, "a stack without the correction is off by {worst_sheared} mm");
}
