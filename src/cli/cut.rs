//! `keyhole cut`: a blade's recorded path cut through a mesh, with a VTU file a sample and a table of figures.

use crate::cli::{Failure, MethodArg};
use crate::report::folder::Folder;
use indicatif::{ProgressBar, ProgressStyle};
use keyhole_cutting::{BatchCut, BatchRow, read_blade};
use keyhole_tetmesh::components::Components;
use keyhole_tetmesh::vtu::{self, CellArray};
use keyhole_whiteboard::{CutPattern, CutSettings};
use std::path::{Path, PathBuf};

/// Arguments of `keyhole cut`.
#[derive(Debug, clap::Args)]
pub struct CutArgs {
    /// The mesh: a VTU file of tetrahedra, metres.
    pub mesh: PathBuf,
    /// The blade's path: CSV with the header t_s,tip_x,tip_y,tip_z,heel_x,heel_y,heel_z,active, metres.
    #[arg(long, value_name = "FILE.csv")]
    pub blade: PathBuf,
    /// Folder for step_00000.vtu and on, one a blade sample, and steps.csv; must not be there or be empty.
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,
    /// When a crossing becomes effective.
    #[arg(long, value_enum, default_value = "hybrid")]
    pub method: MethodArg,
    /// Pattern of the hull and, after a comma, of the core if it is another: minimal or symmetric.
    #[arg(long, value_name = "HULL[,CORE]", default_value = "minimal", value_parser = patterns)]
    pub pattern: [CutPattern; 2],
    /// A crossing within this part of its edge from a node moves the node onto the cut instead; 0 never, at most 0.4.
    #[arg(long, value_name = "T", default_value_t = 0.2, value_parser = snap)]
    pub snap: f64,
    /// Write every N-th VTU file and the last one.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    pub every: u32,
}

/// Cuts and writes.
///
/// # Errors
/// Status 2 for a mesh, a path or a folder that is not as it should be; status 1 when writing fails.
pub fn run(args: &CutArgs) -> Result<(), Failure> {
    let mesh = vtu::read(&args.mesh).map_err(Failure::input)?;
    let samples = read_blade(&args.blade).map_err(Failure::input)?;
    let named = |e: std::io::Error| format!("{}: {e}", args.output.display());
    let folder = Folder::begin(&args.output).map_err(|e| Failure::input(named(e)))?;
    let [hull, core] = args.pattern;
    let before = mesh.tet_count();
    let mut cut = BatchCut::new(mesh, CutSettings { method: args.method.into(), hull, core, snap: args.snap });
    let table = folder.path().join("steps.csv");
    let mut writer = csv::Writer::from_path(&table).map_err(Failure::job)?;
    let bar = progress_bar(samples.len() as u64);
    let mut last = BatchRow::default();
    let mut operations = [0_u64; 3];
    for (i, sample) in samples.iter().enumerate() {
        let is_last = i + 1 == samples.len();
        // The path's end settles everything: the last row and the last file show the mesh as it stays.
        let row = if is_last { cut.last_sample(*sample) } else { cut.sample(*sample) };
        writer.serialize(row).map_err(Failure::job)?;
        if is_last || i % args.every as usize == 0 {
            let path = folder.path().join(format!("step_{i:05}.vtu"));
            write_step(&path, &cut).map_err(Failure::job)?;
        }
        for (sum, n) in operations.iter_mut().zip([row.deleted, row.created, row.updated]) {
            *sum += n;
        }
        last = row;
        bar.inc(1);
    }
    writer.flush().map_err(Failure::job)?;
    drop(writer);
    bar.finish_and_clear();
    let out = folder.finish().map_err(|e| Failure::job(named(e)))?;
    let [deleted, created, updated] = operations;
    println!(
        "{} samples: {before} tetrahedra became {} in {} fragment(s); {deleted} deleted, {created} created, {updated} updated",
        samples.len(),
        last.tets,
        last.fragments
    );
    println!(
        "swept {:.1} mm2, opened {:.1} mm2; along the cut: mean edge ratio {:.3}, smallest dihedral angle {:.2} degrees",
        last.swept_area_mm2, last.opened_area_mm2, last.mean_edge_ratio, last.min_dihedral_deg
    );
    println!("{}", out.display());
    Ok(())
}

fn write_step(path: &Path, cut: &BatchCut) -> Result<(), vtu::VtuError> {
    let components = Components::of(&cut.mesh);
    let ids = || cut.mesh.iter().map(|(t, _)| t);
    let fragment = CellArray { name: "fragment", values: ids().map(|t| components.component(t) as i32).collect() };
    let temporary = CellArray { name: "temporary", values: ids().map(|t| i32::from(cut.is_temporary(t))).collect() };
    vtu::write(path, &cut.mesh, &[fragment, temporary])
}

fn progress_bar(samples: u64) -> ProgressBar {
    let bar = ProgressBar::new(samples);
    if let Ok(style) = ProgressStyle::with_template("{bar:40} {pos}/{len} samples {elapsed}") {
        bar.set_style(style);
    }
    bar
}

fn patterns(text: &str) -> Result<[CutPattern; 2], String> {
    let one = |name: &str| match name {
        "minimal" => Ok(CutPattern::Minimal),
        "symmetric" => Ok(CutPattern::Symmetric),
        _ => Err(format!("`{text}`: expected minimal or symmetric, or two of them with a comma: hull, then core")),
    };
    match text.split(',').collect::<Vec<_>>()[..] {
        [both] => Ok([one(both)?; 2]),
        [hull, core] => Ok([one(hull)?, one(core)?]),
        _ => Err(format!("`{text}`: expected one or two patterns")),
    }
}

fn snap(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|t| (0.0..=0.4).contains(t)).ok_or_else(|| format!("`{text}`: expected a number from 0 to 0.4"))
}
