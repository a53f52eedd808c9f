//! The command line: one file a subcommand. What a command prints, where it writes and how it fails is said in each.

pub mod cut;
pub mod device;
mod device_monitor;
pub mod failure;
pub mod mesh;
pub mod phantom;
pub mod play;
pub mod progress;
pub mod run;
pub mod scene;
pub mod study;
mod video;

pub use failure::Failure;

use clap::{Parser, Subcommand, ValueEnum};
use keyhole_whiteboard::CutMethod;

/// Keyhole, an open laparoscopic surgery simulator.
#[derive(Debug, Parser)]
#[command(name = "keyhole", version, about, propagate_version = true)]
pub struct Cli {
    /// Without one: the default scene in a window, or without a display its demonstration with a report.
    #[command(subcommand)]
    pub command: Option<Command>,
}

/// What can be asked for.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Play a scene in a window.
    Play(play::PlayArgs),
    /// Perform a scene's demonstration without a window.
    Run(run::RunArgs),
    /// Make tetrahedra from a scan or from labels.
    Mesh(mesh::MeshArgs),
    /// Cut a mesh along a blade's recorded path.
    Cut(cut::CutArgs),
    /// Conduct an experiment and write its tables, plots and page.
    Study(study::StudyArgs),
    /// Make one page of a trainee's results over sessions.
    Progress(progress::ProgressArgs),
    /// Check a scene or start a new one.
    Scene(scene::SceneArgs),
    /// List HID devices, watch one, or write a profile for it.
    Device(device::DeviceArgs),
    /// Write a synthetic abdomen scan with its labels.
    Phantom(phantom::PhantomArgs),
}

/// When a cut becomes effective.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum MethodArg {
    /// The hull at once, the core once the blade has left.
    Hybrid,
    /// Everything at once.
    Progressive,
    /// Everything once the blade has left.
    NonProgressive,
}

impl From<MethodArg> for CutMethod {
    fn from(method: MethodArg) -> Self {
        match method {
            MethodArg::Hybrid => Self::Hybrid,
            MethodArg::Progressive => Self::Progressive,
            MethodArg::NonProgressive => Self::NonProgressive,
        }
    }
}

/// Does what the arguments ask for.
///
/// # Errors
/// The command's failure, with its message and exit status.
pub fn run(cli: Cli) -> Result<(), Failure> {
    log_to_terminal();
    match cli.command {
        None => play::default_scene(),
        Some(Command::Play(args)) => play::run(args),
        Some(Command::Run(args)) => run::run(args),
        Some(Command::Mesh(args)) => mesh::run(args),
        Some(Command::Cut(args)) => cut::run(&args),
        Some(Command::Study(args)) => study::run(&args),
        Some(Command::Progress(args)) => progress::run(&args),
        Some(Command::Scene(args)) => scene::run(&args),
        Some(Command::Device(args)) => device::run(&args),
        Some(Command::Phantom(args)) => phantom::run(args),
    }
}

/// Warnings and errors go to standard error; `RUST_LOG` asks for more.
fn log_to_terminal() {
    use tracing_subscriber::EnvFilter;
    let quiet =
        || EnvFilter::new("warn,wgpu=error,naga=error,winit=error,bevy_winit=error,bevy_render=error,bevy_light=error,bevy_egui=error");
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| quiet());
    // A second command in one process finds the log set up already.
    drop(tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).without_time().try_init());
}
