//! `keyhole phantom`: the synthetic abdomen as a CT series with its segmentation.

use crate::cli::Failure;
use crate::report::folder::Folder;
use indicatif::{ProgressBar, ProgressStyle};
use keyhole_imaging::dicom_write::{self, SEGMENTATION_FILE};
use keyhole_imaging::phantom::{self, PhantomSettings};
use std::path::PathBuf;
use std::time::Duration;

/// Arguments of `keyhole phantom`.
#[derive(Debug, clap::Args)]
pub struct PhantomArgs {
    /// The folder for the series (ct_0000.dcm, ...) and its segmentation (seg.dcm), which must not be there or be empty.
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,
    /// Distance of pixels within a slice, mm.
    #[arg(long, value_name = "MM", default_value_t = PhantomSettings::default().pixel_mm, value_parser = spacing)]
    pub pixel: f64,
    /// Distance of slices, mm.
    #[arg(long, value_name = "MM", default_value_t = PhantomSettings::default().slice_mm, value_parser = spacing)]
    pub slice: f64,
    /// Standard deviation of the noise, Hounsfield units.
    #[arg(long, value_name = "HU", default_value_t = PhantomSettings::default().noise_hu, value_parser = noise)]
    pub noise: f64,
    /// Seed of the noise.
    #[arg(long, value_name = "N", default_value_t = PhantomSettings::default().seed)]
    pub seed: u64,
}

/// Samples the phantom, writes it and lists its segments.
///
/// # Errors
/// Status 2 for a folder that is in use; status 1 when it cannot be written.
pub fn run(args: PhantomArgs) -> Result<(), Failure> {
    let place = args.output.display().to_string();
    let folder = Folder::begin(&args.output).map_err(|e| Failure::input(format!("{place}: {e}")))?;
    let settings = PhantomSettings { pixel_mm: args.pixel, slice_mm: args.slice, noise_hu: args.noise, seed: args.seed };
    let bar = ProgressBar::new_spinner();
    bar.set_message("sampling");
    bar.enable_steady_tick(Duration::from_millis(100));
    let volume = phantom::sample(&settings);
    bar.set_length(volume.dims[2] as u64 + 1);
    if let Ok(style) = ProgressStyle::with_template("{wide_bar} file {pos} of {len}") {
        bar.set_style(style);
    }
    let mut progress = || bar.inc(1);
    dicom_write::write(folder.path(), &settings, &volume, &mut progress).map_err(Failure::job)?;
    folder.finish().map_err(|e| Failure::job(format!("{place}: {e}")))?;
    bar.finish_and_clear();
    let [columns, rows, slices] = volume.dims;
    println!("{place}: {slices} slices of {columns} x {rows} and {SEGMENTATION_FILE} with these segments:");
    for (structure, mask) in volume.structures.iter().zip(&volume.masks) {
        let ml = mask.iter().filter(|v| **v != 0).count() as f64 * args.pixel * args.pixel * args.slice * 1e-3;
        println!("  {:2} {:14} {ml:8.1} ml, {:5} HU", structure.number, structure.name, structure.hu);
    }
    Ok(())
}

/// A distance of voxels that neither fills the disk nor misses the organs.
fn spacing(text: &str) -> Result<f64, String> {
    let expected = || format!("`{text}`: expected millimetres from 0.5 to 10");
    text.parse().ok().filter(|v| (0.5..=10.0).contains(v)).ok_or_else(expected)
}

fn noise(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|v| (0.0..=500.0).contains(v)).ok_or_else(|| format!("`{text}`: expected Hounsfield units from 0 to 500"))
}
