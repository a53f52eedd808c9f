//! `keyhole progress`: a trainee's results over sessions as one page.

use crate::cli::failure::Failure;
use clap::Args;
use keyhole_assessment::Progress;
use keyhole_assessment::results::ProgressError;
use std::path::PathBuf;

/// Arguments of `keyhole progress`.
#[derive(Args, Debug)]
pub struct ProgressArgs {
    /// Folders with the results of sessions: reports of `keyhole run`, or what F5 saved; folders of such folders too.
    #[arg(required = true, value_name = "FOLDER")]
    folders: Vec<PathBuf>,
    /// Where progress.html and progress.csv are written; those of an earlier time are replaced.
    #[arg(short, long, value_name = "DIR", default_value = ".")]
    out: PathBuf,
}

/// Runs `keyhole progress`.
///
/// # Errors
/// [`Failure::Input`] for folders that cannot be read or have no results, [`Failure::Job`] when the page cannot be made or written.
pub fn run(args: &ProgressArgs) -> Result<(), Failure> {
    let progress = Progress::read(&args.folders).map_err(Failure::input)?;
    std::fs::create_dir_all(&args.out)
        .map_err(|e| Failure::input(format!("{}: {e}: name a folder that can be made", args.out.display())))?;
    let page = progress.write(&args.out).map_err(|error| match error {
        ProgressError::Io { .. } | ProgressError::Empty { .. } => Failure::input(error),
        ProgressError::Plot(_) => Failure::job(error),
    })?;
    for file in &progress.refused {
        eprintln!("keyhole: not read: {file}");
    }
    println!("{} sessions: {}", progress.sessions.len(), page.display());
    Ok(())
}
