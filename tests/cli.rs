//! The command line as its user meets it: bad input gives one clear message, status 2, and leaves nothing behind.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn scene() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/kidney_resection.scene.ron")
}

/// Runs the program in a folder, without a display and without a graphics adapter.
fn keyhole(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_keyhole"))
        .current_dir(folder)
        .env_remove("DISPLAY")
        // A backend that is not built for this system: no adapter is found.
        .env("WGPU_BACKEND", "metal")
        .args(args)
        .output()
        .unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// The names of everything in a folder.
fn listing(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

#[test]
fn bad_input_gives_one_message_and_status_2_and_writes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    std::fs::write(here.join("broken.scene.ron"), "(version: 1, nmae: \"x\")").unwrap();
    std::fs::write(here.join("bad.vtu"), "<VTKFile>").unwrap();
    std::fs::write(here.join("bad.csv"), "a,b\n1,2\n").unwrap();
    std::fs::create_dir(here.join("full")).unwrap();
    std::fs::write(here.join("full/keep"), "kept").unwrap();
    let before = listing(here);
    let good = scene();
    let good = good.to_str().unwrap();
    let mesh = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/kidney.vtu");
    let mesh = mesh.to_str().unwrap();
    let cases: &[(&[&str], &[&str])] = &[
        (&["run", "nowhere.scene.ron"], &["nowhere.scene.ron", "cannot be read"]),
        (&["run", "broken.scene.ron"], &["broken.scene.ron:1:", "`name`"]),
        (&["play", "broken.scene.ron"], &["broken.scene.ron:1:"]),
        (&["run", good, "--seconds", "-1"], &["--seconds", "above 0"]),
        (&["run", good, "--seconds", "NaN"], &["--seconds", "above 0"]),
        (&["run", good, "--threads", "0"], &["--threads"]),
        (&["run", good, "--method", "quick"], &["--method", "non-progressive"]),
        (&["run", good, "--seconds", "0.1", "--report", "full"], &["full", "not empty"]),
        (&["run", good, "--seconds", "0.1", "--frames", "full"], &["full", "not empty"]),
        (&["run"], &["SCENE"]),
        (&["dance"], &["dance"]),
        (&["scene", "check", "broken.scene.ron"], &["broken.scene.ron"]),
        (&["scene", "check", "nowhere.scene.ron"], &["nowhere.scene.ron"]),
        (&["scene", "new", "broken.scene.ron"], &["broken.scene.ron", "is there already"]),
        (&["scene", "new", "new.scene.ron", "--organ", "bad.vtu"], &["bad.vtu"]),
        (&["mesh", "nowhere.nii.gz", "-o", "out.vtu", "--label", "kidney=1"], &["nowhere.nii.gz"]),
        (&["mesh", "bad.vtu", "-o", "out.vtu", "--label", "kidney=1"], &["bad.vtu"]),
        (&["cut", "bad.vtu", "--blade", "bad.csv", "-o", "steps"], &["bad.vtu"]),
        (&["cut", mesh, "--blade", "bad.csv", "-o", "steps"], &["bad.csv"]),
        (&["cut", mesh, "--blade", "nowhere.csv", "-o", "steps"], &["nowhere.csv"]),
    ];
    for (args, expected) in cases {
        let output = keyhole(here, args);
        let (stdout, stderr) = (text(&output.stdout), text(&output.stderr));
        assert_eq!(output.status.code(), Some(2), "{args:?}:\n{stdout}{stderr}");
        for part in *expected {
            assert!(stderr.contains(part), "{args:?}: `{part}` is not in:\n{stderr}");
        }
        assert!(!stderr.contains("panicked"), "{args:?}: {stderr}");
        assert_eq!(stderr.lines().filter(|l| l.starts_with("keyhole: ") || l.starts_with("error: ")).count(), 1, "{args:?}:\n{stderr}");
        assert_eq!(listing(here), before, "{args:?} wrote something");
    }
    assert_eq!(std::fs::read_to_string(here.join("full/keep")).unwrap(), "kept");
}

#[test]
fn a_run_leaves_a_report_and_never_overwrites_one() {
    let folder = tempfile::tempdir().unwrap();
    let good = scene();
    let args = ["run", good.to_str().unwrap(), "--seconds", "0.2", "--report", "out"];
    let output = keyhole(folder.path(), &args);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert_eq!(listing(folder.path()), ["out"]);
    assert_eq!(listing(&folder.path().join("out")), ["results.csv", "results.html", "results.json", "summary.json", "summary.md"]);
    let json = std::fs::read_to_string(folder.path().join("out/summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(summary["ticks"], 12);
    assert_eq!(summary["cutting"]["method"], "Hybrid");
    assert!(summary["mesh"]["tets_before"].as_u64().unwrap() > 0);
    assert!(summary["pictures"].as_str().unwrap().contains("no graphics adapter"), "{}", summary["pictures"]);
    assert!(summary["stage_cost_ms"]["Tissue"]["p99"].as_f64().unwrap() > 0.0);
    let again = keyhole(folder.path(), &args);
    assert_eq!(again.status.code(), Some(2));
    assert_eq!(std::fs::read_to_string(folder.path().join("out/summary.json")).unwrap(), json);
}

#[test]
fn a_window_without_a_display_says_why() {
    let folder = tempfile::tempdir().unwrap();
    let output = keyhole(folder.path(), &["play", scene().to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stderr).contains("no display"), "{}", text(&output.stderr));
    assert_eq!(text(&output.stderr).lines().count(), 1);
    let output = keyhole(folder.path(), &["run", scene().to_str().unwrap(), "--seconds", "0.1", "--frames", "frames"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stderr).contains("no graphics adapter"), "{}", text(&output.stderr));
    assert!(listing(folder.path()).is_empty());
}

#[test]
fn help_names_every_command() {
    let output = keyhole(Path::new("."), &["--help"]);
    assert!(output.status.success());
    for command in ["play", "run", "mesh", "cut", "study", "scene", "device", "phantom"] {
        assert!(text(&output.stdout).lines().any(|l| l.trim_start().starts_with(command)), "{command}: {}", text(&output.stdout));
    }
    assert!(keyhole(Path::new("."), &["--version"]).status.success());
}
