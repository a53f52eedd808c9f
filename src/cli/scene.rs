//! `keyhole scene`: checks a scene, or writes a starter.

use crate::cli::failure::Failure;
use clap::{Args, Subcommand};
use std::path::PathBuf;

/// Arguments of `keyhole scene`.
#[derive(Args, Debug)]
pub struct SceneArgs {
    #[command(subcommand)]
    command: SceneCommand,
}

#[derive(Subcommand, Debug)]
enum SceneCommand {
    /// Print every problem of a scene as file:line:column: message; status 2 when there is one.
    Check {
        /// The scene, a .scene.ron file.
        file: PathBuf,
    },
    /// Write a commented starter scene that plays. An existing file is never overwritten.
    New {
        /// The scene to write, a .scene.ron file.
        file: PathBuf,
        /// Mesh of the organ in metres; material 1 is the tumour. It is held by its hilum, its largest hollow. Without a mesh an ellipsoid with a
        /// tumour is written beside the scene.
        #[arg(long, value_name = "MESH.vtu")]
        organ: Option<PathBuf>,
    },
}

/// Runs `keyhole scene`.
///
/// # Errors
/// [`Failure::Input`] for a scene with problems, after each was printed to standard output, and for what a starter cannot be made of or
/// written to.
pub fn run(args: &SceneArgs) -> Result<(), Failure> {
    match &args.command {
        SceneCommand::Check { file } => {
            let problems = keyhole_scene::check(file);
            for problem in &problems {
                println!("{problem}");
            }
            match problems.len() {
                0 => {
                    println!("{}: no problems", file.display());
                    Ok(())
                }
                1 => Err(Failure::input(format!("{}: 1 problem: correct the line named above", file.display()))),
                n => Err(Failure::input(format!("{}: {n} problems: correct the lines named above", file.display()))),
            }
        }
        SceneCommand::New { file, organ } => {
            let written = keyhole_scene::starter::new_scene(organ.as_deref(), file).map_err(Failure::input)?;
            for path in written {
                println!("wrote {}", path.display());
            }
            println!("now: keyhole play {}", file.display());
            Ok(())
        }
    }
}
