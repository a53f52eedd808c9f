//! The same demonstration ends in the same bits: twice, and on one thread, two and three.

use std::path::Path;
use std::process::Command;

/// Runs the default scene in a process of its own, where the number of threads can be chosen, and returns what it printed.
fn run(threads: &str, seconds: &str) -> String {
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/kidney_resection.scene.ron");
    let output = Command::new(env!("CARGO_BIN_EXE_keyhole"))
        .args(["run", "--threads", threads, "--seconds", seconds])
        .arg(scene)
        .output()
        .unwrap_or_else(|e| panic!("the program does not start: {e}"));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn digest(page: &str) -> String {
    let line = page.lines().find(|l| l.starts_with("Digest")).unwrap_or_else(|| panic!("no digest in:\n{page}"));
    line.split('`').nth(1).unwrap_or_default().to_owned()
}

#[test]
fn threads_and_repetition_change_no_bit() {
    // Long enough for the blade to be well inside.
    let pages = [run("1", "4"), run("1", "4"), run("2", "4"), run("3", "4")];
    let digests = pages.each_ref().map(|p| digest(p));
    assert_eq!(digests[0].len(), 32, "{}", digests[0]);
    assert!(pages[0].contains(" created") && !pages[0].contains(" 0 created"), "nothing was cut:\n{}", pages[0]);
    for other in &digests[1..] {
        assert_eq!(*other, digests[0]);
    }
    // The digest sees a difference of one tick.
    assert_ne!(digest(&run("2", "3.98")), digests[0]);
}
