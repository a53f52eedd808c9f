//! The study of scaling on small meshes and few ticks: a row for every scene, exponents of what is counted, no row for what is not required.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

use keyhole::Theatre;
use keyhole::modules::Module;
use keyhole::stage::cards;
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::Path;
use std::process::{Command, Output};

fn scaling(args: &[&str], folder: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_keyhole")).current_dir(folder).args(["study", "scaling"]).args(args).output().unwrap()
}

fn rows(file: &Path) -> Vec<Vec<String>> {
    let mut reader = csv::Reader::from_path(file).unwrap();
    reader.records().map(|r| r.unwrap().iter().map(str::to_owned).collect()).collect()
}

#[test]
fn the_study_says_what_a_tick_grows_with_and_what_each_module_costs() {
    let folder = tempfile::tempdir().unwrap();
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    let output = scaling(&["--quick", "-o", "out", "--scenes", scenes.to_str().unwrap()], folder.path());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let out = folder.path().join("out");

    // Every scene has a row, and a row for each module that it requires and for no other.
    let of_cases = rows(&out.join("scaling.csv"));
    let of_modules = rows(&out.join("modules.csv"));
    for card in cards(&scenes) {
        let name = card.path.file_name().unwrap().to_string_lossy().into_owned();
        assert_eq!(of_cases.iter().filter(|row| row[0] == name).count(), 1, "{name}");
        let requirements = Theatre::load(&card.path).unwrap().scene.requirements();
        let wanted: BTreeSet<&str> = Module::ALL.into_iter().filter(|m| m.is_required(requirements)).map(Module::name).collect();
        let found: BTreeSet<&str> = of_modules.iter().filter(|row| row[0] == name).map(|row| row[1].as_str()).collect();
        assert_eq!(found, wanted, "{name}");
    }
    assert!(of_modules.iter().all(|row| row[3].parse::<f64>().unwrap() >= 1.0), "what is required runs in every tick");

    let json: Value = serde_json::from_slice(&std::fs::read(out.join("scaling.json")).unwrap()).unwrap();
    let runs = json["runs"].as_array().unwrap();
    assert_eq!(runs.len(), of_cases.len());
    let number = |v: &Value| v.as_f64().unwrap_or_else(|| panic!("{v} is no number"));
    for run in runs {
        let measured = &run["measured"];
        assert!(number(&measured["ticks"]) >= 1.0 && number(&measured["tick_ms"]["mean"]) > 0.0);
        let modules = measured["modules"].as_array().unwrap();
        assert_eq!(modules.len(), Module::ALL.len());
        for module in modules.iter().filter(|m| m["required"] == false) {
            assert!(["runs", "entities", "bytes"].iter().all(|what| module[*what] == 0), "{}: {module}", run["case"]);
        }
        let Some(organs) = run["case"]["subject"].get("Organs") else { continue };
        let count = number(&organs["count"]);
        let expected = if organs["asleep"] == true { [0.0, count] } else { [count, 0.0] };
        assert_eq!([number(&measured["stepped"]), number(&measured["asleep"])], expected, "{}", run["case"]);
        if organs["asleep"] == true {
            assert_eq!([number(&measured["iterations"]), number(&measured["looked_at"])], [0.0, 0.0], "{}", run["case"]);
        }
    }

    // What is counted grows as it must, on any machine: in proportion to the organs, and nearly so to the tetrahedra.
    let laws = rows(&out.join("exponents.csv"));
    assert!(laws.iter().all(|law| law[2].parse::<f64>().unwrap().is_finite()), "{laws:?}");
    let exponent = |what: &str, against: &str| {
        let law = laws.iter().find(|law| law[0] == what && law[1] == against).unwrap_or_else(|| panic!("no {what} against {against}"));
        law[2].parse::<f64>().unwrap()
    };
    for against in ["organs awake", "organs asleep"] {
        assert!((exponent("memory of the solver / MB", against) - 1.0).abs() < 1e-3, "{laws:?}");
    }
    assert!((exponent("memory of the solver / MB", "tetrahedra") - 1.0).abs() < 0.15, "{laws:?}");
    // Of a block it looks at the surface.
    assert!((exponent("looked at by collision a tick", "tetrahedra") - 2.0 / 3.0).abs() < 0.1, "{laws:?}");

    let page = std::fs::read_to_string(out.join("index.html")).unwrap();
    assert!(page.contains("0 runs of their systems, 0 entities with anything of theirs, 0 bytes on them"));
    let shown: Vec<&str> = page.split("img src=\"").skip(1).map(|s| s.split('"').next().unwrap()).collect();
    assert_eq!(shown.len(), 4);
    for name in shown {
        let svg = std::fs::read_to_string(out.join(name)).unwrap();
        assert!(svg.contains("<polyline") && svg.contains("<circle") && svg.trim_end().ends_with("</svg>"), "{name}");
    }
}

#[test]
fn bad_arguments_give_status_2_and_leave_nothing() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("empty")).unwrap();
    let cases: [(&[&str], &str); 4] = [
        (&[], "--output"),
        (&["--case", "nonsense"], "expected"),
        (&["-o", "out", "--scenes", "empty"], "no scene"),
        (&["-o", "out", "--case", "{}", "--quick", "--speed", "1"], "--speed"),
    ];
    for (args, expected) in cases {
        let output = scaling(args, folder.path());
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(2) && said.contains(expected), "{args:?}: {said}");
        assert!(!folder.path().join("out").exists());
    }
}
