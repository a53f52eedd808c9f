//! `keyhole mesh`: a scan becomes a volume mesh, or a surface that is only drawn.

use crate::cli::Failure;
use indicatif::{ProgressBar, ProgressStyle};
use keyhole_imaging::dicom_series::{self, Gaps};
use keyhole_imaging::{Centring, ComponentChoice, LabelChoice, MeshOptions, Selection, Stage, contact_sheet, drawn, glb, input, pipeline};
use keyhole_tetmesh::{DVec3, vtu};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Arguments of `keyhole mesh`.
#[derive(Debug, clap::Args)]
pub struct MeshArgs {
    /// A NIfTI label volume (.nii, .nii.gz), a DICOM-SEG, or a folder, zip archive or DICOMDIR with a CT series or one of these.
    pub input: PathBuf,
    /// .vtu: tetrahedra. .glb: a surface that is only drawn, or with --solid one that can be touched. World metres: X patient left, Y superior, Z anterior.
    #[arg(short, long, value_name = "OUT", required_unless_present = "list")]
    pub output: Option<PathBuf>,
    /// List the CT series or the segments of the input and do nothing else.
    #[arg(long)]
    pub list: bool,
    /// A label by its value, or by its segment's number or name. The first is the organ (material 0), the others lie in it (1, 2, ...).
    #[arg(long = "label", value_name = "NAME=VALUE", value_parser = label, conflicts_with = "threshold")]
    pub labels: Vec<LabelArg>,
    /// Hounsfield units from LO to HI of a CT series are the organ.
    #[arg(long, value_name = "LO..HI", value_parser = range, allow_hyphen_values = true, required_unless_present_any = ["labels", "list"])]
    pub threshold: Option<(f64, f64)>,
    /// SeriesInstanceUID, or number of the series, when the folder holds several.
    #[arg(long, value_name = "UID|N", requires = "threshold")]
    pub series: Option<String>,
    /// Interpolate slices that are missing from a CT series instead of refusing it.
    #[arg(long, requires = "threshold")]
    pub fill_gaps: bool,
    /// Which connected component: its number by volume, `largest` or `all`. Without it a mesh takes the one with most of the second
    /// label, a surface takes all.
    #[arg(long, value_name = "N|largest|all", value_parser = component, conflicts_with = "seed")]
    pub component: Option<ComponentChoice>,
    /// The component that holds this point, in patient coordinates as DICOM viewers show them (LPS, mm).
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true)]
    pub seed: Option<DVec3>,
    /// The lattice's cell, mm: long edges of the tetrahedra have this length.
    #[arg(long, value_name = "MM", default_value_t = 4.0)]
    pub edge: f64,
    /// The largest cell in the core, mm: away from the surface and from borders between parts cells double up to this. Without it all cells
    /// are the same.
    #[arg(long, value_name = "MM")]
    pub core: Option<f64>,
    /// Move the mesh's box to the origin instead of leaving it where the patient is (volume meshes only).
    #[arg(long)]
    pub centre: bool,
    /// Close the surface, so that tissue and instruments can touch it (.glb only): it is the boundary of tetrahedra of this --edge.
    #[arg(long)]
    pub solid: bool,
    /// Colour of a surface, linear RGB from 0 to 1.
    #[arg(long, value_name = "R,G,B", value_parser = colour, default_value = "0.8,0.8,0.8")]
    pub colour: [f32; 3],
    /// Write the quality figures as JSON.
    #[arg(long, value_name = "FILE.json")]
    pub report: Option<PathBuf>,
    /// Draw slices of the CT (of the labels where there is none) with the mesh's outline over them, and the surface (volume meshes only).
    #[arg(long, value_name = "FILE.png")]
    pub picture: Option<PathBuf>,
}

/// A label as it is asked for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LabelArg {
    name: String,
    /// A whole number, or a segment's name.
    value: String,
}

/// Makes the mesh and prints its quality figures.
///
/// # Errors
/// Status 2 for arguments and input that do not fit; status 1 when the result cannot be written.
pub fn run(args: MeshArgs) -> Result<(), Failure> {
    let Some(output) = args.output.filter(|_| !args.list) else { return list(&args.input) };
    let volume = match extension(&output).as_deref() {
        Some("vtu") => true,
        Some("glb") => false,
        _ => {
            let name = output.display();
            return Err(Failure::input(format!("{name}: expected a name that ends in .vtu (tetrahedra) or .glb (a surface)")));
        }
    };
    if let Some(picture) = args.picture.as_ref().filter(|p| !volume || extension(p).as_deref() != Some("png")) {
        let name = picture.display();
        return Err(Failure::input(format!("{name}: expected a name that ends in .png, and a volume mesh (.vtu) to draw")));
    }
    if args.solid && volume {
        return Err(Failure::input("--solid closes a surface: give an output that ends in .glb, or leave it out".to_owned()));
    }
    for out in std::iter::once(&output).chain(&args.report).chain(&args.picture) {
        let folder = out.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        if !folder.is_dir() {
            return Err(Failure::input(format!("{}: there is no folder {}: make it first", out.display(), folder.display())));
        }
    }
    let selection = match args.threshold {
        Some((low, high)) => Selection::Threshold {
            low,
            high,
            series: args.series.clone(),
            gaps: if args.fill_gaps { Gaps::Interpolate } else { Gaps::Refuse },
        },
        None => Selection::Labels(args.labels.iter().map(|l| choice(&args.input, l)).collect::<Result<_, _>>()?),
    };
    let component = args.seed.map(ComponentChoice::Seed).or(args.component);
    let bar = spinner();
    bar.set_message(format!("reading {}", args.input.display()));
    let labels = input::read(&args.input, &selection).map_err(Failure::input)?;
    let json = if args.solid {
        let options = MeshOptions {
            edge_mm: args.edge,
            core_doublings: 0,
            component: component.unwrap_or(ComponentChoice::All),
            centring: Centring::Patient,
        };
        let made = pipeline::make(labels, &options, &mut |stage: Stage| bar.set_message(stage.name())).map_err(Failure::input)?;
        let name = output.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        glb::write(&output, &name, &drawn::solid(&made.mesh), args.colour).map_err(Failure::job)?;
        bar.finish_and_clear();
        println!("{}", made.report);
        serde_json::to_vec_pretty(&made.report)
    } else if volume {
        let centring = if args.centre { Centring::Origin } else { Centring::Patient };
        let core_doublings = args.core.map_or(0.0, |core| (core / args.edge).log2().floor()).clamp(0.0, 8.0) as u8;
        let options = MeshOptions { edge_mm: args.edge, core_doublings, component: component.unwrap_or_default(), centring };
        let mut progress = |stage: Stage| bar.set_message(stage.name());
        let made = pipeline::make(labels, &options, &mut progress).map_err(Failure::input)?;
        vtu::write(&output, &made.mesh, &[]).map_err(Failure::job)?;
        if let Some(picture) = &args.picture {
            bar.set_message("picture");
            let ct = input::ct(&args.input, &selection);
            contact_sheet::write(picture, &made.contact_sheet(ct.as_ref())).map_err(Failure::job)?;
        }
        bar.finish_and_clear();
        println!("{}", made.report);
        serde_json::to_vec_pretty(&made.report)
    } else {
        bar.set_message("surface");
        let name = output.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let component = component.unwrap_or(ComponentChoice::All);
        let (surface, report) = drawn::draw(labels, component, args.edge).map_err(Failure::input)?;
        glb::write(&output, &name, &surface, args.colour).map_err(Failure::job)?;
        bar.finish_and_clear();
        println!(
            "surface: {} triangles, {} nodes, {} component(s); {:.2} ml, mask {:.2} ml",
            report.triangles,
            report.nodes,
            report.found.iter().filter(|c| c.chosen).count(),
            report.surface_ml,
            report.mask_ml
        );
        serde_json::to_vec_pretty(&report)
    }
    .map_err(Failure::job)?;
    println!("{}", output.display());
    if let Some(picture) = &args.picture {
        println!("{}", picture.display());
    }
    match &args.report {
        Some(path) => write_whole(path, &json).map_err(|e| Failure::job(format!("{}: {e}", path.display()))),
        None => Ok(()),
    }
}

fn extension(path: &Path) -> Option<String> {
    path.extension().map(|e| e.to_string_lossy().to_lowercase())
}

/// Hidden where standard error is no terminal.
fn spinner() -> ProgressBar {
    let bar = ProgressBar::new_spinner();
    if let Ok(style) = ProgressStyle::with_template("{spinner} {elapsed} {msg}") {
        bar.set_style(style);
    }
    bar.enable_steady_tick(Duration::from_millis(100));
    bar
}

fn write_whole(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut file = tempfile::Builder::new().prefix(".keyhole-").tempfile_in(folder)?;
    file.write_all(bytes)?;
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        file.as_file().set_permissions(std::fs::Permissions::from_mode(0o644))?;
    }
    file.persist(path).map(|_| ()).map_err(|e| e.error)
}

/// Prints what an input holds.
fn list(path: &Path) -> Result<(), Failure> {
    let segments = input::segments(path).map_err(Failure::input)?;
    for s in &segments {
        println!("segment {} {}", s.number, s.label);
    }
    let series = if segments.is_empty() || path.is_dir() { dicom_series::series_of(path).map_err(Failure::input)? } else { Vec::new() };
    for (i, s) in series.iter().enumerate() {
        println!("series {i} {} \"{}\", {} slices of {} x {}", s.uid, s.description, s.dims[2], s.dims[0], s.dims[1]);
    }
    if segments.is_empty() && series.is_empty() {
        println!("{}: no CT series and no segments; labels of a NIfTI file are chosen by their values", path.display());
    }
    Ok(())
}

/// The value of a label: as it is given, or that of the segment of this name.
fn choice(path: &Path, label: &LabelArg) -> Result<LabelChoice, Failure> {
    let name = label.name.clone();
    if let Ok(value) = label.value.parse() {
        return Ok(LabelChoice { name, value });
    }
    let segments = input::segments(path).map_err(Failure::input)?;
    match segments.iter().find(|s| s.label == label.value) {
        Some(s) => Ok(LabelChoice { name, value: s.number }),
        None => {
            let present: Vec<String> = segments.iter().map(|s| format!("{} ({})", s.label, s.number)).collect();
            let present = if present.is_empty() { "none: give the value as a whole number".into() } else { present.join(", ") };
            Err(Failure::input(format!("{}: there is no segment {}; its segments are {present}", path.display(), label.value)))
        }
    }
}

fn label(text: &str) -> Result<LabelArg, String> {
    let expected = || format!("`{text}`: expected NAME=VALUE with a whole number or a segment's name, as in kidney=1");
    let (name, value) = text.split_once('=').filter(|(n, v)| !n.is_empty() && !v.is_empty()).ok_or_else(expected)?;
    Ok(LabelArg { name: name.into(), value: value.into() })
}

fn range(text: &str) -> Result<(f64, f64), String> {
    let expected = || format!("`{text}`: expected LO..HI in Hounsfield units, LO below HI, as in 200..3000");
    let (low, high) = text.split_once("..").ok_or_else(expected)?;
    let (low, high) = (low.parse::<f64>().map_err(|_| expected())?, high.parse::<f64>().map_err(|_| expected())?);
    if low < high { Ok((low, high)) } else { Err(expected()) }
}

fn component(text: &str) -> Result<ComponentChoice, String> {
    match text {
        "largest" => Ok(ComponentChoice::Largest),
        "all" => Ok(ComponentChoice::All),
        n => n.parse().map(ComponentChoice::Rank).map_err(|_| format!("`{n}`: expected a number from 0, largest or all")),
    }
}

fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let values: Option<Vec<f64>> = text.split(',').map(|v| v.trim().parse().ok().filter(|v: &f64| v.is_finite())).collect();
    values?.try_into().ok()
}

fn point(text: &str) -> Result<DVec3, String> {
    numbers::<3>(text).map(DVec3::from_array).ok_or_else(|| format!("`{text}`: expected X,Y,Z in millimetres"))
}

fn colour(text: &str) -> Result<[f32; 3], String> {
    let within = |c: &[f64; 3]| c.iter().all(|v| (0.0..=1.0).contains(v));
    let rgb = numbers::<3>(text).filter(within).ok_or_else(|| format!("`{text}`: expected R,G,B, each from 0 to 1"))?;
    Ok(rgb.map(|v| v as f32))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_are_read_or_refused() {
        assert_eq!(label("kidney=1"), Ok(LabelArg { name: "kidney".into(), value: "1".into() }));
        assert_eq!(range("-100..300.5"), Ok((-100.0, 300.5)));
        assert_eq!(component("2"), Ok(ComponentChoice::Rank(2)));
        assert_eq!(point("1, -2.5,3"), Ok(DVec3::new(1.0, -2.5, 3.0)));
        assert!(["kidney", "=1", "kidney="].iter().all(|t| label(t).is_err()));
        assert!(["5..1", "1-5", "nan..2"].iter().all(|t| range(t).is_err()));
        assert!(component("-1").is_err() && point("1,2").is_err() && colour("1,2,0").is_err());
    }
}
