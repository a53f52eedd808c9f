//! The program: parses arguments, calls one function of the command line.

use clap::Parser;
use keyhole::cli::{Cli, run};
use std::process::ExitCode;

fn main() -> ExitCode {
    match run(Cli::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("keyhole: {failure}");
            failure.exit_code()
        }
    }
}
