//! The study of cutting on a small kidney: its figures hold together, the same seed gives the same files, bad input leaves nothing behind.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

use keyhole::study::plan::{METHODS, PATTERNS, Plan, StudyMesh, phantom_kidneys};
use keyhole::study::run::{Run, run};
use keyhole::study::strokes::Stroke;
use keyhole::study::{Study, conduct, plan::Combination};
use keyhole_whiteboard::CutMethod;
use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

/// Some hundred tetrahedra.
fn kidney() -> StudyMesh {
    let mesh = phantom_kidneys(&[12.0]).unwrap().remove(0);
    assert!((200..2000).contains(&mesh.mesh.tet_count()), "{}", mesh.name);
    StudyMesh { is_phantom: false, ..mesh }
}

fn study(mesh: &StudyMesh, seed: u64) -> Study {
    let plan = Plan { moments: 10, rates: vec![0.25], sweep: vec![0.0, 0.2], ..Plan::new(vec![mesh.clone()], vec![Stroke::S], seed) };
    let mut cuts = 0;
    let study = conduct(plan, || cuts += 1);
    assert_eq!(cuts, 18 + 2);
    study
}

/// Every file of the study that does not speak of the wall clock.
fn files(study: &Study) -> BTreeMap<String, Vec<u8>> {
    let folder = tempfile::tempdir().unwrap();
    study.write(folder.path()).unwrap();
    let mut files = BTreeMap::new();
    for entry in std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().path()) {
        let name = entry.file_name().unwrap().to_string_lossy().into_owned();
        if !name.starts_with("latency.") {
            files.insert(name, std::fs::read(&entry).unwrap());
        }
    }
    files
}

#[test]
fn the_same_seed_gives_the_same_files_and_another_gives_others() {
    let mesh = kidney();
    let (first, again, other) = (files(&study(&mesh, 1)), files(&study(&mesh, 1)), files(&study(&mesh, 2)));
    for (name, bytes) in &first {
        assert!(again[name] == *bytes, "{name} differs");
    }
    assert_eq!(first.len(), again.len());
    assert!(first["figures.csv"] != other["figures.csv"]);
    let page = String::from_utf8(first["index.html"].clone()).unwrap();
    let shown: Vec<&str> = page.split("img src=\"").skip(1).map(|s| s.split('"').next().unwrap()).collect();
    assert_eq!(shown.len(), first.keys().filter(|n| n.ends_with(".svg")).count());
    for name in shown {
        let svg = std::str::from_utf8(&first[name]).unwrap();
        assert!(svg.contains("<polyline") && svg.trim_end().ends_with("</svg>"), "{name}");
    }
    let table = String::from_utf8(first["figures.csv"].clone()).unwrap();
    let mut lines = table.lines();
    let columns = lines.next().unwrap().split(',').count();
    assert!(lines.all(|l| l.split(',').count() == columns));
    assert!(table.lines().count() > 18 * 10);
}

#[test]
fn figures_agree_with_each_other_and_with_what_the_methods_are() {
    let study = study(&kidney(), 1);
    let find = |method, pattern, snap| -> &Run {
        study.find(&Combination { mesh: 0, stroke: Stroke::S, method, pattern, snap, rate: 0.25 }).unwrap()
    };
    for run in study.runs.iter().chain(&study.sweep) {
        let end = run.end();
        assert_eq!(end.progress, 1.0);
        assert_eq!(end.tets as i64, run.tets_before as i64 + end.operations.created as i64 - end.operations.deleted as i64);
        assert_eq!(end.tets, run.tets_before - run.cut_tets + run.parts);
        assert!((end.opened_mm2 / end.swept_mm2 - 1.0).abs() < 0.02, "{:?}", run.combination);
        assert_eq!(run.fragments, 2, "{:?}", run.combination);
        assert!(end.min_dihedral_deg <= end.p1_dihedral_deg && end.min_edge_ratio <= end.mean_edge_ratio);
        assert!(end.stable_step_us.unwrap() > 0.0 && end.min_altitude_mm.unwrap() > 0.0);
        // A sound wave does not cross the smallest altitude in the step: c2 = (lambda + 2 mu) / rho, and no more than twice that counts.
        let e = keyhole::study::run::elastic();
        let wave = ((e.lambda + 2.0 * e.mu) / e.density).sqrt();
        assert!(end.stable_step_us.unwrap() * 1e-6 < 2.0 * run.mean_edge_mm * 1e-3 / wave);
        assert!(run.figures.windows(2).all(|w| w[0].progress < w[1].progress && w[0].opened_mm2 <= w[1].opened_mm2 * (1.0 + 1e-9)));
    }
    for pattern in PATTERNS {
        let [progressive, waiting, hybrid] = METHODS.map(|m| find(m, pattern, 0.0));
        if pattern.hull == pattern.core {
            assert!([waiting, hybrid].iter().all(|r| r.fingerprint == progressive.fingerprint), "{pattern:?}");
        }
        let deleted = [progressive, hybrid, waiting].map(|r| r.end().operations.deleted);
        assert!(deleted.is_sorted_by(|a, b| a > b), "{deleted:?}");
        let (lags, edge_mm) = ([waiting.max_lag_mm, hybrid.max_lag_mm], hybrid.mean_edge_mm);
        assert!(lags[0] > edge_mm && lags[1] < 0.5 * edge_mm, "{pattern:?}: {lags:?} with edges of {edge_mm} mm");
    }
    let growth = |method, pattern, snap| find(method, pattern, snap).end().growth;
    let on = Plan::snaps()[0];
    assert!(growth(CutMethod::Progressive, PATTERNS[1], 0.0) > growth(CutMethod::Progressive, PATTERNS[0], 0.0));
    assert!(growth(CutMethod::NonProgressive, PATTERNS[0], on) < growth(CutMethod::NonProgressive, PATTERNS[0], 0.0));
}

#[test]
fn every_stroke_does_what_its_name_says() {
    let mesh = kidney();
    let volume = mesh.mesh.total_volume();
    let plan = Plan { moments: 4, ..Plan::new(vec![mesh], vec![Stroke::Straight], 1) };
    for (stroke, pieces) in [
        (Stroke::Straight, 2..=2),
        (Stroke::S, 2..=2),
        (Stroke::UTurn, 2..=3),
        (Stroke::Loop, 2..=3),
        (Stroke::Shallow, 1..=1),
        (Stroke::Halfway, 1..=1),
        (Stroke::Cross, 6..=9),
    ] {
        let combination =
            Combination { mesh: 0, stroke, method: CutMethod::Hybrid, pattern: PATTERNS[0], snap: Plan::snaps()[0], rate: 0.25 };
        let done = run(&plan, &combination);
        let end = done.end();
        assert!(pieces.contains(&done.fragments), "{stroke:?}: {} pieces", done.fragments);
        assert!(end.opened_mm2 > 0.85 * end.swept_mm2 && end.opened_mm2 < 1.1 * end.swept_mm2, "{stroke:?}: {end:?}");
        assert!(end.swept_mm2 * 1e-6 > 0.05 * volume.powf(2.0 / 3.0), "{stroke:?}: {} mm2", end.swept_mm2);
    }
}

/// A blade that moved by a twentieth of an edge a sample dipped into tissue between two points of its line before one of them was inside; what it
/// crossed meanwhile was lost, and a bridge was left: one piece instead of two, and where it went on beyond an earlier cut half of the pieces.
#[test]
fn how_often_the_blade_is_sampled_does_not_decide_what_is_cut() {
    let plan = Plan { moments: 1, ..Plan::new(vec![kidney()], vec![Stroke::Straight], 1) };
    for stroke in [Stroke::Straight, Stroke::Cross] {
        let cut = |rate: f64| {
            let combination = Combination { mesh: 0, stroke, method: CutMethod::Progressive, pattern: PATTERNS[0], snap: 0.0, rate };
            let done = run(&plan, &combination);
            (done.fragments, done.end().opened_mm2)
        };
        let (pieces, opened) = cut(0.25);
        for rate in [0.5, 0.1, 0.05, 0.02] {
            let (other, area) = cut(rate);
            assert!(
                other == pieces && (area / opened - 1.0).abs() < 1e-3,
                "{stroke:?}, {rate}: {other} pieces, {area} mm2, not {pieces}, {opened}"
            );
        }
    }
}

#[test]
fn bad_input_gives_status_2_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    std::fs::write(here.join("bad.vtu"), "<VTKFile>").unwrap();
    std::fs::create_dir(here.join("full")).unwrap();
    std::fs::write(here.join("full/keep"), "kept").unwrap();
    let list = |at: &Path| {
        let mut names: Vec<_> = std::fs::read_dir(at).unwrap().map(|e| e.unwrap().file_name()).collect();
        names.sort();
        names
    };
    let before = list(here);
    let cases: [(&[&str], &[&str]); 6] = [
        (&["-o", "out", "--mesh", "nowhere.vtu"], &["nowhere.vtu"]),
        (&["-o", "out", "--mesh", "bad.vtu"], &["bad.vtu"]),
        (&["-o", "out", "--stroke", "zigzag"], &["zigzag", "u-turn"]),
        (&["-o", "full"], &["full", "not empty"]),
        (&["-o", "out", "--seed", "one"], &["--seed"]),
        (&[], &["--output"]),
    ];
    for (args, expected) in cases {
        let output = Command::new(env!("CARGO_BIN_EXE_keyhole")).current_dir(here).args(["study", "cut"]).args(args).output().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{args:?}: {stderr}");
        assert!(expected.iter().all(|e| stderr.contains(e)), "{args:?}: {stderr}");
        assert_eq!(list(here), before, "{args:?} wrote something");
    }
    assert_eq!(list(&here.join("full")).len(), 1);
}
