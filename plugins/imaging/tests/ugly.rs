//! The ugliest labels that segmentations hold, each by its name: one closed surface, angles inside the proved bound, the mask's volume.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

use keyhole_imaging::stuffing::PROVED_DEGREES;
use keyhole_imaging::{Centring, ComponentChoice, ImagingError, LabelVolume, MeshOptions, MeshReport, pipeline};
use keyhole_tetmesh::DVec3;

/// Labels given by a function of the place of a voxel, mm from the middle of the volume.
fn volume(size: [usize; 3], spacing: DVec3, part: impl Fn(DVec3) -> u8) -> LabelVolume {
    let middle = DVec3::from_array(size.map(|n| (n - 1) as f64)) / 2.0;
    let at = |i: usize| DVec3::new((i % size[0]) as f64, (i / size[0] % size[1]) as f64, (i / (size[0] * size[1])) as f64);
    LabelVolume {
        path: "ugly".into(),
        dims: size,
        parts: (0..size.iter().product()).map(|i| part((at(i) - middle) * spacing)).collect(),
        names: vec!["kidney".into(), "tumour".into()],
        voxel_to_lps: glam::DAffine3::from_scale(spacing),
        notes: Vec::new(),
    }
}

fn ball(p: DVec3, centre: [f64; 3], radius: f64) -> bool {
    p.distance(DVec3::from_array(centre)) < radius
}

fn kidney(p: DVec3) -> bool {
    let bent = DVec3::new(p.x + 0.01 * p.z * p.z, p.y, p.z);
    (bent / DVec3::new(18.0, 15.0, 34.0)).length() < 1.0
}

fn mesh(name: &str, labels: &LabelVolume, component: ComponentChoice, edge_mm: f64) -> Result<MeshReport, ImagingError> {
    let options = MeshOptions { edge_mm, core_doublings: 0, component, centring: Centring::Patient };
    let report = pipeline::mesh(labels.clone(), &options, &mut |_| {})?.1;
    println!(
        "{name}, {edge_mm} mm: {} tets, {:.2} to {:.2} degrees, volume {:+.3} %, {} bodies",
        report.tets, report.min_dihedral_deg, report.max_dihedral_deg, report.volume_error_percent, report.components
    );
    assert!(report.closed_manifold, "{name}, {edge_mm} mm: {report}");
    let within = report.min_dihedral_deg > PROVED_DEGREES[0] - 0.05 && report.max_dihedral_deg < PROVED_DEGREES[1] + 0.05;
    assert!(within, "{name}, {edge_mm} mm: {report}");
    Ok(report)
}

/// One body of the mask's volume: to half a percent, or a percent at a cell of 6 mm.
fn assert_one_body(name: &str, labels: &LabelVolume) {
    for edge_mm in [4.0, 6.0] {
        let report = mesh(name, labels, ComponentChoice::Auto, edge_mm).unwrap();
        let percent = if edge_mm < 6.0 { 0.5 } else { 1.0 };
        assert_eq!(report.components, 1, "{name}");
        assert!(report.volume_error_percent.abs() < percent, "{name}, {edge_mm} mm: {report}");
    }
}

#[test]
fn a_tumour_larger_than_its_kidney() {
    let labels = volume([80, 64, 90], DVec3::ONE, |p| if ball(p, [12.0, 0.0, 8.0], 26.0) { 2 } else { u8::from(kidney(p)) });
    assert_one_body("tumour larger than its kidney", &labels);
    // What is left of the kidney is little more than a rind about it.
    let labels = volume([70; 3], DVec3::ONE, |p| if ball(p, [1.5, 0.0, 0.0], 27.0) { 2 } else { u8::from(p.length() < 31.0) });
    assert_one_body("tumour within a rind", &labels);
}

#[test]
fn twenty_two_islands() {
    // Specks on a spiral around the kidney, one of them a lone voxel.
    let specks: Vec<([f64; 3], f64)> = (0..21)
        .map(|k| {
            let t = f64::from(k) * 0.9;
            ([30.0 * t.cos(), 26.0 * t.sin(), f64::from(k) * 3.4 - 34.0], 0.6 + f64::from(k % 5) * 0.8)
        })
        .collect();
    let labels =
        volume([80, 72, 90], DVec3::ONE, |p| u8::from(kidney(p) || specks.iter().any(|(c, r)| ball(p, c.map(|v| v.round() + 0.5), *r))));
    assert_one_body("islands", &labels);
    let report = mesh("islands", &labels, ComponentChoice::Auto, 4.0).unwrap();
    assert!(report.found.len() >= 20 && report.found.iter().filter(|c| c.chosen).count() == 1, "{report}");
    mesh("all islands", &labels, ComponentChoice::All, 4.0).unwrap();
}

#[test]
fn slices_of_five_millimetres() {
    let labels = volume([96, 80, 18], DVec3::new(0.7, 0.7, 5.0), |p| {
        let cleft = p.y.abs() < 0.8 && p.x < -4.0;
        if ball(p, [14.0, 0.0, 11.0], 9.0) { 2 } else { u8::from(kidney(p) && !cleft) }
    });
    assert_one_body("slices of 5 mm", &labels);
}

#[test]
fn labels_at_the_border() {
    let labels = volume([40, 30, 44], DVec3::ONE, |p| if ball(p, [14.0, 10.0, 16.0], 12.0) { 2 } else { u8::from(kidney(p)) });
    assert_one_body("cut off by the border", &labels);
    let labels = volume([24; 3], DVec3::new(1.0, 1.5, 2.0), |_| 1);
    assert_one_body("all of the volume", &labels);
}

#[test]
fn a_shell_of_one_voxel() {
    // Open at the top: a closed one is filled.
    let labels = volume([64; 3], DVec3::ONE, |p| u8::from((p.length() - 25.0).abs() < 0.75 && p.z < 14.0));
    for edge_mm in [1.0, 1.5, 4.0] {
        match mesh("shell of one voxel", &labels, ComponentChoice::Auto, edge_mm) {
            Ok(report) => assert!(report.components == 1 && report.volume_error_percent.abs() < 1.0, "{report}"),
            // A lattice that cannot resolve it says what to do.
            Err(e) => {
                let message = e.to_string();
                assert!(edge_mm > 1.0 && message.contains("smaller --edge"), "{edge_mm} mm: {message}");
            }
        }
    }
}

#[test]
fn blocks_that_touch_at_edges_and_corners() {
    let odd = |p: DVec3, side: f64| (p / side).floor().element_sum().rem_euclid(2.0) == 1.0;
    let room = |p: DVec3| p.abs().max_element() < 18.0;
    let labels = volume([48; 3], DVec3::ONE, |p| u8::from(room(p) && odd(p, 9.0)));
    for edge_mm in [3.0, 5.0] {
        mesh("checkerboard", &labels, ComponentChoice::All, edge_mm).unwrap();
    }
    // Two materials that meet like that, everywhere.
    let labels = volume([56; 3], DVec3::ONE, |p| if p.length() > 24.0 { 0 } else { 1 + u8::from(odd(p, 6.0)) });
    assert_one_body("checkerboard of two materials", &labels);
    // Single voxels, diagonal to each other.
    let labels = volume([24; 3], DVec3::splat(2.0), |p| u8::from(room(p) && odd(p, 2.0)));
    match mesh("checkerboard of voxels", &labels, ComponentChoice::All, 4.0) {
        Ok(_) | Err(ImagingError::Unresolved { .. } | ImagingError::Edge { .. }) => {}
        Err(other) => panic!("{other}"),
    }
}
