//! A trainee's progress: the results of many sessions, in order of time, as curves.

use crate::metrics::MetricId;
use crate::metrics::table::Scope;
use crate::results::document::{date, figure, frame, number};
use crate::results::plots::{PlotError, curve};
use crate::results::record::{FORMAT, Results, hand_name, put};
use crate::score::Standard;
use keyhole_whiteboard::Hand;
use maud::{Markup, html};
use std::path::{Path, PathBuf};

/// The sessions of a folder.
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
    /// There are no results in it.
    #[error("{}: expected the results of sessions, files that end in .json, here or one folder down{}", folder.display(), because(refused))]
    Empty {
        /// The folder.
        folder: PathBuf,
        /// Files that are no results.
        refused: Vec<String>,
    },
    /// A plot.
    #[error(transparent)]
    Plot(#[from] PlotError),
}

fn because(refused: &[String]) -> String {
    if refused.is_empty() { String::new() } else { format!("; {}", refused.join("; ")) }
}

impl Progress {
    /// Reads the results in a folder and in the folders in it: every file that ends in `.json`. Those that are no results are listed, not fatal.
    ///
    /// # Errors
    /// When the folder cannot be read, or has no results.
    pub fn read(folder: &Path) -> Result<Self, ProgressError> {
        let mut files = Vec::new();
        list(folder, 1, &mut files).map_err(|source| ProgressError::Io { path: folder.into(), source })?;
        files.sort();
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
            return Err(ProgressError::Empty { folder: folder.into(), refused: progress.refused });
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

    /// Writes the page as `progress.html` into the folder, under a temporary name first.
    ///
    /// # Errors
    /// When a plot cannot be drawn or the page not be written.
    pub fn write(&self, folder: &Path) -> Result<PathBuf, ProgressError> {
        let path = folder.join("progress.html");
        put(folder, "progress.html", &self.page()?).map_err(|source| ProgressError::Io { path: path.clone(), source })?;
        Ok(path)
    }

    fn scene(&self, scene: &str) -> Result<Markup, PlotError> {
        let sessions: Vec<&Results> = self.sessions.iter().filter(|s| s.scene == scene).collect();
        let mut figures = Vec::new();
        for standard in scored(&sessions) {
            let points: Vec<(f64, f64)> = series(&sessions, |s| s.scores.iter().find(|s| s.task == standard.id).map(|s| s.percent));
            let title = format!("{}: score", standard.name);
            figures.push((curve(&title, "%", &[("score", points)], Some(("proficient", 100.0)))?, title));
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
                figures.push((curve(m.name, m.unit, &lines, None)?, m.name.to_owned()));
            }
        }
        Ok(html! {
            h2 { (scene) }
            table {
                tr { th { "session" } th { "ended" } th { "trainee" } th { "time / s" } }
                @for (i, s) in sessions.iter().enumerate() {
                    tr {
                        td { (i + 1) } td { (date(s.ended_unix_s)) } td.text { (s.trainee) }
                        td { (s.value(MetricId::Time, None).map_or_else(|| "–".to_owned(), number)) }
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

fn scored(sessions: &[&Results]) -> Vec<&'static Standard> {
    crate::score::STANDARDS.iter().filter(|standard| sessions.iter().any(|s| s.scores.iter().any(|s| s.task == standard.id))).collect()
}

fn list(folder: &Path, deeper: u32, files: &mut Vec<PathBuf>) -> std::io::Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() && deeper > 0 {
            list(&path, deeper - 1, files)?;
        } else if path.extension().is_some_and(|e| e == "json") && path.is_file() {
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
