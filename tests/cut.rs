//! `keyhole cut` over a kidney, judged file by file by an oracle that shares no code with the kernel.

mod common;

use common::oracle::{Body, Facts};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

const METHODS: [&str; 3] = ["hybrid", "progressive", "non-progressive"];

/// A mesh and its box, m.
struct Organ {
    path: PathBuf,
    low: [f64; 3],
    high: [f64; 3],
    facts: Facts,
}

impl Organ {
    fn read(path: PathBuf) -> Self {
        let body = Body::try_from(path.as_path()).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let bound = |f: fn(f64, f64) -> f64, start: f64| std::array::from_fn(|k| body.points.iter().map(|p| p[k]).fold(start, f));
        let facts = body.examine().unwrap_or_else(|f| panic!("{}: {f}", path.display()));
        Self { low: bound(f64::min, f64::INFINITY), high: bound(f64::max, f64::NEG_INFINITY), facts, path }
    }

    fn at(&self, part: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|k| self.low[k] + part[k] * (self.high[k] - self.low[k]))
    }

    /// A blade along y that moves along x: from `tip` (part of the height) to above the organ, its z by `wave`, up to `stop` of the way.
    fn stroke(&self, file: &Path, tip: f64, stop: f64, wave: fn(f64) -> f64) {
        let mut text = String::from("t_s,tip_x,tip_y,tip_z,heel_x,heel_y,heel_z,active\n");
        let steps = 60;
        for i in 0..=(f64::from(steps) * stop) as i32 {
            let s = f64::from(i) / f64::from(steps);
            let z = 0.5 + wave(s);
            let ([tx, ty, tz], [hx, hy, hz]) = (self.at([1.2 * s - 0.1, tip, z]), self.at([1.2 * s - 0.08, 1.1, z + 0.02]));
            let _ = writeln!(text, "{},{tx},{ty},{tz},{hx},{hy},{hz},1", f64::from(i) / 60.0);
        }
        std::fs::write(file, text).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
    }
}

/// What one run of the command left.
struct Cut {
    rows: Vec<std::collections::HashMap<String, f64>>,
    facts: Vec<(usize, Facts)>,
    last: Body,
}

fn cut(organ: &Organ, blade: &Path, out: &Path, options: &[&str]) -> Cut {
    let run = Command::new(env!("CARGO_BIN_EXE_keyhole"))
        .args(["cut", &organ.path.to_string_lossy(), "--every", "10", "--blade", &blade.to_string_lossy(), "-o", &out.to_string_lossy()])
        .args(options)
        .output()
        .unwrap_or_else(|e| panic!("keyhole does not start: {e}"));
    assert!(run.status.success(), "{options:?}: {}", String::from_utf8_lossy(&run.stderr));
    let table = std::fs::read_to_string(out.join("steps.csv")).unwrap_or_else(|e| panic!("steps.csv: {e}"));
    let mut lines = table.lines();
    let names: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let number = |v: &str| v.parse::<f64>().unwrap_or_else(|_| panic!("steps.csv: `{v}` is no number"));
    let rows: Vec<_> = lines.map(|l| names.iter().map(|n| (*n).to_owned()).zip(l.split(',').map(number)).collect()).collect();
    let mut facts = Vec::new();
    let mut last = Body::default();
    for i in (0..rows.len()).filter(|i| i % 10 == 0 || i + 1 == rows.len()) {
        let file = out.join(format!("step_{i:05}.vtu"));
        last = Body::try_from(file.as_path()).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
        facts.push((i, last.examine().unwrap_or_else(|f| panic!("{options:?}: {}: {f}", file.display()))));
    }
    Cut { rows, facts, last }
}

/// Sound at every step looked at: conforming and positive (the oracle refuses all else), volume kept, the opened area that of the table, never less.
fn assert_sound(organ: &Organ, cut: &Cut, what: &str) {
    let mut opened = 0.0;
    for (i, facts) in &cut.facts {
        let row = &cut.rows[*i];
        let (volume, was) = (facts.volume, organ.facts.volume);
        assert!((volume - was).abs() <= 1e-9 * was, "{what}, step {i}: volume {volume}, was {was}");
        let area = facts.opened_area * 1e6;
        assert!(
            (area - row["opened_area_mm2"]).abs() <= 1e-6 * area.max(1.0),
            "{what}, step {i}: {area} mm2 open, the table says otherwise"
        );
        assert!(facts.opened_area >= opened * (1.0 - 1e-9), "{what}, step {i}: the cut closed");
        opened = facts.opened_area;
        assert_eq!(facts.fragments.len() as f64, row["fragments"], "{what}, step {i}");
    }
}

/// The tetrahedra by the places of their corners.
fn places(body: &Body) -> Vec<[[u64; 3]; 4]> {
    let mut all: Vec<[[u64; 3]; 4]> = body
        .tets
        .iter()
        .map(|t| {
            let mut p = t.map(|n| body.points[n as usize].map(f64::to_bits));
            p.sort_unstable();
            p
        })
        .collect();
    all.sort_unstable();
    all
}

fn all_methods_and_patterns(organ: &Organ) {
    let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
    let strokes: [(&str, fn(f64) -> f64); 2] = [("straight", |_| 0.0), ("S", |s| 0.12 * (std::f64::consts::TAU * s).sin())];
    for (stroke, wave) in strokes {
        let blade = folder.path().join(format!("{stroke}.csv"));
        organ.stroke(&blade, -0.1, 1.0, wave);
        for pattern in ["minimal", "symmetric"] {
            let mut ends = Vec::new();
            for method in METHODS {
                let what = format!("{stroke} {pattern} {method}");
                let out = folder.path().join(what.replace(' ', "_"));
                let cut = cut(organ, &blade, &out, &["--method", method, "--pattern", pattern, "--snap", "0"]);
                assert_sound(organ, &cut, &what);
                let last = &cut.rows[cut.rows.len() - 1];
                assert_eq!(last["fragments"], 2.0, "{what}");
                if method == "progressive" {
                    // One row of tetrahedra along the blade at most.
                    let row_mm2 = 1e6 * (organ.high[1] - organ.low[1]) * 0.005;
                    for r in &cut.rows {
                        let trail = (r["swept_area_mm2"] - r["opened_area_mm2"]).abs();
                        assert!(trail <= row_mm2, "{what}, step {}: swept and opened area are {trail} mm2 apart", r["step"]);
                    }
                }
                ends.push(places(&cut.last));
            }
            assert!(ends.iter().all(|e| *e == ends[0]), "{stroke} {pattern}: the methods end in different meshes");
        }
        let out = folder.path().join(format!("{stroke}_snapped"));
        let snapped = cut(organ, &blade, &out, &["--snap", "0.2"]);
        assert_sound(organ, &snapped, stroke);
        assert_eq!(snapped.rows[snapped.rows.len() - 1]["fragments"], 2.0, "{stroke} with snapping");
    }
}

#[test]
fn every_method_and_pattern_cuts_the_kidney_in_two() {
    all_methods_and_patterns(&Organ::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/kidney.vtu")));
}

#[test]
fn a_shallow_stroke_and_one_that_stops_halfway_stay_open() {
    let organ = Organ::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/kidney.vtu"));
    let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
    let depth = 1.0 - 0.005 / (organ.high[1] - organ.low[1]);
    for (name, tip, stop) in [("shallow", depth, 1.0), ("halfway", -0.1, 0.5)] {
        let blade = folder.path().join(format!("{name}.csv"));
        organ.stroke(&blade, tip, stop, |_| 0.0);
        for method in METHODS {
            let what = format!("{name} {method}");
            let cut = cut(&organ, &blade, &folder.path().join(what.replace(' ', "_")), &["--method", method]);
            assert_sound(&organ, &cut, &what);
            let last = &cut.rows[cut.rows.len() - 1];
            assert_eq!(last["fragments"], 1.0, "{what}");
            let (swept, opened) = (last["swept_area_mm2"], last["opened_area_mm2"]);
            assert!(swept > 50.0 && (swept - opened).abs() < 0.15 * swept, "{what}: swept {swept} mm2, opened {opened} mm2");
        }
    }
}

#[test]
fn a_real_kidney_too() {
    let labels = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/kits19/case_00064.nii.gz");
    if !labels.exists() {
        println!("{} is not there: no real kidney is cut", labels.display());
        return;
    }
    let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
    let mesh = folder.path().join("k.vtu");
    let made = Command::new(env!("CARGO_BIN_EXE_keyhole"))
        .args([
            "mesh",
            &labels.to_string_lossy(),
            "--label",
            "kidney=1",
            "--label",
            "tumour=2",
            "--edge",
            "6",
            "-o",
            &mesh.to_string_lossy(),
        ])
        .output()
        .unwrap_or_else(|e| panic!("keyhole does not start: {e}"));
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    all_methods_and_patterns(&Organ::read(mesh));
}
