//! Every scene that is delivered performs its demonstration without a fault, and leaves sound meshes.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

mod common;

use common::oracle::Body;
use keyhole::simulation::{Output, Settings, TICKS_PER_SECOND, faults, simulation};
use keyhole::{Theatre, report::Recorder};
use keyhole_assessment::outcome;
use keyhole_whiteboard::{Organ, TissueMesh, TissueState};
use std::path::{Path, PathBuf};

fn scenes() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    files.retain(|f| f.to_string_lossy().ends_with(".scene.ron"));
    files.sort();
    files
}

/// The rest shape as plain arrays.
fn body(mesh: &TissueMesh) -> Body {
    let mut body = Body::default();
    let mut index = vec![u32::MAX; mesh.0.node_slots()];
    for node in mesh.0.nodes() {
        index[node.index()] = body.points.len() as u32;
        body.points.push(mesh.0.rest(node).to_array());
    }
    body.tets = mesh.0.iter().map(|(_, c)| c.map(|n| index[n.index()])).collect();
    body
}

#[test]
fn every_scene_performs_its_demonstration() {
    let scenes = scenes();
    assert!(!scenes.is_empty());
    for file in scenes {
        let theatre = Theatre::load(&file).unwrap_or_else(|e| panic!("{e}"));
        let Some(seconds) = theatre.demonstration_s() else { continue };
        let mut app = simulation(theatre, Settings { output: Output::None, demonstration: true, ..Settings::default() });
        let mut recorder = Recorder::new(app.world_mut());
        for _ in 0..(seconds * TICKS_PER_SECOND).ceil() as u64 {
            app.update();
            recorder.record(app.world_mut());
        }
        let summary = recorder.summary(app.world_mut());
        assert_eq!(faults(), 0, "{}", file.display());
        assert!(summary.quarantined.is_empty(), "{}: {:?}", file.display(), summary.quarantined);
        assert_eq!(summary.ticks, (seconds * TICKS_PER_SECOND).ceil() as u64);
        assert!(summary.momentum.largest_error < 1e-4, "{}: {:?}", file.display(), summary.momentum);

        let world = app.world_mut();
        let mut organs = world.query::<(&Organ, &TissueMesh, &TissueState)>();
        for (organ, mesh, state) in organs.iter(world) {
            let finite = mesh.0.nodes().all(|n| state.position(n).is_finite() && state.velocities[n.index()].is_finite());
            assert!(finite, "{}: {} is not finite", file.display(), organ.name);
            let facts = body(mesh).examine().unwrap_or_else(|faults| panic!("{}: {}:\n{faults}", file.display(), organ.name));
            println!("{}: {}: {facts}", file.display(), organ.name);
        }
        for fragment in &summary.fragments {
            // Semi-implicit steps of h fall g t h / 2 further than the parabola.
            if let Some(off) = fragment.off_free_fall_m {
                assert!(off <= 0.02 * fragment.fallen_m + 1e-4, "{}: {fragment:?}", file.display());
            }
        }
        // Whoever does what the demonstration shows has done the task.
        let task = outcome(app.world_mut()).and_then(|o| o.results.task).unwrap_or_else(|| panic!("{}: there is no task", file.display()));
        println!("{}: {}", file.display(), task.sentence());
        assert!(task.finished_s.is_some(), "{}: {task:?}", file.display());
        let score = task.score.unwrap_or_else(|| panic!("{}: there is no score", file.display()));
        assert!(score.score > 30.0 && score.score <= 100.0, "{}: {score:?}", file.display());
        println!("{}: {} pieces, digest {}", file.display(), summary.cut.fragments, summary.digest);
    }
}
