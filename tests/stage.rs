//! A session around its scene: another scene is begun from the start screen, the scene's file is read again when it has been changed, and results are
//! shown. Without a window: what the HUD and the view would read is looked at instead.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

use bevy::prelude::*;
use keyhole::stage::StagePlugin;
use keyhole::{Settings, Theatre, simulation};
use keyhole_hud::{Guide, Notices, ResultsScreen, StartScreen};
use keyhole_view::{Paint, PictureRequests, SpecimenView};
use keyhole_whiteboard::{Organ, SimulationControl, TickCost};
use std::path::Path;
use std::time::{Duration, SystemTime};

/// A session of the first of two scenes in a folder.
fn session(folder: &Path) -> App {
    let flap = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/flap.scene.ron")).unwrap();
    put(&folder.join("a.scene.ron"), &flap, 0);
    put(&folder.join("b.scene.ron"), &flap.replace("\"Flap\"", "\"Other\"").replace("\"flap\"", "\"strip\""), 0);
    let path = folder.join("a.scene.ron");
    let mut app = simulation(Theatre::load(&path).unwrap(), Settings::default());
    app.init_resource::<StartScreen>()
        .init_resource::<Guide>()
        .init_resource::<Notices>()
        .init_resource::<ResultsScreen>()
        .init_resource::<Paint>()
        .init_resource::<SpecimenView>()
        .init_resource::<PictureRequests>();
    // The app without a window is finished already.
    StagePlugin { path, free: true, start: true }.build(&mut app);
    app
}

/// Writes a file as of so many seconds from now: the clock of files may be coarse.
fn put(path: &Path, text: &str, seconds: u64) {
    std::fs::write(path, text).unwrap();
    let file = std::fs::File::options().write(true).open(path).unwrap();
    file.set_modified(SystemTime::now() + Duration::from_secs(seconds)).unwrap();
}

fn organs(app: &mut App) -> Vec<String> {
    let world = app.world_mut();
    world.query::<&Organ>().iter(world).map(|organ| organ.name.clone()).collect()
}

fn seconds(app: &mut App, seconds: u32) {
    (0..60 * seconds + 2).for_each(|_| app.update());
}

#[test]
fn a_session_changes_scenes_and_reads_changed_files() {
    let folder = tempfile::tempdir().unwrap();
    let mut app = session(folder.path());
    app.update();
    let start = app.world().resource::<StartScreen>();
    assert!(start.open && app.world().resource::<SimulationControl>().paused);
    assert_eq!(start.scenes.iter().map(|card| card.name.as_str()).collect::<Vec<_>>(), ["Flap", "Other"]);
    assert_eq!(app.world().resource::<TickCost>().ticks, 0, "nothing moves behind the start screen");
    app.world_mut().resource_mut::<StartScreen>().wanted = Some(1);
    app.update();
    assert_eq!(organs(&mut app), ["strip"]);
    assert!(!app.world().resource::<StartScreen>().open && !app.world().resource::<SimulationControl>().paused);
    let file = folder.path().join("b.scene.ron");
    let text = std::fs::read_to_string(&file).unwrap();
    // A mistake is shown with its line, and the scene goes on.
    put(&file, &text.replacen("organs:", "organ:", 1), 10);
    seconds(&mut app, 1);
    let notices = app.world().resource::<Notices>().0.join("\n");
    assert!(notices.contains("b.scene.ron:") && notices.contains("organ") && notices.ends_with("goes on as it was."), "{notices}");
    let ticks = app.world().resource::<TickCost>().ticks;
    assert!(organs(&mut app) == ["strip"] && ticks > 50, "{ticks} ticks");
    // Corrected, it is begun anew.
    put(&file, &text.replace("\"strip\"", "\"band\""), 20);
    seconds(&mut app, 1);
    assert_eq!(organs(&mut app), ["band"]);
    assert!(app.world().resource::<TickCost>().ticks < ticks, "begun anew");
    // The results stop the simulation, and shut they are forgotten.
    app.world_mut().resource_mut::<ResultsScreen>().wanted = true;
    app.update();
    let sheet = app.world().resource::<ResultsScreen>().sheet.clone().unwrap();
    assert!(sheet.scene == "Other" && sheet.tables.iter().all(|table| !table.rows.is_empty()) && sheet.tables.len() >= 2, "{sheet:?}");
    assert!(app.world().resource::<SimulationControl>().paused);
    app.world_mut().resource_mut::<ResultsScreen>().sheet = None;
    app.update();
    assert_eq!(*app.world().resource::<SpecimenView>(), SpecimenView(None));
}
