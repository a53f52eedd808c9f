//! From a scan's labels to a scene that plays: the starter of a meshed kidney holds it by its hilum and frees its tumour.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

use keyhole::simulation::{Output, Settings, TICKS_PER_SECOND, faults, simulation};
use keyhole::{Theatre, report::Recorder};
use keyhole_imaging::{Centring, ComponentChoice, LabelChoice, MeshOptions, Selection, input, pipeline};
use keyhole_scene::{check, hilum::hilum, section, starter::new_scene};
use keyhole_tetmesh::{DVec3, TetMesh, vtu};
use keyhole_whiteboard::{Organ, TissueMesh};
use std::path::Path;

/// Performs the demonstration of the scene and checks that no tumour is left in the organ, nothing was frozen and a piece came free.
fn assert_it_plays(scene: &Path) {
    assert_eq!(check(scene), [], "{}", scene.display());
    let theatre = Theatre::load(scene).unwrap();
    let ticks = (theatre.demonstration_s().unwrap() * TICKS_PER_SECOND).ceil() as u64;
    let mut app = simulation(theatre, Settings { output: Output::None, demonstration: true, ..Settings::default() });
    let mut recorder = Recorder::new(app.world_mut());
    for _ in 0..ticks {
        app.update();
        recorder.record(app.world_mut());
    }
    let summary = recorder.summary(app.world_mut());
    assert_eq!(faults(), 0, "{}", scene.display());
    assert!(summary.quarantined.is_empty(), "{}: {:?}", scene.display(), summary.quarantined);
    assert!(summary.cut.fragments >= 1, "{}: nothing came free", scene.display());
    let world = app.world_mut();
    let mut organs = world.query::<(&Organ, &TissueMesh)>();
    let body = organs.iter(world).find(|(o, _)| o.name == "kidney").unwrap().1;
    let left = body.0.iter().filter(|(t, _)| body.0.tet(*t).material == section::TUMOUR).count();
    assert_eq!(left, 0, "{}: tetrahedra of the tumour are left", scene.display());
}

#[test]
fn the_phantoms_kidney_plays() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("kidney.scene.ron");
    new_scene(Some(&Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/kidney.vtu")), &scene).unwrap();
    assert_it_plays(&scene);
}

#[test]
fn kidneys_of_patients_play() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/kits19");
    if !data.is_dir() {
        println!("skipped: there is no {}", data.display());
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    for case in ["case_00000", "case_00003", "case_00064"] {
        let label = |name: &str, value| LabelChoice { name: name.into(), value };
        let selection = Selection::Labels(vec![label("kidney", 1), label("tumour", 2)]);
        let labels = input::read(&data.join(format!("{case}.nii.gz")), &selection).unwrap();
        let kidneys = [0, 1].map(|rank| {
            let component = ComponentChoice::Rank(rank);
            let options = MeshOptions { edge_mm: 7.0, core_doublings: 0, component, centring: Centring::Patient };
            pipeline::mesh(labels.clone(), &options, &mut |_| {}).unwrap().0
        });
        let centre = |mesh: &TetMesh| section::centroid(mesh, |_| true).unwrap();
        let apart: DVec3 = centre(&kidneys[1]) - centre(&kidneys[0]);
        for (mesh, other) in [(&kidneys[0], apart), (&kidneys[1], -apart)] {
            // Hila look at the aorta, which lies between the kidneys and in front of them.
            let found = hilum(mesh, |_| true).unwrap();
            let degrees = found.outward.angle_between(other).to_degrees();
            assert!(degrees < 60.0, "{case}: the hilum looks {degrees} degrees past the other kidney");
        }
        // The first holds the tumour.
        let (mesh, scene) = (folder.path().join(format!("{case}.vtu")), folder.path().join(format!("{case}.scene.ron")));
        vtu::write(&mesh, &kidneys[0], &[]).unwrap();
        new_scene(Some(&mesh), &scene).unwrap();
        assert_it_plays(&scene);
    }
}
