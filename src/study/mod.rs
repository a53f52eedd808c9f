//! The experiments: the paper's evaluation of cutting ("A minimal invasive surgery simulator employing a novel hybrid cutting method"),
//! measured and drawn.
//!
//! [`plan`] says what is cut, [`strokes`] where; [`run`] cuts one combination and takes its figures ([`measure`], [`stable_step`]);
//! [`claims`] and [`thresholds`] compare them with the paper and with each other; [`tables`], [`plots`], [`picture`] and [`page`] are what is left in the folder. Nothing of
//! it knows the engine.
//!
//! [`trade`] says what each soft-tissue model ([`contender`]) costs and how right it is on bodies whose answer is known ([`specimen`], [`film`], [`filmed`], [`refinement`]);
//! [`stability`] what each survives ([`hardship`], [`carving`]).
//!
//! [`scaling`] says what a tick of the whole simulator costs and grows with ([`scaling_case`], [`fit`]), scene by scene and module by module.

pub mod carving;
pub mod claims;
pub mod contender;
pub mod film;
pub mod filmed;
mod filmed_page;
pub mod fit;
mod grid;
pub mod hardship;
mod loglog;
mod markup;
pub mod measure;
pub mod page;
pub mod picture;
pub mod plan;
pub mod plots;
pub mod refinement;
pub mod run;
pub mod scaling;
pub mod scaling_case;
pub mod scaling_page;
mod scatter;
mod solid_picture;
pub mod specimen;
pub mod stability;
pub mod stability_page;
pub mod stable_step;
pub mod strokes;
pub mod svg;
pub mod tables;
pub mod thresholds;
pub mod trade;
pub mod trade_page;
mod verdicts;

use plan::{METHODS, PATTERNS, Plan};
use run::Run;
use std::path::{Path, PathBuf};

/// Part of the stroke at which the pictures are taken.
pub const PICTURED: f64 = 0.6;

/// Why the study's results could not be written.
#[derive(Debug, thiserror::Error)]
pub enum StudyError {
    /// A table.
    #[error("{}: {source}", path.display())]
    Table {
        /// The file.
        path: PathBuf,
        /// What went wrong.
        source: csv::Error,
    },
    /// Another file.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A plot or a picture.
    #[error("{name} cannot be drawn: {reason}")]
    Draw {
        /// The file's name.
        name: String,
        /// What the drawing library says.
        reason: String,
    },
}

/// All cuts of a plan.
#[derive(Clone, Debug)]
pub struct Study {
    /// What was planned.
    pub plan: Plan,
    /// Every method, pattern, snapping and rate.
    pub runs: Vec<Run>,
    /// The sweep of the snapping threshold.
    pub sweep: Vec<Run>,
}

/// Cuts everything, one after another so that the clock measures a cut alone. `done` hears of each.
#[must_use]
pub fn conduct(plan: Plan, mut done: impl FnMut()) -> Study {
    let mut all = |combinations: Vec<plan::Combination>| {
        let each = |c: &plan::Combination| {
            let run = run::run(&plan, c);
            done();
            run
        };
        combinations.iter().map(each).collect::<Vec<Run>>()
    };
    let (runs, sweep) = (all(plan.combinations()), all(plan.sweep_combinations()));
    Study { plan, runs, sweep }
}

impl Study {
    /// The run of a combination.
    #[must_use]
    pub fn find(&self, wanted: &plan::Combination) -> Option<&Run> {
        self.runs.iter().find(|r| r.combination == *wanted)
    }

    /// Writes tables, plots, pictures and the page into a folder.
    ///
    /// # Errors
    /// The first file that cannot be written.
    pub fn write(&self, folder: &Path) -> Result<(), StudyError> {
        let runs: Vec<&Run> = self.runs.iter().collect();
        let sweep: Vec<&Run> = self.sweep.iter().collect();
        tables::figures(&folder.join("figures.csv"), &self.plan, &runs)?;
        tables::summary(&folder.join("summary.csv"), &self.plan, &runs)?;
        tables::summary(&folder.join("snap.csv"), &self.plan, &sweep)?;
        tables::latency(&folder.join("latency.csv"), &self.plan, &runs)?;
        let plots = plots::all(self)?;
        let pictures = self.pictures()?;
        for file in plots.iter().chain(&pictures) {
            write(&folder.join(&file.name), &file.svg)?;
        }
        write(&folder.join("index.html"), &page::page(self, &plots, &pictures))?;
        write(&folder.join("latency.html"), &page::latency(self))
    }

    /// The paper's figure 4 on every mesh: the first stroke, minimal patterns, snapping as it is by default.
    fn pictures(&self) -> Result<Vec<svg::Drawing>, StudyError> {
        let Some(&stroke) = self.plan.strokes.first() else { return Ok(Vec::new()) };
        let Some(&rate) = self.plan.rates.first() else { return Ok(Vec::new()) };
        let mut drawings = Vec::new();
        for (mesh, m) in self.plan.meshes.iter().enumerate() {
            let moments = METHODS.map(|method| {
                let combination = plan::Combination { mesh, stroke, method, pattern: PATTERNS[0], snap: Plan::snaps()[0], rate };
                picture::Moment::of(&self.plan, &combination, PICTURED)
            });
            drawings.push(picture::draw(&format!("fig4_{mesh}.svg"), &m.name, &moments)?);
        }
        Ok(drawings)
    }
}

fn write(path: &Path, text: &str) -> Result<(), StudyError> {
    std::fs::write(path, text).map_err(|source| StudyError::File { path: path.into(), source })
}
