//! A recording made by the program replays to the same bits, whatever else runs; one that is cut off, changed or of another scene says so.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn scene() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/kidney_resection.scene.ron")
}

fn keyhole(scene: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_keyhole")).arg("run").arg(scene).args(arguments).output().unwrap()
}

fn digest(output: &Output) -> String {
    let page = String::from_utf8_lossy(&output.stdout);
    let line = page.lines().find(|l| l.starts_with("Digest")).unwrap_or_else(|| panic!("no digest in:\n{page}"));
    line.split('`').nth(1).unwrap().to_owned()
}

/// The scene with its assets in another place, a little stiffer.
fn changed_scene(folder: &Path) -> PathBuf {
    let repository = Path::new(env!("CARGO_MANIFEST_DIR"));
    for part in ["assets", "scenes"] {
        std::fs::create_dir(folder.join(part)).unwrap();
    }
    for entry in std::fs::read_dir(repository.join("assets")).unwrap().map(Result::unwrap).filter(|e| e.path().is_file()) {
        std::fs::copy(entry.path(), folder.join("assets").join(entry.file_name())).unwrap();
    }
    let text = std::fs::read_to_string(scene()).unwrap();
    let stiffer = text.replace("young_modulus_pa: 14700.0", "young_modulus_pa: 14701.0");
    assert_ne!(text, stiffer);
    let place = folder.join("scenes").join(scene().file_name().unwrap());
    std::fs::write(&place, stiffer).unwrap();
    place
}

#[test]
fn a_recording_made_under_load_replays_to_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.recording");
    let path = file.to_str().unwrap();
    // The load: three at once, on as many threads each as there are cores.
    let recorded = std::thread::scope(|threads| {
        let others = [(); 2].map(|()| threads.spawn(|| keyhole(&scene(), &["--seconds", "3"])));
        let recorded = keyhole(&scene(), &["--seconds", "3", "--record", path]);
        for other in others {
            assert_eq!(digest(&other.join().unwrap()), digest(&recorded));
        }
        recorded
    });
    assert!(recorded.status.success(), "{}", String::from_utf8_lossy(&recorded.stderr));
    let replayed = keyhole(&scene(), &["--replay", path, "--verify", "--threads", "1"]);
    assert!(replayed.status.success(), "{}", String::from_utf8_lossy(&replayed.stderr));
    assert_eq!(digest(&replayed), digest(&recorded));
    assert!(String::from_utf8_lossy(&replayed.stdout).contains("the same bits after each of 180 ticks"));

    // From a time in it, it goes on with the same bits; a time that it does not have is none.
    let later = keyhole(&scene(), &["--replay", path, "--from", "2.5", "--verify"]);
    assert_eq!((later.status.code(), digest(&later)), (Some(0), digest(&recorded)));
    let never = keyhole(&scene(), &["--replay", path, "--from", "3"]);
    assert_eq!(never.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&never.stderr).contains("the recording is 3.00 s long"));

    // A file is never overwritten.
    assert_eq!(keyhole(&scene(), &["--seconds", "1", "--record", path]).status.code(), Some(2));

    // Cut off, it is played up to there.
    let bytes = std::fs::read(&file).unwrap();
    let part = folder.path().join("part.recording");
    std::fs::write(&part, &bytes[..bytes.len() * 3 / 4]).unwrap();
    let output = keyhole(&scene(), &["--replay", part.to_str().unwrap(), "--verify"]);
    assert!(output.status.success());
    assert!(String::from_utf8_lossy(&output.stderr).contains("breaks off at byte"));
    let page = String::from_utf8_lossy(&output.stdout).into_owned();
    let told = page.split("the same bits after each of ").nth(1).and_then(|rest| rest.split(' ').next());
    let ticks: u64 = told.unwrap_or_else(|| panic!("no verdict in:\n{page}")).parse().unwrap();
    assert!((1..180).contains(&ticks), "{ticks}");

    // In a scene that says something else it is refused, and the message says what has changed.
    let output = keyhole(&changed_scene(folder.path()), &["--replay", path]);
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{error}");
    assert!(error.contains("kidney_resection.scene.ron has other contents;"), "{error}");

    // Another version is named.
    let mut newer = bytes;
    newer[13] = b'7';
    std::fs::write(&part, newer).unwrap();
    let output = keyhole(&scene(), &["--replay", part.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("recorded by Keyhole 7.1.0"));
}
