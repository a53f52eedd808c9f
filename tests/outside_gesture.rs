//! The crate of the tutorial: it stands outside the workspace, builds against it as it is, its gesture works in a scene, and the tutorial shows it as it is.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

use std::path::{Path, PathBuf};
use std::process::Command;

const TUTORIAL: &str = "docs/gesture-tutorial.md";
const EXAMPLE: &str = "docs/examples/stay";

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// The files of the example, by their paths in it.
fn files(folder: &Path) -> Vec<(PathBuf, String)> {
    let mut found = Vec::new();
    let mut open = vec![folder.to_owned()];
    while let Some(next) = open.pop() {
        for entry in std::fs::read_dir(&next).unwrap().map(|e| e.unwrap().path()) {
            if entry.is_dir() {
                open.push(entry);
            } else {
                found.push((entry.strip_prefix(folder).unwrap().to_owned(), std::fs::read_to_string(&entry).unwrap()));
            }
        }
    }
    found.sort();
    found
}

#[test]
fn the_crate_of_the_tutorial_builds_outside_and_its_gesture_works() {
    let outside = tempfile::tempdir().unwrap();
    for (path, text) in files(&root().join(EXAMPLE)) {
        let to = outside.path().join(&path);
        std::fs::create_dir_all(to.parent().unwrap()).unwrap();
        // Where the workspace is, is all that differs from what is printed.
        let above = "../../../plugins";
        let there = root().join("plugins").to_str().unwrap().replace('\\', "/");
        std::fs::write(to, if path == Path::new("Cargo.toml") { text.replace(above, &there) } else { text }).unwrap();
    }
    // Nothing but what the workspace has fetched.
    std::fs::copy(root().join("Cargo.lock"), outside.path().join("Cargo.lock")).unwrap();
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).parent().unwrap();
    let cargo = |command: &str| {
        let output = Command::new(env!("CARGO"))
            .args([command, "--offline", "--manifest-path"])
            .arg(outside.path().join("Cargo.toml"))
            .arg("--target-dir")
            .arg(target)
            .current_dir(outside.path())
            .output()
            .unwrap();
        let text = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "cargo {command}:\n{text}");
        text
    };
    cargo("build");
    let text = cargo("test");
    assert!(text.contains("3 passed"), "{text}");
}

/// Each block of the tutorial that names a file is a part of that file, and together they are all of it.
#[test]
fn the_tutorial_shows_the_crate_as_it_is() {
    let tutorial = std::fs::read_to_string(root().join(TUTORIAL)).unwrap();
    let mut shown: Vec<(String, String)> = Vec::new();
    let mut lines = tutorial.lines();
    while let Some(line) = lines.next() {
        let Some((_, name)) = line.strip_prefix("```").and_then(|l| l.split_once(" file=")) else { continue };
        let block: Vec<&str> = lines.by_ref().take_while(|l| *l != "```").collect();
        shown.push((name.to_owned(), block.join("\n")));
    }
    for (path, text) in files(&root().join(EXAMPLE)) {
        let name = path.to_str().unwrap().replace('\\', "/");
        let mut rest = text.as_str();
        for (_, block) in shown.iter().filter(|(n, _)| *n == name) {
            let at = rest.find(block.as_str());
            assert!(at.is_some(), "{TUTORIAL} shows this of {name}, which has no such lines there:\n{block}");
            let (between, after) = rest.split_at(at.unwrap());
            assert!(between.trim().is_empty(), "{TUTORIAL} leaves this of {name} out:\n{between}");
            rest = &after[block.len()..];
        }
        assert!(rest.trim().is_empty(), "{TUTORIAL} leaves this of {name} out:\n{rest}");
    }
    assert!(shown.len() > 4 && shown.iter().all(|(n, _)| root().join(EXAMPLE).join(n).is_file()), "blocks name files that are there");
}
