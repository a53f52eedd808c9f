//! A trainee's progress: the results of many sessions, in order of time, as curves.

use crate::metrics::MetricId;
use crate::metrics::table::Scope;
use crate::results::document::{date, figure, frame, number};
use crate::results::plots::{PlotError, curve};
use crate::results::record::{FORMAT, Results, hand_name, put};
use keyhole_whiteboard::Hand;
use maud::{Markup, html};
use std::path::{Path, PathBuf};

/// The sessions of some folders.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Progress {
    /// In order of time.
    pub sessions: Vec<Results>,
    /// Files that are no results, each with why.
    pub refused: Vec<String>,
}

/// Why there is no progress to show.
#[derive(Debug, thiserror::Error)]
pub enum ProgressError {
    /// The folder or the page.
    #[error("{}: {source}", path.display())]
    Io {
        /// What could not be read or written.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// There are no results in them.
    #[error("{}: expected the results of sessions, files that end in .json, here or one folder down{}", shown(folders), because(refused))]
    Empty {
        /// The folders.
        folders: Vec<PathBuf>,
        /// Files that are no results.
        refused: Vec<String>,
    },
    /// A plot.
    #[error(transparent)]
    Plot(#[from] PlotError),
}

fn shown(folders: &[PathBuf]) -> String {
    folders.iter().map(|f| f.display().to_string()).collect::<Vec<_>>().join(", ")
}

fn because(refused: &[String]) -> String {
    if refused.is_empty() { String::new() } else { format!("; {}", refused.join("; ")) }
}

impl Progress {
    /// Reads the results in some folders and in the folders in them: every file that ends in `.json`. Those that are no results are listed, not fatal; so are reports of
    /// other kinds that lie beside results.
    ///
    /// # Errors
    /// When a folder cannot be read, or there are no results in any.
    pub fn read(folders: &[PathBuf]) -> Result<Self, ProgressError> {
        let mut files = Vec::new();
        for folder in folders {
            list(folder, 1, &mut files).map_err(|source| ProgressError::Io { path: folder.clone(), source })?;
        }
        files.sort();
        files.dedup();
        let mut progress = Self::default();
        for file in files {
            match read(&file) {
                Ok(results) => progress.sessions.push(results),
                Err(why) => progress.refused.push(format!("{}: {why}", file.display())),
            }
        }
        // Stable: sessions that ended in the same second stay in order of their names.
        progress.sessions.sort_by_key(|s| s.ended_unix_s);
        if progress.sessions.is_empty() {
            return Err(ProgressError::Empty { folders: folders.to_vec(), refused: progress.refused });
        }
        Ok(progress)
    }

    /// One page with a part for each scene.
    ///
    /// # Errors
    /// When a plot cannot be drawn.
    pub fn page(&self) -> Result<String, PlotError> {
        let mut scenes: Vec<&str> = Vec::new();
        for session in &self.sessions {
            if !scenes.contains(&session.scene.as_str()) {
                scenes.push(&session.scene);
            }
        }
        let parts = scenes.iter().map(|scene| self.scene(scene)).collect::<Result<Vec<_>, _>>()?;
        let body = html! {
            @for part in parts { (part) }
            @for file in &self.refused { p.no { "Not read: " (file) } }
        };
        Ok(frame("Progress", &body))
    }

    /// As CSV: `session,scene,trainee,ended_unix_s,metric,hand,value,unit`, a line a figure; sessions are numbered from 1 within their scene, as on the page. The score of a task
    /// is the metric `score`.
    ///
    /// # Errors
    /// None in practice: it is written to memory.
    pub fn csv(&self) -> Result<String, csv::Error> {
        let mut writer = csv::Writer::from_writer(Vec::new());
        writer.write_record(["session", "scene", "trainee", "ended_unix_s", "metric", "hand", "value", "unit"])?;
        for (at, session) in self.sessions.iter().enumerate() {
            let number = 1 + self.sessions[..at].iter().filter(|s| s.scene == session.scene).count();
            let mut row = |metric: &str, hand: &str, value: f64, unit: &str| {
                let [number, ended, value] = [number.to_string(), session.ended_unix_s.to_string(), value.to_string()];
                writer.write_record([number.as_str(), &session.scene, &session.trainee, &ended, metric, hand, &value, unit])
            };
            if let Some(score) = score(session) {
                row("score", "", score, "of 100")?;
            }
            for m in &session.figures {
                row(&m.metric.id(), hand_name(m.hand), m.value, m.metric.metric().unit)?;
            }
        }
        let bytes = writer.into_inner().map_err(|e| e.into_error())?;
        Ok(String::from_utf8_lossy(&bytes).into_owned())
    }

    /// Writes the page as `progress.html`, and `progress.csv`, into a folder, each under a temporary name first. Gives the page's place.
    ///
    /// # Errors
    /// When a plot cannot be drawn or a file not be written.
    pub fn write(&self, folder: &Path) -> Result<PathBuf, ProgressError> {
        let path = folder.join("progress.html");
        let io = |source| ProgressError::Io { path: folder.into(), source };
        put(folder, "progress.csv", &self.csv().map_err(|e| io(std::io::Error::other(e)))?).map_err(io)?;
        put(folder, "progress.html", &self.page()?).map_err(|source| ProgressError::Io { path: path.clone(), source })?;
        Ok(path)
    }

    fn scene(&self, scene: &str) -> Result<Markup, PlotError> {
        let sessions: Vec<&Results> = self.sessions.iter().filter(|s| s.scene == scene).collect();
        let mut figures = Vec::new();
        let scores = series(&sessions, score);
        if !scores.is_empty() {
            figures.push((curve("Score", "of 100", &[("score", scores)], Some(("proficient", 100.0)))?, "Score".to_owned()));
        }
        for metric in MetricId::ALL {
            let m = metric.metric();
            let hands: &[Option<Hand>] = if m.scope == Scope::Hand { &[Some(Hand::Left), Some(Hand::Right)] } else { &[None] };
            let lines: Vec<(&str, Vec<(f64, f64)>)> = hands
                .iter()
                .map(|hand| (hand_name(*hand), series(&sessions, |s| s.value(metric, *hand))))
                .filter(|l| !l.1.is_empty())
                .collect();
            if !lines.is_empty() {
                let bound = (metric == MetricId::Time).then(|| proficient_s(&sessions)).flatten();
                figures.push((curve(m.name, m.unit, &lines, bound.map(|s| ("proficient", s)))?, m.name.to_owned()));
            }
        }
        Ok(html! {
            h2 { (scene) }
            table {
                tr { th { "session" } th { "ended" } th { "trainee" } th { "time / s" } th { "goals met" } th { "score" } }
                @for (i, s) in sessions.iter().enumerate() {
                    tr {
                        td { (i + 1) } td { (date(s.ended_unix_s)) } td.text { (s.trainee) }
                        td { (s.value(MetricId::Time, None).map_or_else(|| "–".to_owned(), number)) }
                        td { (s.task.as_ref().map_or_else(|| "–".to_owned(), |t| format!("{} of {}", t.met().0, t.met().1))) }
                        td { (score(s).map_or_else(|| "–".to_owned(), number)) }
                    }
                }
            }
            @for (svg, caption) in &figures { (figure(svg, caption)) }
        })
    }
}

/// What of each session, numbered from 1, that has it.
fn series(sessions: &[&Results], of: impl Fn(&Results) -> Option<f64>) -> Vec<(f64, f64)> {
    sessions.iter().enumerate().filter_map(|(i, s)| Some(((i + 1) as f64, of(s)?))).collect()
}

fn score(session: &Results) -> Option<f64> {
    session.task.as_ref()?.score.as_ref().map(|score| score.score)
}

/// The time of one who is proficient, as the last session has it, s.
fn proficient_s(sessions: &[&Results]) -> Option<f64> {
    sessions.iter().rev().find_map(|s| s.task.as_ref()?.score.as_ref().map(|score| score.scale.proficient_s))
}

fn list(folder: &Path, deeper: u32, files: &mut Vec<PathBuf>) -> std::io::Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() && deeper > 0 {
            list(&path, deeper - 1, files)?;
        } else if path.extension().is_some_and(|e| e == "json") && path.file_name().is_none_or(|n| n != "summary.json") && path.is_file() {
            files.push(path);
        }
    }
    Ok(())
}

fn read(file: &Path) -> Result<Results, String> {
    let text = std::fs::read_to_string(file).map_err(|e| e.to_string())?;
    let results: Results = serde_json::from_str(&text).map_err(|e| format!("no results of a session: {e}"))?;
    if results.format != FORMAT {
        return Err(format!("results of format {}, and this program reads format {FORMAT}", results.format));
    }
    Ok(results)
}
