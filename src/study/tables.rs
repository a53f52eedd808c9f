//! The tables: CSV, one flat record a row. What the wall clock says has a table of its own, so that all others repeat bit for bit.

use crate::study::StudyError;
use crate::study::plan::{Combination, Plan, method_name, pattern_name};
use crate::study::run::{Figures, Run};
use serde::Serialize;
use std::path::Path;

/// What a row is about.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Key<'a> {
    mesh: &'a str,
    stroke: &'static str,
    method: &'static str,
    hull: &'static str,
    core: &'static str,
    snap: f64,
    rate: f64,
}

impl<'a> Key<'a> {
    fn of(plan: &'a Plan, c: &Combination) -> Self {
        Self {
            mesh: &plan.meshes[c.mesh].name,
            stroke: c.stroke.name(),
            method: method_name(c.method),
            hull: pattern_name(c.pattern.hull),
            core: pattern_name(c.pattern.core),
            snap: c.snap,
            rate: c.rate,
        }
    }

    const HEADER: [&'static str; 7] = ["mesh", "stroke", "method", "hull", "core", "snap", "rate"];
}

/// Figures of one moment, in the order of [`MOMENT_HEADER`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
struct Moment {
    progress: f64,
    tets: usize,
    growth: f64,
    deleted: u64,
    created: u64,
    updated: u64,
    deferred: u64,
    along: usize,
    mean_edge_ratio: Option<f64>,
    min_edge_ratio: Option<f64>,
    min_dihedral_deg: Option<f64>,
    p1_dihedral_deg: Option<f64>,
    min_altitude_mm: Option<f64>,
    stable_step_us: Option<f64>,
    swept_mm2: f64,
    opened_mm2: f64,
    lag_mm: f64,
}

const MOMENT_HEADER: [&str; 17] = [
    "progress",
    "tets",
    "growth",
    "deleted",
    "created",
    "updated",
    "deferred",
    "along",
    "mean_edge_ratio",
    "min_edge_ratio",
    "min_dihedral_deg",
    "p1_dihedral_deg",
    "min_altitude_mm",
    "stable_step_us",
    "swept_mm2",
    "opened_mm2",
    "lag_mm",
];

impl From<&Figures> for Moment {
    fn from(f: &Figures) -> Self {
        Self {
            progress: f.progress,
            tets: f.tets,
            growth: f.growth,
            deleted: f.operations.deleted,
            created: f.operations.created,
            updated: f.operations.updated,
            deferred: f.operations.deferred,
            along: f.along,
            mean_edge_ratio: f.mean_edge_ratio,
            min_edge_ratio: f.min_edge_ratio,
            min_dihedral_deg: f.min_dihedral_deg,
            p1_dihedral_deg: f.p1_dihedral_deg,
            min_altitude_mm: f.min_altitude_mm,
            stable_step_us: f.stable_step_us,
            swept_mm2: f.swept_mm2,
            opened_mm2: f.opened_mm2,
            lag_mm: f.lag_mm,
        }
    }
}

/// What a whole cut has beside its last moment, in the order of [`WHOLE_HEADER`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
struct Whole {
    samples: usize,
    mean_edge_mm: f64,
    tets_before: usize,
    cut_tets: usize,
    core_share: f64,
    parts_a_tet: f64,
    core_min_dihedral_deg: Option<f64>,
    core_p1_dihedral_deg: Option<f64>,
    core_min_altitude_mm: Option<f64>,
    fragments: usize,
    max_lag_mm: f64,
    lowest_mean_edge_ratio: Option<f64>,
    smallest_stable_step_us: Option<f64>,
}

const WHOLE_HEADER: [&str; 13] = [
    "samples",
    "mean_edge_mm",
    "tets_before",
    "cut_tets",
    "core_share",
    "parts_a_tet",
    "core_min_dihedral_deg",
    "core_p1_dihedral_deg",
    "core_min_altitude_mm",
    "fragments",
    "max_lag_mm",
    "lowest_mean_edge_ratio",
    "smallest_stable_step_us",
];

impl From<&Run> for Whole {
    fn from(r: &Run) -> Self {
        Self {
            samples: r.samples,
            mean_edge_mm: r.mean_edge_mm,
            tets_before: r.tets_before,
            cut_tets: r.cut_tets,
            core_share: r.core_share(),
            parts_a_tet: r.parts_a_tet(),
            core_min_dihedral_deg: r.core.map(|c| c.min_dihedral_deg),
            core_p1_dihedral_deg: r.core.map(|c| c.p1_dihedral_deg),
            core_min_altitude_mm: r.core.map(|c| c.min_altitude_m * 1e3),
            fragments: r.fragments,
            max_lag_mm: r.max_lag_mm,
            lowest_mean_edge_ratio: r.lowest_edge_ratio().map(|(ratio, _)| ratio),
            smallest_stable_step_us: r.smallest_step_us(),
        }
    }
}

/// Writes a table whose rows are structs side by side.
fn table<T: Serialize>(path: &Path, header: &[&[&str]], rows: impl Iterator<Item = T>) -> Result<(), StudyError> {
    let named = |source| StudyError::Table { path: path.into(), source };
    let mut writer = csv::WriterBuilder::new().has_headers(false).from_path(path).map_err(named)?;
    writer.write_record(header.iter().copied().flatten()).map_err(named)?;
    for row in rows {
        writer.serialize(row).map_err(named)?;
    }
    writer.flush().map_err(|e| named(e.into()))
}

/// `figures.csv`: every moment of every cut, those of the sweep after the others.
///
/// # Errors
/// When it cannot be written.
pub fn figures(path: &Path, plan: &Plan, runs: &[&Run]) -> Result<(), StudyError> {
    let rows = runs.iter().flat_map(|r| r.figures.iter().map(|f| (Key::of(plan, &r.combination), Moment::from(f))));
    table(path, &[&Key::HEADER, &MOMENT_HEADER], rows)
}

/// `summary.csv`, `snap.csv`: a row a cut, as it ended.
///
/// # Errors
/// When it cannot be written.
pub fn summary(path: &Path, plan: &Plan, runs: &[&Run]) -> Result<(), StudyError> {
    let rows = runs.iter().map(|r| (Key::of(plan, &r.combination), Whole::from(*r), Moment::from(&r.end())));
    table(path, &[&Key::HEADER, &WHOLE_HEADER, &MOMENT_HEADER], rows)
}

/// `latency.csv`: what the wall clock said.
///
/// # Errors
/// When it cannot be written.
pub fn latency(path: &Path, plan: &Plan, runs: &[&Run]) -> Result<(), StudyError> {
    let header: &[&str] = &["tets_before", "events", "p50_us", "p99_us", "max_us"];
    let rows = runs.iter().map(|r| {
        let l = r.latency;
        (Key::of(plan, &r.combination), r.tets_before, l.events, l.p50_us, l.p99_us, l.max_us)
    });
    table(path, &[&Key::HEADER, header], rows)
}
