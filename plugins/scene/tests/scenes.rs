//! Scenes as files: the starter plays, the checker says what users read, the loader survives any text.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

use keyhole_scene::check::check_text;
use keyhole_scene::ellipsoid::ellipsoid;
use keyhole_scene::starter::new_scene;
use keyhole_scene::{Scene, SceneError, SceneHand, check, load, parse};
use proptest::prelude::*;
use std::path::{Path, PathBuf};

fn starter(folder: &Path) -> PathBuf {
    let out = folder.join("first.scene.ron");
    let written = new_scene(None, &out).unwrap();
    assert_eq!(written, [folder.join("first.vtu"), out.clone()]);
    out
}

fn scenes() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes");
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    files.retain(|p| p.extension().is_some_and(|e| e == "ron"));
    files.sort();
    files
}

#[test]
fn every_scene_of_the_project_checks_clean_and_loads() {
    let files = scenes();
    assert!(!files.is_empty());
    for file in files {
        assert_eq!(check(&file), [], "{}", file.display());
        let scene = load(&file).unwrap();
        assert!(scene.demonstration.is_some(), "{}: what would it show?", file.display());
    }
}

#[test]
fn the_starter_checks_clean_and_is_never_written_over_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let out = starter(folder.path());
    assert_eq!(check(&out), []);
    let before = std::fs::read(&out).unwrap();
    assert!(matches!(new_scene(None, &out), Err(SceneError::Exists { .. })));
    assert_eq!(std::fs::read(&out).unwrap(), before);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2, "nothing else is left behind");
}

#[test]
fn the_starter_names_a_given_mesh_relative_to_itself() {
    let folder = tempfile::tempdir().unwrap();
    for sub in ["meshes", "scenes"] {
        std::fs::create_dir(folder.path().join(sub)).unwrap();
    }
    let mesh = folder.path().join("meshes/o.vtu");
    keyhole_tetmesh::vtu::write(&mesh, &ellipsoid(), &[]).unwrap();
    let out = folder.path().join("scenes/o.scene.ron");
    new_scene(Some(&mesh), &out).unwrap();
    assert_eq!(parse(&std::fs::read_to_string(&out).unwrap()).unwrap().organs[0].mesh.as_deref(), Some("../meshes/o.vtu"));
    assert_eq!(check(&out), []);
}

/// The blade at a keyframe of the right hand: heel and tip, by the port alone.
fn blade(scene: &Scene, key: usize) -> [bevy_math::DVec3; 2] {
    let tool = scene.instruments.iter().find(|t| t.hand == SceneHand::Right).unwrap();
    let port = scene.port(&tool.port).unwrap().position.as_dvec3();
    let hands = &scene.demonstration.as_ref().unwrap().hands;
    let keys = &hands.iter().find(|h| h.hand == SceneHand::Right).unwrap().keys;
    let tip = bevy_math::Vec3::from_array(keys[key].tip).as_dvec3();
    [tip - (tip - port).normalize() * f64::from(tool.blade_length().unwrap()), tip]
}

/// What the starter promises, measured on the mesh: the swept sheet goes right through, the tumour is on one side of it with its margin, what
/// is held on the other, and the freed piece lies below.
fn assert_the_sweep_frees_the_tumour(scene: &Scene) {
    let organ = &scene.organs[0];
    let mesh = organ.read_mesh().unwrap();
    let keys = scene.demonstration.as_ref().unwrap().hands.iter().find(|h| h.hand == SceneHand::Right).unwrap().keys.clone();
    let cutting: Vec<usize> = (0..keys.len()).filter(|k| keys[*k].active).collect();
    let (first, last) = (cutting[0], cutting[cutting.len() - 1] + 1);
    let ([heel, tip], [_, end]) = (blade(scene, first), blade(scene, last));
    let normal = (tip - heel).cross(end - heel).normalize();
    let normal = if normal.y < 0.0 { normal } else { -normal };
    let side = |p: bevy_math::DVec3| normal.dot(p - heel);
    for k in first..=last {
        // The text holds a tenth of a millimetre; the sheet is flat to that.
        assert!(blade(scene, k).into_iter().all(|p| side(p).abs() < 3e-4), "the sheet is flat");
    }
    let tumour: Vec<f64> =
        mesh.iter().filter(|(t, _)| mesh.tet(*t).material.0 == 1).flat_map(|(_, c)| c).map(|n| side(mesh.rest(n))).collect();
    assert!(tumour.iter().all(|d| *d > 3e-3), "the tumour lies below the sheet with 3 mm of margin");
    let (held, supported): (Vec<_>, Vec<_>) = organ.attachments(&mesh).0.into_iter().partition(|a| a.until_s.is_infinite());
    let share = held.iter().filter(|a| a.compliance_m_n == 0.0).count() as f64 / mesh.node_count() as f64;
    assert!((0.1..0.3).contains(&share), "{share} of the nodes are held");
    assert!(held.iter().all(|a| side(mesh.rest(a.point[0].0)) < -5e-3), "what is held stays");
    let cut_through = keys[last].time_s;
    assert!(!supported.is_empty() && supported.iter().all(|a| a.until_s > cut_through), "the piece is held until the cut is through");
    assert!(supported.iter().all(|a| side(mesh.rest(a.point[0].0)) > 3e-3), "only the piece is let go");
    // Every point where the sheet's plane meets the organ is swept: between heel and tip, between the first angle and the last.
    let port = scene.port("right").unwrap().position.as_dvec3();
    let plane = keyhole_scene::section::Plane { normal, offset: normal.dot(heel) };
    let radius = (heel.distance(port), tip.distance(port));
    let start = (tip - port).normalize();
    let sweep = (end - port).normalize();
    let whole = start.angle_between(sweep);
    for p in keyhole_scene::section::section(&mesh, &plane) {
        let r = p.distance(port);
        assert!(r > radius.0 + 5e-3 && r < radius.1 - 5e-3, "the blade spans {p}");
        let d = (p - port).normalize();
        assert!(start.angle_between(d) < whole && sweep.angle_between(d) < whole, "the sweep passes {p}");
    }
}

#[test]
fn the_starter_frees_the_tumour_of_the_ellipsoid() {
    let folder = tempfile::tempdir().unwrap();
    assert_the_sweep_frees_the_tumour(&load(&starter(folder.path())).unwrap());
}

#[test]
fn the_starter_holds_a_kidney_by_its_hilum_and_frees_its_tumour() {
    let folder = tempfile::tempdir().unwrap();
    let (mesh, out) = (folder.path().join("k.vtu"), folder.path().join("k.scene.ron"));
    std::fs::copy(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/kidney.vtu"), &mesh).unwrap();
    new_scene(Some(&mesh), &out).unwrap();
    assert_eq!(check(&out), []);
    let scene = load(&out).unwrap();
    assert_the_sweep_frees_the_tumour(&scene);
    // The left kidney of the phantom where the patient has it: X is his left, so the hilum is towards -X.
    let organ = &scene.organs[0];
    let (own, placed) = (keyhole_tetmesh::vtu::read(&mesh).unwrap(), organ.read_mesh().unwrap());
    let held: Vec<f64> =
        organ.attachments(&placed).0.iter().filter(|a| a.compliance_m_n == 0.0).map(|a| own.rest(a.point[0].0).x).collect();
    let middle = keyhole_scene::section::centroid(&own, |_| true).unwrap().x;
    let mean = held.iter().sum::<f64>() / held.len() as f64;
    assert!(mean < middle - 5e-3, "held at {mean}, the middle of the kidney is at {middle}");
}

#[test]
fn every_scene_of_the_project_with_a_tumour_frees_it() {
    let with_tumour = |scene: &Scene| scene.organs.iter().any(|o| o.materials.iter().any(|m| m.name == "tumour"));
    let resections: Vec<Scene> = scenes().iter().map(|file| load(file).unwrap()).filter(with_tumour).collect();
    assert!(!resections.is_empty());
    resections.iter().for_each(assert_the_sweep_frees_the_tumour);
}

fn problems(text: &str) -> String {
    let lines: Vec<String> = check_text(Path::new("theatre.scene.ron"), text).iter().map(ToString::to_string).collect();
    lines.join("\n")
}

#[test]
fn the_checker_reports_every_problem_with_its_place() {
    insta::assert_snapshot!(problems(include_str!("broken.scene.ron")));
}

#[test]
fn the_checker_reports_text_that_is_no_scene() {
    let cases = [
        ("empty", ""),
        ("no organs", "(version: 1, name: \"x\", organs: [])"),
        ("missing field", "(version: 1,\n name: \"x\",\n)"),
        ("wrong version", "(version: 9, name: \"x\", organs: [])"),
        ("wrong kind", "(version: 1, name: \"x\", organs: [], instruments: [(kind: Hok, hand: Left, port: \"a\")])"),
        ("not closed", "(version: 1, name: \"x\""),
        ("text for a number", "(version: \"1\")"),
    ];
    let report: Vec<String> = cases.iter().map(|(what, text)| format!("{what}:\n{}", problems(text))).collect();
    insta::assert_snapshot!(report.join("\n"));
}

#[test]
fn a_file_that_is_not_there_is_a_problem() {
    let missing = check(Path::new("/nowhere/x.scene.ron"));
    assert_eq!(missing.len(), 1);
    assert!(missing[0].to_string().starts_with("/nowhere/x.scene.ron:1:1: cannot be read"), "{}", missing[0]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    /// The broken scene with pieces removed, doubled and overwritten: every answer is a scene or problems with places in the text.
    #[test]
    fn the_loader_survives_any_damage(edits in prop::collection::vec((0usize..4000, 0usize..40, "\\PC{0,6}|[()\\[\\]{},:\"0-9.eE-]{1,4}|NaN|inf|1e999"), 1..5)) {
        let mut text: Vec<char> = include_str!("broken.scene.ron").chars().collect();
        for (at, length, with) in edits {
            let at = at.min(text.len());
            let end = (at + length).min(text.len());
            text.splice(at..end, with.chars());
        }
        let text: String = text.into_iter().collect();
        let lines = text.lines().count() + 1;
        let problems = check_text(Path::new("x.scene.ron"), &text);
        prop_assert!(problems.iter().all(|p| p.line >= 1 && p.line <= lines && p.column >= 1));
        prop_assert!(parse(&text).is_ok() || !problems.is_empty());
    }
}

#[test]
fn the_authors_guide_names_every_field_and_value() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let guide = std::fs::read_to_string(root.join("../../docs/scenes.md")).unwrap();
    // What comes after the types are no fields.
    let fields =
        |file: &str, until: &str| std::fs::read_to_string(root.join("src").join(file)).unwrap().split(until).next().unwrap().to_owned();
    let names = |line: &str| -> Option<String> {
        let field = line.trim().strip_prefix("pub ").and_then(|l| l.split_once(':')).map(|(name, _)| name.to_owned());
        let inside = line.starts_with("        ") && !line.trim().starts_with('/') && line.contains(": ");
        let variant =
            line.strip_prefix("    ").filter(|l| l.starts_with(char::is_uppercase)).map(|l| l.trim_end_matches([',', ' ', '{']).to_owned());
        field.or(variant).or_else(|| inside.then(|| line.trim().split(':').next().unwrap_or_default().to_owned()))
    };
    let format =
        [fields("format.rs", "fn default_gravity"), fields("vessel.rs", "impl Default"), fields("suture.rs", "fn default_needle")].concat();
    // Defaults are values, not names.
    let mut inside_default = false;
    let mut missing = Vec::new();
    for line in format.lines() {
        inside_default = (inside_default || line.starts_with("impl ")) && line != "}";
        let Some(name) = names(line).filter(|_| !inside_default) else { continue };
        // `blade_length_m` is what old scenes say.
        if name.chars().all(|c| c.is_alphanumeric() || c == '_') && !guide.contains(&name) && name != "blade_length_m" {
            missing.push(name);
        }
    }
    assert!(missing.is_empty(), "docs/scenes.md does not name {missing:?}");
}
