//! What a session in a window has around its scene: the start screen, the task's clock and errors, the results, and the scene's file that is read again
//! when it has been changed.

use crate::margin::{LEGEND, paint, viewpoint};
use crate::quality::Quality;
use crate::report::folder::{Folder, unused};
use crate::simulation::TICKS_PER_SECOND;
use crate::spawn::{clear, cut_settings, spawn};
use crate::theatre::Theatre;
use bevy::prelude::*;
use keyhole_assessment::metrics::table::Scope;
use keyhole_assessment::recording::PlayerSystems;
use keyhole_assessment::results::number;
use keyhole_assessment::results::plots::margin_colour;
use keyhole_assessment::{Assessment, Measured, MetricId, Outcome, Results, Task, TaskResult, TaskStatus, outcome};
use keyhole_hud::{Guide, Notices, ResultSheet, ResultTable, ResultsScreen, SceneCard, StartScreen};
use keyhole_view::{Paint, PictureOf, PictureRequest, PictureRequests, SpecimenView};
use keyhole_whiteboard::{Hand, SimulationControl, TickCost};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// Between two looks at the scene's file, s.
const LOOK_S: f64 = 1.0;
/// Between two looks at the metrics, s.
const GUIDE_S: f64 = 0.25;
/// Most problems of a scene's file that are shown at once.
const MOST_PROBLEMS: usize = 5;

/// The scene that is played, and where the session is.
#[derive(Resource, Debug)]
pub struct Stage {
    path: PathBuf,
    /// The scene may be changed: nothing is recorded or replayed, which are of one scene.
    free: bool,
    changed: Option<SystemTime>,
    look_due_s: f64,
    guide_due_s: f64,
    outcome: Option<Outcome>,
}

/// Puts the stage around a theatre that has been loaded from `path`.
pub struct StagePlugin {
    /// The scene's file.
    pub path: PathBuf,
    /// Whether the scene may be changed: another one chosen, and its file read again.
    pub free: bool,
    /// Whether the session begins with the start screen.
    pub start: bool,
}

impl Plugin for StagePlugin {
    fn build(&self, app: &mut App) {
        let world = app.world_mut();
        let stage = Stage {
            path: self.path.clone(),
            free: self.free,
            changed: modified(&self.path),
            look_due_s: LOOK_S,
            guide_due_s: 0.0,
            outcome: None,
        };
        world.insert_resource(stage);
        world.init_resource::<Quality>();
        let steps = world.resource::<Theatre>().scene.guidance.clone();
        world.resource_mut::<Guide>().steps = steps;
        let scenes = cards(self.path.parent().unwrap_or(Path::new(".")));
        let chosen = scenes.iter().position(|card| card.path == self.path).unwrap_or(0);
        let mut screen = world.resource_mut::<StartScreen>();
        (screen.scenes, screen.chosen, screen.locked) = (scenes, chosen, !self.free);
        if self.start {
            world.resource_scope(|world, mut start: Mut<StartScreen>| start.show(&mut world.resource_mut::<SimulationControl>()));
        }
        app.add_systems(First, (begin_chosen, read_again, show_results, save_results, update_guide).chain().after(PlayerSystems));
    }
}

fn modified(path: &Path) -> Option<SystemTime> {
    std::fs::metadata(path).and_then(|file| file.modified()).ok()
}

/// The scenes in a folder, by name. A scene's picture is the PNG beside it.
#[must_use]
pub fn cards(folder: &Path) -> Vec<SceneCard> {
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| folder.join(entry.file_name()));
    let mut cards: Vec<SceneCard> = entries
        .filter(|path| path.to_string_lossy().ends_with(".scene.ron"))
        .map(|path| {
            let picture = std::fs::read(path.with_extension("png")).ok();
            match keyhole_scene::load(&path) {
                Ok(scene) => SceneCard { name: scene.name, description: scene.description, picture, path, problem: None },
                Err(error) => {
                    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
                    SceneCard { name, picture, path, problem: Some(error.to_string()), ..default() }
                }
            }
        })
        .collect();
    cards.sort_by(|a, b| a.name.cmp(&b.name).then_with(|| a.path.cmp(&b.path)));
    cards
}

/// Takes the scene that is played off the whiteboard and puts another one there.
fn change(world: &mut World, theatre: Theatre, path: PathBuf) {
    clear(world);
    let mut cut = cut_settings(&theatre);
    let (method, quality) = (world.resource::<StartScreen>().method, world.resource::<StartScreen>().quality);
    cut.method = method.unwrap_or(cut.method);
    world.insert_resource(cut);
    world.insert_resource(Quality::ALL.get(quality).copied().unwrap_or_default());
    spawn(world, &theatre);
    *world.resource_mut::<Guide>() = Guide { steps: theatre.scene.guidance.clone(), ..default() };
    world.insert_resource(theatre);
    forget_results(world);
    let mut stage = world.resource_mut::<Stage>();
    stage.changed = modified(&path);
    stage.path = path;
}

fn forget_results(world: &mut World) {
    world.resource_mut::<Stage>().outcome = None;
    *world.resource_mut::<ResultsScreen>() = ResultsScreen::default();
    world.resource_mut::<Paint>().set_if_neq(Paint::default());
    world.resource_mut::<SpecimenView>().set_if_neq(SpecimenView::default());
}

/// Begins the scene that was chosen on the start screen.
fn begin_chosen(world: &mut World) {
    let Some(wanted) = world.resource_mut::<StartScreen>().wanted.take() else { return };
    let Some(path) = world.resource::<StartScreen>().scenes.get(wanted).map(|card| card.path.clone()) else { return };
    match Theatre::load(&path) {
        Ok(theatre) => {
            change(world, theatre, path);
            world.resource_mut::<StartScreen>().open = false;
            world.resource_mut::<Notices>().0.clear();
            let mut control = world.resource_mut::<SimulationControl>();
            (control.paused, control.demonstration, control.reset) = (false, false, false);
        }
        Err(error) => world.resource_mut::<StartScreen>().scenes[wanted].problem = Some(error.to_string()),
    }
}

/// Once a second: a scene whose file has been changed is begun anew; one that is not as it should be goes on as it was, and what is wrong is shown.
fn read_again(world: &mut World) {
    let now_s = world.resource::<Time<Real>>().elapsed_secs_f64();
    let mut stage = world.resource_mut::<Stage>();
    if !stage.free || now_s < stage.look_due_s {
        return;
    }
    stage.look_due_s = now_s + LOOK_S;
    let path = stage.path.clone();
    let changed = modified(&path);
    // A file that is being written may not be there for a moment.
    if changed.is_none() || changed == stage.changed {
        return;
    }
    stage.changed = changed;
    let name = path.display();
    let problems: Vec<String> = keyhole_scene::check(&path).iter().map(ToString::to_string).collect();
    let told = match problems.is_empty().then(|| Theatre::load(&path)) {
        Some(Ok(theatre)) => {
            change(world, theatre, path.clone());
            vec![format!("{name} has been read again.")]
        }
        Some(Err(error)) => vec![error.to_string(), "The scene goes on as it was.".into()],
        None => {
            let more = problems.len().saturating_sub(MOST_PROBLEMS);
            let rest = (more > 0).then(|| format!("{more} more: `keyhole scene check {name}` lists them."));
            problems.into_iter().take(MOST_PROBLEMS).chain(rest).chain(["The scene goes on as it was.".into()]).collect()
        }
    };
    world.resource_mut::<Notices>().0 = told;
}

/// Shows the results when they are asked for, with what was resected in the colours of its margin; lets go of that when they are shut.
fn show_results(world: &mut World) {
    if !std::mem::take(&mut world.resource_mut::<ResultsScreen>().wanted) {
        if world.resource::<ResultsScreen>().sheet.is_none() && world.resource::<Stage>().outcome.is_some() {
            forget_results(world);
        }
        return;
    }
    let Some(mut found) = outcome(world) else {
        world.resource_mut::<Notices>().0 = vec!["This scene is not assessed: there are no results.".into()];
        return;
    };
    found.results.scene = world.resource::<Theatre>().scene.name.clone();
    found.results.ended_unix_s = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
    world.resource_mut::<SimulationControl>().paused = true;
    let legend = if found.pieces.is_empty() {
        Vec::new()
    } else {
        LEGEND.into_iter().map(|(mm, means)| (margin_colour(mm * 1e-3), means.to_owned())).collect()
    };
    let sheet = ResultSheet { scene: found.results.scene.clone(), tables: tables(&found.results), legend, saved: None };
    let from = viewpoint(world, &found.pieces);
    world.insert_resource(SpecimenView(from));
    world.insert_resource(paint(&found.pieces));
    world.resource_mut::<ResultsScreen>().sheet = Some(sheet);
    world.resource_mut::<Stage>().outcome = Some(found);
}

/// The tables of the results page.
fn tables(results: &Results) -> Vec<ResultTable> {
    let scoped = |scope| MetricId::ALL.into_iter().filter(move |m| m.metric().scope == scope);
    let hands = ["left", "right"];
    let cell = |metric, hand| results.value(metric, Some(hand)).map_or_else(|| "–".to_owned(), number);
    let of_hands = scoped(Scope::Hand)
        .map(|m| (m.metric().name.to_owned(), [Hand::Left, Hand::Right].map(|hand| cell(m, hand)).into(), m.metric().unit.to_owned()));
    let mut tables: Vec<ResultTable> = results.task.as_ref().map(task_table).into_iter().collect();
    tables.push(ResultTable { title: "Hands".into(), heads: hands.map(String::from).into(), rows: of_hands.collect() });
    for (title, scope) in [("Session", Scope::Session), ("Endoscope", Scope::Camera), ("Resection", Scope::Resection)] {
        let rows: Vec<_> = scoped(scope)
            .filter_map(|m| results.value(m, None).map(|v| (m.metric().name.to_owned(), vec![number(v)], m.metric().unit.to_owned())))
            .collect();
        if !rows.is_empty() {
            tables.push(ResultTable { title: title.into(), heads: Vec::new(), rows });
        }
    }
    tables
}

/// The goals of the task, and what it is worth.
fn task_table(task: &TaskResult) -> ResultTable {
    let score = task.score.as_ref().map(|score| ("Score".to_owned(), vec![number(score.score)], "of 100".to_owned()));
    let goals = task.goals.iter().map(|goal| {
        let (met, since) = if goal.met { ("met", goal.since_s.map(|s| format!("at {s:.1} s"))) } else { ("not met", None) };
        (goal.name.clone(), vec![met.to_owned()], since.unwrap_or_default())
    });
    let penalties = task.penalties.iter().filter(|p| p.amount > 0.0).map(|p| {
        let metric = p.error.metric();
        (format!("{}: {} {}", metric.name, number(p.amount), metric.unit), vec![format!("-{}", number(p.seconds))], "s".to_owned())
    });
    ResultTable { title: "Task".into(), heads: Vec::new(), rows: score.into_iter().chain(goals).chain(penalties).collect() }
}

/// Saves the results, with a picture of what was resected, into a folder of their own.
fn save_results(world: &mut World) {
    if !std::mem::take(&mut world.resource_mut::<ResultsScreen>().save) {
        return;
    }
    let from = world.resource::<SpecimenView>().0;
    let Some(found) = &world.resource::<Stage>().outcome else { return };
    let place = unused(Path::new("."));
    let written = Folder::begin(&place).and_then(|folder| {
        found.results.write(folder.path(), found.margin.as_ref())?;
        folder.finish()
    });
    let said = match written {
        Ok(folder) => {
            if let Some(from) = from {
                let request = PictureRequest { path: folder.join("margin.png"), of: PictureOf::Specimen(from) };
                world.resource_mut::<PictureRequests>().0.push(request);
            }
            format!("Saved: {}", folder.join("results.html").display())
        }
        Err(error) => format!("{}: {error}", place.display()),
    };
    if let Some(sheet) = &mut world.resource_mut::<ResultsScreen>().sheet {
        sheet.saved = Some(said);
    }
}

/// The task's clock, and a few times a second which of its steps are done and what has gone wrong so far.
fn update_guide(
    mut stage: ResMut<Stage>,
    mut guide: ResMut<Guide>,
    time: Res<Time<Real>>,
    cost: Res<TickCost>,
    assessment: Res<Assessment>,
    (task, status): (Res<Task>, Res<TaskStatus>),
) {
    guide.time_s = cost.ticks as f64 / TICKS_PER_SECOND;
    if time.elapsed_secs_f64() >= stage.guide_due_s {
        stage.guide_due_s = time.elapsed_secs_f64() + GUIDE_S;
        guide.errors = errors(&assessment.figures());
        let done = (0..guide.steps.len()).map(|step| status.step_done(&task, step)).collect();
        guide.tick_off(done);
        guide.finished_s = status.finished_s;
    }
}

/// What has gone wrong, of what has been measured.
fn errors(figures: &[Measured]) -> Vec<(String, String)> {
    let wrong = [MetricId::Dropped, MetricId::ToolCollisions, MetricId::Overload, MetricId::OutOfView, MetricId::BloodLoss];
    let of = figures.iter().filter(|m| wrong.contains(&m.metric) && m.value > 0.0);
    of.map(|m| {
        let hand = match m.hand {
            Some(Hand::Left) => ", left",
            Some(Hand::Right) => ", right",
            None => "",
        };
        let metric = m.metric.metric();
        (format!("{}{hand}:", metric.name), format!("{} {}", number(m.value), metric.unit))
    })
    .collect()
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;

    /// The scenes of the repository are on the start screen, each with what it is for; one that cannot be read says why.
    #[test]
    fn the_start_screen_has_every_scene() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
        let found = cards(&folder);
        let files = std::fs::read_dir(&folder).unwrap().flatten().filter(|e| e.file_name().to_string_lossy().ends_with(".scene.ron"));
        assert_eq!(found.len(), files.count());
        assert!(found.iter().all(|card| card.problem.is_none() && !card.name.is_empty() && !card.description.is_empty()));
        let broken = tempfile::tempdir().unwrap();
        std::fs::write(broken.path().join("x.scene.ron"), "(version: 1, nam: 3)").unwrap();
        let [card] = &cards(broken.path())[..] else { panic!("one scene") };
        assert!(card.name == "x.scene.ron" && card.problem.as_ref().unwrap().contains("nam"));
    }

    #[test]
    fn only_what_went_wrong_is_an_error() {
        let measured = |metric, hand, value| Measured { metric, hand, value };
        let figures = [
            measured(MetricId::PathLength, Some(Hand::Left), 9.0),
            measured(MetricId::Overload, Some(Hand::Left), 0.0),
            measured(MetricId::OutOfView, Some(Hand::Right), 1.5),
        ];
        let [(what, amount)] = &errors(&figures)[..] else { panic!("one error") };
        assert!(what.ends_with(", right:") && amount.starts_with("1.5 "), "{what} {amount}");
    }
}
