//! Results as files and pages, and a trainee's progress over a folder of them.

use crate::session::session;
use keyhole_assessment::results::{Progress, ProgressError};
use keyhole_assessment::{Attempt, GoalResult, MetricId, Results, Standard, TaskResult};
use keyhole_whiteboard::Hand;
use std::path::PathBuf;

fn results(day: u64, time_s: f64) -> Results {
    let score = Standard::of("pattern_cut").unwrap().scale(1.0).score(Attempt { time_s, penalty_s: 1.0, complete: true });
    let goal = GoalResult { name: "The disc is <out>".into(), met: true, since_s: Some(time_s) };
    let task = TaskResult { goals: vec![goal], finished_s: Some(time_s), score: Some(score), ..Default::default() };
    Results {
        scene: "Pattern <cut>".into(),
        trainee: "A. Trainee".into(),
        ended_unix_s: 86_400 * day,
        task: Some(task),
        ..session().results
    }
}

#[test]
fn results_are_written_whole_and_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let outcome = session();
    // Half of the points: a number that every reader of JSON reads to the last bit.
    let results = results(20_000, 198.0);
    results.write(folder.path(), outcome.margin.as_ref()).unwrap();
    let mut names: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    assert_eq!(names, ["results.csv", "results.html", "results.json"]);
    let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
    assert_eq!(serde_json::from_str::<Results>(&read("results.json")).unwrap(), results);
    let mut csv = csv::Reader::from_reader(std::io::Cursor::new(read("results.csv")));
    let rows: Vec<(String, String, f64, String)> = csv.deserialize().map(Result::unwrap).collect();
    // The task adds its score and its goal.
    assert_eq!(rows.len(), results.figures.len() + 2);
    assert!(rows.contains(&("goal: The disc is <out>".into(), String::new(), 1.0, "met".into())));
    assert!(rows.contains(&(
        "path_length".into(),
        "right".into(),
        results.value(MetricId::PathLength, Some(Hand::Right)).unwrap(),
        "mm".into()
    )));
    let page = read("results.html");
    // Names are text, never markup; every metric is explained; both drawings are there and the page needs no other file.
    assert!(page.contains("Pattern &lt;cut&gt;") && !page.contains("<cut>"));
    for metric in MetricId::ALL.map(MetricId::metric) {
        assert!(page.contains(metric.name), "{}", metric.name);
    }
    assert_eq!(page.matches("<svg").count(), 2);
    assert!(page.contains("Not yet proficient") && page.contains("2024-10-04"));
}

#[test]
fn progress_is_over_the_sessions_of_a_folder_in_order_of_time() {
    let folder = tempfile::tempdir().unwrap();
    let save = |name: &str, results: &Results| {
        let place = folder.path().join(name);
        std::fs::create_dir(&place).unwrap();
        results.write(&place, None).unwrap();
    };
    for (name, day, time_s) in [("c", 3, 95.0), ("a", 2, 130.0), ("b", 1, 200.0)] {
        save(name, &results(day, time_s));
    }
    std::fs::write(folder.path().join("notes.json"), "{}").unwrap();
    std::fs::write(folder.path().join("newer.json"), results(4, 1.0).json().replace("\"format\": 1", "\"format\": 2")).unwrap();
    let progress = Progress::read(&[folder.path().to_owned()]).unwrap();
    let scores: Vec<f64> = progress.sessions.iter().map(|s| s.task.as_ref().unwrap().score.as_ref().unwrap().score.round()).collect();
    assert_eq!(scores, [49.0, 84.0, 100.0]);
    assert_eq!(progress.refused.len(), 2);
    let page = std::fs::read_to_string(progress.write(folder.path()).unwrap()).unwrap();
    assert!(page.contains("notes.json: no results of a session") && page.contains("format 2"));
    assert!(page.matches("<svg").count() > 10 && page.contains("1 of 1"));
    let mut csv = csv::Reader::from_reader(std::io::Cursor::new(std::fs::read_to_string(folder.path().join("progress.csv")).unwrap()));
    let rows: Vec<[String; 8]> = csv.deserialize().map(Result::unwrap).collect();
    let scored: Vec<&[String; 8]> = rows.iter().filter(|row| row[4] == "score").collect();
    assert_eq!(scored.iter().map(|row| row[0].as_str()).collect::<Vec<_>>(), ["1", "2", "3"]);
    assert_eq!(rows.len(), 3 + progress.sessions.iter().map(|s| s.figures.len()).sum::<usize>());

    let empty = tempfile::tempdir().unwrap();
    let error = Progress::read(&[empty.path().to_owned()]).unwrap_err();
    assert!(matches!(&error, ProgressError::Empty { .. }) && error.to_string().contains("expected the results of sessions"), "{error}");
    assert!(matches!(Progress::read(&[PathBuf::from("/nowhere/at/all")]), Err(ProgressError::Io { .. })));
}
