//! `keyhole study scaling`: what a tick costs and how much memory it takes, against the size of the mesh and the number of organs, for every scene and for every module.
//!
//! Each case ([`Case`]) runs in a process of its own, one after another: the program starts itself with the case in its arguments and reads the figures from
//! its output. So the most memory that a process has had resident is that case's own, and the clock measures one alone.

use crate::modules::Module;
use crate::report::cost::Cost;
use crate::study::fit::PowerLaw;
use crate::study::scaling_case::{Case, Measured, Subject};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Which cases there are.
#[derive(Clone, Debug)]
pub struct ScalingPlan {
    /// Tetrahedra of one block.
    pub sizes: Vec<usize>,
    /// Numbers of organs.
    pub counts: Vec<usize>,
    /// Tetrahedra of each of several organs.
    pub organ_tets: usize,
    /// Scenes that are performed.
    pub scenes: Vec<PathBuf>,
    /// The scene of which one module after another is required although it does not ask for it, or the other way round.
    pub toggled: PathBuf,
    /// Those modules.
    pub modules: Vec<Module>,
    /// Ticks before and while blocks and organs are measured; those that are to sleep get as long as that takes before.
    pub ticks: [u64; 2],
    /// Ticks of a scene; without it its whole demonstration.
    pub scene_ticks: Option<u64>,
    /// Time after which no further tick of a case is measured, s.
    pub patience_s: f64,
    /// How often each case is run: the run with the least mean of ticks counts, for whatever else the machine does makes it only slower.
    pub repeats: u32,
}

/// Ticks before organs without weight are measured: they sleep after half a second.
const ASLEEP_TICKS: u64 = 45;

impl ScalingPlan {
    /// The whole study: some minutes.
    #[must_use]
    pub fn whole(scenes: Vec<PathBuf>, toggled: PathBuf) -> Self {
        Self {
            sizes: vec![1_000, 3_000, 10_000, 30_000, 100_000, 200_000],
            counts: vec![1, 2, 5, 10],
            organ_tets: 5_000,
            scenes,
            toggled,
            modules: MODULES.into(),
            ticks: [30, 90],
            scene_ticks: None,
            patience_s: 60.0,
            repeats: 3,
        }
    }

    /// A look at every kind of case: small meshes, few ticks.
    #[must_use]
    pub fn quick(scenes: Vec<PathBuf>, toggled: PathBuf) -> Self {
        Self {
            sizes: vec![500, 1_000, 2_000, 4_000],
            counts: vec![1, 2, 4],
            organ_tets: 400,
            modules: vec![Module::Collision, Module::Rigid],
            ticks: [5, 10],
            scene_ticks: Some(10),
            patience_s: 20.0,
            repeats: 1,
            ..Self::whole(scenes, toggled)
        }
    }

    /// Every case, in order.
    #[must_use]
    pub fn cases(&self) -> Vec<Case> {
        let [warm_ticks, ticks] = self.ticks;
        let case = |subject, warm_ticks, ticks| Case { subject, toggled: None, warm_ticks, ticks, patience_s: self.patience_s };
        let mut cases = vec![case(Subject::Nothing, warm_ticks, Some(ticks))];
        cases.extend(self.sizes.iter().map(|tets| case(Subject::Block { tets: *tets }, warm_ticks, Some(ticks))));
        for asleep in [false, true] {
            let warm_ticks = if asleep { ASLEEP_TICKS } else { warm_ticks };
            let organs = |count: &usize| Subject::Organs { count: *count, tets: self.organ_tets, asleep };
            cases.extend(self.counts.iter().map(|count| case(organs(count), warm_ticks, Some(ticks))));
        }
        let scene = |path: &PathBuf| case(Subject::Scene { path: path.clone() }, 1, self.scene_ticks);
        cases.extend(self.scenes.iter().map(scene));
        cases.extend(self.modules.iter().map(|module| Case { toggled: Some(*module), ..scene(&self.toggled) }));
        cases
    }
}

/// The modules that can be required each for itself; grasping goes with instruments.
const MODULES: [Module; 8] = [
    Module::Instruments,
    Module::Clipping,
    Module::Suturing,
    Module::Cutting,
    Module::Collision,
    Module::Tissue,
    Module::Rigid,
    Module::Assessment,
];

/// Why there is no result.
#[derive(Debug, thiserror::Error)]
pub enum ScalingError {
    /// The program does not start.
    #[error("{} does not start: {source}", program.display())]
    Start {
        /// The program.
        program: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A case that came to nothing.
    #[error("{what}: {said}")]
    Failed {
        /// The case in words.
        what: String,
        /// What its process wrote to standard error.
        said: String,
    },
    /// A case whose figures cannot be read.
    #[error("{what}: its figures cannot be read: {source}")]
    Figures {
        /// The case in words.
        what: String,
        /// Why.
        source: serde_json::Error,
    },
}

/// One case and what it came to.
#[derive(Clone, Debug, Serialize)]
pub struct Run {
    /// The case.
    pub case: Case,
    /// Its figures.
    pub measured: Measured,
}

/// A figure as a power of the size.
#[derive(Clone, Debug, Serialize)]
pub struct Law {
    /// Of what.
    pub what: String,
    /// Against what: `tetrahedra`, `organs awake` or `organs asleep`.
    pub against: &'static str,
    /// Places and values, in the units of the tables.
    pub points: Vec<(f64, f64)>,
    /// The curve; none where there are too few values above zero.
    pub law: Option<PowerLaw>,
    /// The exponent between the two largest sizes alone, where what does not depend on the size weighs least.
    pub at_the_end: Option<f64>,
}

/// The whole study.
#[derive(Clone, Debug, Serialize)]
pub struct Scaling {
    /// Every case.
    pub runs: Vec<Run>,
}

/// Runs every case in a process of `program`, which is this program. `done` hears of each before it begins.
///
/// # Errors
/// The first case that fails.
pub fn conduct(program: &Path, plan: &ScalingPlan, mut done: impl FnMut(&str)) -> Result<Scaling, ScalingError> {
    let mut runs = Vec::new();
    for case in plan.cases() {
        done(&case.in_words());
        let mut best: Option<Measured> = None;
        for _ in 0..plan.repeats.max(1) {
            let measured = measure_apart(program, &case)?;
            if best.as_ref().is_none_or(|best| measured.tick_ms.mean < best.tick_ms.mean) {
                best = Some(measured);
            }
        }
        runs.extend(best.map(|measured| Run { case, measured }));
    }
    Ok(Scaling { runs })
}

/// Measures a case in a process of its own.
fn measure_apart(program: &Path, case: &Case) -> Result<Measured, ScalingError> {
    let what = case.in_words();
    let figures = |source| ScalingError::Figures { what: what.clone(), source };
    let told = serde_json::to_string(case).map_err(figures)?;
    let output = Command::new(program)
        .args(["study", "scaling", "--case", &told])
        .output()
        .map_err(|source| ScalingError::Start { program: program.into(), source })?;
    if !output.status.success() {
        return Err(ScalingError::Failed { what, said: String::from_utf8_lossy(&output.stderr).trim().to_owned() });
    }
    serde_json::from_slice(&output.stdout).map_err(figures)
}

impl Case {
    /// The case in words.
    #[must_use]
    pub fn in_words(&self) -> String {
        let of = match &self.subject {
            Subject::Nothing => "nothing".to_owned(),
            Subject::Block { tets } => format!("a block of {tets} tetrahedra"),
            Subject::Organs { count, tets, asleep } => {
                format!("{count} organs of {tets} tetrahedra{}", if *asleep { ", asleep" } else { "" })
            }
            Subject::Scene { path } => path.file_name().unwrap_or_default().to_string_lossy().into_owned(),
        };
        match self.toggled {
            Some(module) => format!("{of}, {} toggled", module.name()),
            None => of,
        }
    }
}

impl Measured {
    /// A stage of the tick by its name, ms.
    #[must_use]
    pub fn stage(&self, name: &str) -> Cost {
        self.stage_ms.iter().find(|(stage, _)| stage == name).map(|(_, cost)| *cost).unwrap_or_default()
    }
}

impl Scaling {
    /// The program without a scene.
    #[must_use]
    pub fn nothing(&self) -> Option<&Measured> {
        self.runs.iter().find(|r| r.case.subject == Subject::Nothing).map(|r| &r.measured)
    }

    /// What a case has resident at the most beyond what the program has without a scene, bytes.
    #[must_use]
    pub fn memory(&self, measured: &Measured) -> Option<f64> {
        let nothing = self.nothing()?.peak_bytes?;
        Some(measured.peak_bytes?.saturating_sub(nothing) as f64)
    }

    /// Blocks by their number of tetrahedra.
    pub fn blocks(&self) -> impl Iterator<Item = &Measured> {
        self.runs.iter().filter(|r| matches!(r.case.subject, Subject::Block { .. })).map(|r| &r.measured)
    }

    /// Organs by their number.
    pub fn organs(&self, asleep: bool) -> impl Iterator<Item = &Measured> {
        self.runs.iter().filter(move |r| matches!(r.case.subject, Subject::Organs { asleep: a, .. } if a == asleep)).map(|r| &r.measured)
    }

    /// Scenes as they are.
    pub fn scenes(&self) -> impl Iterator<Item = &Run> {
        self.runs.iter().filter(|r| matches!(r.case.subject, Subject::Scene { .. }) && r.case.toggled.is_none())
    }

    /// One scene with a module required although it does not ask for it, or the other way round; before them the scene as it is.
    pub fn toggled(&self) -> Vec<&Run> {
        let toggled: Vec<&Run> = self.runs.iter().filter(|r| r.case.toggled.is_some()).collect();
        let plain = toggled.first().and_then(|t| self.scenes().find(|s| s.case.subject == t.case.subject));
        plain.into_iter().chain(toggled).collect()
    }

    /// Every curve with its exponent.
    #[must_use]
    pub fn laws(&self) -> Vec<Law> {
        let mut laws = Vec::new();
        let mut law = |what: &str, against, points: Vec<(f64, f64)>| {
            let at_the_end = PowerLaw::through(&points[points.len().saturating_sub(2)..]).map(|law| law.exponent);
            laws.push(Law { what: what.into(), against, law: PowerLaw::through(&points), at_the_end, points });
        };
        let of_blocks = |of: &dyn Fn(&Measured) -> f64| self.blocks().map(|m| (m.tets as f64, of(m))).collect::<Vec<_>>();
        let tets = "tetrahedra";
        law("whole tick / ms", tets, of_blocks(&|m| m.tick_ms.mean));
        law("99th percentile of ticks / ms", tets, of_blocks(&|m| m.tick_ms.p99));
        for stage in STAGES {
            law(&format!("{stage} / ms"), tets, of_blocks(&|m| m.stage(stage).mean));
        }
        law("memory / MB", tets, of_blocks(&|m| self.memory(m).unwrap_or(0.0) / 1e6));
        law("memory of the solver / MB", tets, of_blocks(&|m| m.solver_bytes as f64 / 1e6));
        law("start / s", tets, of_blocks(&|m| m.start_s));
        law("iterations of the solver a tick", tets, of_blocks(&|m| m.iterations));
        law("looked at by collision a tick", tets, of_blocks(&|m| m.looked_at));
        for (asleep, against) in [(false, "organs awake"), (true, "organs asleep")] {
            let of_organs = |of: &dyn Fn(&Measured) -> f64| self.organs(asleep).map(|m| (m.organs as f64, of(m))).collect::<Vec<_>>();
            law("whole tick / ms", against, of_organs(&|m| m.tick_ms.mean));
            law("Tissue / ms", against, of_organs(&|m| m.stage("Tissue").mean));
            law("Collide / ms", against, of_organs(&|m| m.stage("Collide").mean));
            law("memory / MB", against, of_organs(&|m| self.memory(m).unwrap_or(0.0) / 1e6));
            law("memory of the solver / MB", against, of_organs(&|m| m.solver_bytes as f64 / 1e6));
        }
        laws
    }
}

/// Stages whose cost has a curve of its own.
pub const STAGES: [&str; 4] = ["Cut", "Adopt", "Collide", "Tissue"];
