//! `keyhole study`: an experiment with its tables, its plots and one page that says what came of it.

use crate::cli::Failure;
use crate::report::folder::Folder;
use crate::stage::cards;
use crate::study::contender::Contender;
use crate::study::film::FilmError;
use crate::study::hardship::Hardship;
use crate::study::plan::{CELLS_MM, Plan, phantom_kidneys, read_mesh};
use crate::study::scaling::{self, ScalingPlan};
use crate::study::specimen::Case;
use crate::study::strokes::Stroke;
use crate::study::trade::{self, TradePlan};
use crate::study::{Study, StudyError, conduct, stability, stability_page, trade_page};
use crate::study::{filmed, refinement, scaling_case, scaling_page};
use crate::theatre::default_scene;
use indicatif::{ProgressBar, ProgressStyle};
use std::path::{Path, PathBuf};

/// Arguments of `keyhole study`.
#[derive(Debug, clap::Args)]
pub struct StudyArgs {
    /// Which experiment.
    #[command(subcommand)]
    pub experiment: Experiment,
}

/// The experiments.
#[derive(Debug, clap::Subcommand)]
pub enum Experiment {
    /// The paper's evaluation of cutting: methods, patterns, snapping and sampling rates on the phantom's kidney and on meshes that are given.
    Cut(CutStudyArgs),
    /// What each soft-tissue model costs and how right it is: five bodies whose answer is known, and a filmed beam where it is given.
    Trade(TradeStudyArgs),
    /// What each soft-tissue model survives: extreme materials and steps, tangles, violence, a hundred cuts.
    Stability(StabilityStudyArgs),
    /// What a tick costs and how much memory it takes: against the size of the mesh and the number of organs, for every scene, for every module.
    Scaling(ScalingStudyArgs),
}

/// Arguments of `keyhole study scaling`.
#[derive(Debug, clap::Args)]
pub struct ScalingStudyArgs {
    /// Folder for index.html, the tables and the plots; must not be there or be empty.
    #[arg(short, long, value_name = "DIR", required_unless_present = "case")]
    pub output: Option<PathBuf>,
    /// A folder of scenes to measure; without it the one of the default scene.
    #[arg(long, value_name = "DIR")]
    pub scenes: Option<PathBuf>,
    /// Small meshes and few ticks: whether it works, not how fast it is.
    #[arg(long)]
    pub quick: bool,
    /// One case, as the study itself asks for it in a process of its own.
    #[arg(long, hide = true, value_name = "JSON")]
    pub case: Option<String>,
}

/// Arguments of `keyhole study stability`.
#[derive(Debug, clap::Args)]
pub struct StabilityStudyArgs {
    /// Folder for index.html, the tables and the pictures; must not be there or be empty.
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,
    /// Seconds of wall time after which a run is stopped; an hour at rest gets ten times as long, a hundred cuts six times.
    #[arg(long, value_name = "S", default_value_t = 15.0, value_parser = above_zero)]
    pub patience: f64,
}

fn above_zero(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(x) if x > 0.0 && x.is_finite() => Ok(x),
        _ => Err("expected a number above 0".into()),
    }
}

/// Arguments of `keyhole study trade`.
#[derive(Debug, clap::Args)]
pub struct TradeStudyArgs {
    /// Folder for index.html, the table and the plots; must not be there or be empty.
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,
    /// Folder with the films of the silicone beam (gravity_a.csv, load_0.510N_a.csv, ...), to compare with as well.
    #[arg(long, value_name = "DIR")]
    pub data: Option<PathBuf>,
    /// Meshes of each case, the coarsest first: 1 or 2.
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u8).range(1..=2))]
    pub meshes: u8,
}

/// Arguments of `keyhole study cut`.
#[derive(Debug, clap::Args)]
pub struct CutStudyArgs {
    /// Folder for index.html, the tables and the plots; must not be there or be empty.
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,
    /// A VTU file of tetrahedra, metres, to cut beside the phantom's kidney. May be repeated.
    #[arg(long = "mesh", value_name = "FILE")]
    pub meshes: Vec<PathBuf>,
    /// A stroke: straight, s, u-turn, loop, shallow, halfway or cross. May be repeated; straight and s without it.
    #[arg(long = "stroke", value_name = "NAME")]
    pub strokes: Vec<Stroke>,
    /// Moves the strokes a little and starts the power iteration: the same seed gives the same numbers, but for the wall clock's.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
}

/// Conducts the experiment that was asked for.
///
/// # Errors
/// Status 2 for a mesh or a folder that is not as it should be; status 1 when writing fails.
pub fn run(args: &StudyArgs) -> Result<(), Failure> {
    match &args.experiment {
        Experiment::Cut(args) => cut(args),
        Experiment::Trade(args) => trade(args),
        Experiment::Stability(args) => stability(args),
        Experiment::Scaling(args) => scaling(args),
    }
}

/// A folder that appears when all is in it, and a bar that says how far the work is.
struct Experimenter {
    folder: Folder,
    output: PathBuf,
    bar: ProgressBar,
}

impl Experimenter {
    fn begin(output: &Path) -> Result<Self, Failure> {
        let folder = Folder::begin(output).map_err(|e| Failure::input(format!("{}: {e}", output.display())))?;
        Ok(Self { folder, output: output.into(), bar: ProgressBar::new_spinner() })
    }

    fn tell(&self, what: &str) {
        self.bar.set_message(what.to_owned());
        self.bar.tick();
    }

    /// Lets `write` fill the folder, gives it its name, and says in a line what was done and where the page is.
    fn finish(self, done: &str, write: impl FnOnce(&Path) -> Result<(), StudyError>) -> Result<(), Failure> {
        write(self.folder.path()).map_err(Failure::job)?;
        self.bar.finish_and_clear();
        let out = self.folder.finish().map_err(|e| Failure::job(format!("{}: {e}", self.output.display())))?;
        println!("{done}");
        println!("{}", out.join("index.html").display());
        Ok(())
    }
}

fn trade(args: &TradeStudyArgs) -> Result<(), Failure> {
    let experimenter = Experimenter::begin(&args.output)?;
    let filmed = match &args.data {
        Some(data) => Some(filmed::conduct(data, |what| experimenter.tell(what)).map_err(|e| match e {
            FilmError::File { .. } => Failure::input(e),
            FilmError::Reference(_) => Failure::job(e),
        })?),
        None => None,
    };
    let plan = TradePlan { cases: Case::ALL.into_iter().map(|c| (c, usize::from(args.meshes))).collect(), ..TradePlan::default() };
    let study = trade::conduct(&plan, |what| experimenter.tell(what)).map_err(Failure::job)?;
    let refined = refinement::conduct(|what| experimenter.tell(what)).map_err(Failure::job)?;
    let done = format!("{} runs on {} meshes", study.runs.len(), study.benches.len());
    experimenter.finish(&done, |folder| trade_page::write_all(&study, &refined, filmed.as_ref(), folder))
}

fn stability(args: &StabilityStudyArgs) -> Result<(), Failure> {
    let experimenter = Experimenter::begin(&args.output)?;
    let study = stability::conduct(&Hardship::all(), &Contender::one_of_each(), args.patience, |what| experimenter.tell(what));
    let done = format!("{} of {} survived", study.ordeals.iter().filter(|o| o.survived).count(), study.ordeals.len());
    experimenter.finish(&done, |folder| stability_page::write_all(&study, folder))
}

fn scaling(args: &ScalingStudyArgs) -> Result<(), Failure> {
    if let Some(case) = &args.case {
        let measured = scaling_case::measure(&serde_json::from_str(case).map_err(Failure::input)?).map_err(Failure::job)?;
        println!("{}", serde_json::to_string(&measured).map_err(Failure::job)?);
        return Ok(());
    }
    let default = default_scene().map_err(Failure::input)?;
    let folder = args.scenes.as_deref().or(default.parent()).unwrap_or(Path::new("."));
    let scenes: Vec<PathBuf> = cards(folder).into_iter().filter(|card| card.problem.is_none()).map(|card| card.path).collect();
    // What is toggled is also measured as it is.
    let toggled = scenes.iter().find(|scene| **scene == default).or(scenes.first()).cloned();
    let toggled =
        toggled.ok_or_else(|| Failure::input(format!("{}: there is no scene (*.scene.ron) that can be read", folder.display())))?;
    let plan = if args.quick { ScalingPlan::quick(scenes, toggled) } else { ScalingPlan::whole(scenes, toggled) };
    let program = std::env::current_exe().map_err(Failure::job)?;
    let experimenter = Experimenter::begin(args.output.as_deref().unwrap_or(Path::new("")))?;
    experimenter.bar.set_length(plan.cases().len() as u64);
    if let Ok(style) = ProgressStyle::with_template("{bar:40} {pos}/{len} {elapsed}: {msg}") {
        experimenter.bar.set_style(style);
    }
    let study = scaling::conduct(&program, &plan, |what| {
        experimenter.tell(what);
        experimenter.bar.inc(1);
    });
    let study = study.map_err(Failure::job)?;
    let done = format!("{} cases", study.runs.len());
    experimenter.finish(&done, |folder| scaling_page::write_all(&study, folder))
}

fn cut(args: &CutStudyArgs) -> Result<(), Failure> {
    let given = args.meshes.iter().map(|path| read_mesh(path)).collect::<Result<Vec<_>, _>>().map_err(Failure::input)?;
    let experimenter = Experimenter::begin(&args.output)?;
    experimenter.tell("meshing the phantom");
    let mut meshes = phantom_kidneys(&CELLS_MM).map_err(Failure::job)?;
    meshes.extend(given);
    let mut strokes = Vec::new();
    for stroke in &args.strokes {
        if !strokes.contains(stroke) {
            strokes.push(*stroke);
        }
    }
    if strokes.is_empty() {
        strokes = vec![Stroke::Straight, Stroke::S];
    }
    let plan = Plan::new(meshes, strokes, args.seed);
    experimenter.bar.set_length((plan.combinations().len() + plan.sweep_combinations().len()) as u64);
    if let Ok(style) = ProgressStyle::with_template("{bar:40} {pos}/{len} cuts {elapsed}, {eta} left") {
        experimenter.bar.set_style(style);
    }
    let study: Study = conduct(plan, || experimenter.bar.inc(1));
    let done = format!("{} cuts of {} meshes", study.runs.len() + study.sweep.len(), study.plan.meshes.len());
    experimenter.finish(&done, |folder| study.write(folder))
}
