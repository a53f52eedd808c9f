//! How a command fails: the message for standard error, and the exit status.

use std::process::ExitCode;

/// Why a command ended without its result.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// Bad arguments or bad input: status 2.
    #[error("{0}")]
    Input(Box<dyn std::error::Error + Send + Sync>),
    /// The job could not be done although the input is fine: status 1.
    #[error("{0}")]
    Job(Box<dyn std::error::Error + Send + Sync>),
}

impl Failure {
    /// Bad arguments or input. The message names the file and the place, says what was expected and what to do.
    pub fn input(error: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> Self {
        Self::Input(error.into())
    }

    /// A job that failed.
    pub fn job(error: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> Self {
        Self::Job(error.into())
    }

    /// The status for the shell.
    #[must_use]
    pub fn exit_code(&self) -> ExitCode {
        match self {
            Self::Input(_) => ExitCode::from(2),
            Self::Job(_) => ExitCode::from(1),
        }
    }
}
