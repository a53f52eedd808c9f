//! What a tick costs while the demonstration of the default scene runs, stage by stage, with the size of the mesh and how right the
//! answer is beside it. `cargo bench --bench demonstration [-- SCENE]`.

use keyhole::Theatre;
use keyhole::perform::{Performance, perform};
use keyhole::theatre::default_scene;
use std::process::ExitCode;

fn main() -> ExitCode {
    // Cargo passes `--bench`; what is left is a scene.
    let named = std::env::args().skip(1).find(|a| !a.starts_with("--")).map(Into::into);
    let result = named.map_or_else(default_scene, Ok).and_then(|path| Theatre::load(&path)).map_err(|e| e.to_string());
    match result.and_then(|theatre| perform(theatre, &Performance::default(), |_, _| {}).map_err(|e| e.to_string())) {
        Ok(outcome) => {
            println!("{}", outcome.summary.markdown(&outcome.costs));
            ExitCode::SUCCESS
        }
        Err(why) => {
            eprintln!("{why}");
            ExitCode::FAILURE
        }
    }
}
