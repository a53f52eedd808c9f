//! The studies of soft tissue on small bodies: their figures hold together, and bad input leaves nothing behind.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

use keyhole::study::contender::Contender;
use keyhole::study::hardship::Hardship;
use keyhole::study::specimen::Case;
use keyhole::study::stability::{self, step_limits};
use keyhole::study::trade::{self, TradePlan};
use keyhole::study::{stability_page, trade_page};
use std::process::Command;

/// The bar that is pulled: the reference is the closed form, the simulator's default finds it, and springs are another material.
#[test]
fn the_trade_of_one_case() {
    let plan = TradePlan { cases: vec![(Case::Uniaxial, 1)], contenders: Contender::one_of_each(), patience_s: 60.0 };
    let study = trade::conduct(&plan, |_| {}).unwrap();
    let bench = &study.benches[0];
    assert!((bench.reference - bench.truth).abs() < 1e-8 && bench.is_closed);
    assert_eq!(study.runs.len(), plan.contenders.len());
    for run in &study.runs {
        let tolerance = match run.contender.name() {
            "implicit" | "vbd" => 0.005,
            "xpbd" => 0.05,
            _ => 0.6,
        };
        assert!(run.error.abs() < tolerance && run.cost > 0.0, "{run:?}");
    }
    let front = study.front(0);
    assert!(front.windows(2).all(|w| w[0].cost <= w[1].cost && w[0].error.abs() > w[1].error.abs()));
    let folder = tempfile::tempdir().unwrap();
    trade_page::write_all(&study, &[], None, folder.path()).unwrap();
    let table = std::fs::read_to_string(folder.path().join("trade.csv")).unwrap();
    assert_eq!(table.lines().count(), 1 + study.runs.len());
    let page = std::fs::read_to_string(folder.path().join("index.html")).unwrap();
    let shown: Vec<&str> = page.split("img src=\"").skip(1).map(|s| s.split('"').next().unwrap()).collect();
    assert_eq!(shown.len(), 1);
    assert!(std::fs::read_to_string(folder.path().join(shown[0])).unwrap().trim_end().ends_with("</svg>"));
}

/// What must not break a model does not; what breaks the explicit one is said.
#[test]
fn some_hardships() {
    let hardships = [Hardship::Gravity(1.0), Hardship::Plane, Hardship::Young(1e5)];
    let contenders = Contender::one_of_each();
    let study = stability::conduct(&hardships, &contenders[..2], 60.0, |_| {});
    assert_eq!(study.ordeals.len(), hardships.len() * 2);
    for o in &study.ordeals {
        assert!(o.survived, "{}, {}", o.hardship.name(), o.contender.name());
        assert_eq!(o.back_s.is_some(), o.hardship.has_rest_shape(), "{}, {}", o.hardship.name(), o.contender.name());
    }
    let folder = tempfile::tempdir().unwrap();
    stability_page::write_all(&study, folder.path()).unwrap();
    let page = std::fs::read_to_string(folder.path().join("index.html")).unwrap();
    assert!(page.contains("worst.svg") && folder.path().join("worst.svg").exists());
}

/// The simulator's default survives what is worst, and comes back from every start.
#[test]
fn the_default_comes_back_from_everything() {
    let mut hardships =
        vec![Hardship::Young(10.0), Hardship::Young(1e9), Hardship::Poisson(0.4999), Hardship::Tick(0.1), Hardship::MassRatio(1e6)];
    hardships.extend([Hardship::Gravity(1000.0), Hardship::Sliver(0.01), Hardship::Plane, Hardship::Line, Hardship::Point]);
    hardships.extend([Hardship::Scrambled, Hardship::InsideOut, Hardship::Pulled, Hardship::FastTool]);
    for hardship in hardships {
        let o = stability::endure(hardship, &Contender::default_of_the_simulator(), 600.0).unwrap();
        assert!(o.survived && o.finished, "{}: energy {}", hardship.name(), o.energy);
        assert_eq!(o.back_s.is_some(), hardship.has_rest_shape(), "{}: off by {:?}", hardship.name(), o.off);
    }
}

/// The explicit limit is 2 / omega_max: measured within a fifth of it on every mesh, that with slivers as well.
#[test]
fn the_explicit_limit_is_where_it_is_predicted() {
    let limits = step_limits();
    assert_eq!(limits.len(), 6);
    for l in limits {
        assert!((l.measured_s / l.predicted_s - 1.0).abs() < 0.2, "{l:?}");
    }
}

#[test]
fn bad_input_gives_status_2_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    std::fs::create_dir(here.join("films")).unwrap();
    std::fs::write(here.join("films/gravity_a.csv"), "time_s\n0.0\n").unwrap();
    std::fs::create_dir(here.join("full")).unwrap();
    std::fs::write(here.join("full/keep"), "kept").unwrap();
    let cases: [(&[&str], &str); 5] = [
        (&["trade", "-o", "out", "--data", "films"], "gravity_a.csv"),
        (&["trade", "-o", "out", "--data", "nowhere"], "gravity_a.csv"),
        (&["trade", "-o", "full"], "not empty"),
        (&["trade", "-o", "out", "--meshes", "3"], "--meshes"),
        (&["stability", "-o", "out", "--patience", "0"], "above 0"),
    ];
    for (args, expected) in cases {
        let output = Command::new(env!("CARGO_BIN_EXE_keyhole")).current_dir(here).arg("study").args(args).output().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{args:?}: {stderr}");
        assert!(stderr.contains(expected), "{args:?}: {stderr}");
        assert!(!here.join("out").exists());
    }
    assert_eq!(std::fs::read_dir(here).unwrap().count(), 2);
}
