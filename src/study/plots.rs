//! The plots: a grid of panels a figure, meshes side by side, patterns below one another, a line a method.

use crate::study::grid::{Grid, Line, Row, draw};
use crate::study::plan::{METHODS, PATTERNS, Pattern, Plan, method_name};
use crate::study::run::{Figures, Run};
use crate::study::strokes::Stroke;
use crate::study::svg::Drawing;
use crate::study::{Study, StudyError};

/// A figure as a function of progress.
struct Measure {
    file: &'static str,
    title: &'static str,
    axis: &'static str,
    log: bool,
    solid: fn(&Run, &Figures) -> Option<f64>,
    /// What the dashed line is; without one it is the same without snapping.
    dashed: Option<fn(&Run, &Figures) -> Option<f64>>,
    lines: [&'static str; 2],
}

const SNAP: [&str; 2] = ["snapping as by default", "no snapping"];

const MEASURES: [Measure; 9] = [
    Measure {
        file: "fig6_edge_ratio",
        title: "Mean edge ratio along the cut (the paper's figure 6)",
        axis: "shortest / longest edge",
        log: false,
        solid: |_, f| f.mean_edge_ratio,
        dashed: None,
        lines: SNAP,
    },
    Measure {
        file: "fig7_growth",
        title: "Growth (the paper's figure 7)",
        axis: "tets / tets at the start",
        log: false,
        solid: |_, f| Some(f.growth),
        dashed: None,
        lines: SNAP,
    },
    Measure {
        file: "fig8_operations",
        title: "Operations (the paper's figure 8), snapping as by default",
        axis: "operations / cut tet",
        log: false,
        solid: |r, f| Some(f.operations.deleted as f64 / r.cut_tets.max(1) as f64),
        dashed: Some(|r, f| Some(f.operations.updated as f64 / r.cut_tets.max(1) as f64)),
        lines: ["deleted", "updated"],
    },
    Measure {
        file: "area",
        title: "Opened and swept area, snapping as by default",
        axis: "area / mm2",
        log: false,
        solid: |_, f| Some(f.opened_mm2),
        dashed: Some(|_, f| Some(f.swept_mm2)),
        lines: ["opened", "swept"],
    },
    Measure {
        file: "lag",
        title: "Lag of the visible wound behind the blade (the paper's figure 4 as a number)",
        axis: "lag / mm",
        log: false,
        solid: |_, f| Some(f.lag_mm),
        dashed: None,
        lines: SNAP,
    },
    Measure {
        file: "dihedral_min",
        title: "Smallest dihedral angle along the cut",
        axis: "angle / degrees",
        log: true,
        solid: |_, f| f.min_dihedral_deg,
        dashed: None,
        lines: SNAP,
    },
    Measure {
        file: "dihedral_p1",
        title: "First percentile of the tets' smallest dihedral angles along the cut",
        axis: "angle / degrees",
        log: true,
        solid: |_, f| f.p1_dihedral_deg,
        dashed: None,
        lines: SNAP,
    },
    Measure {
        file: "altitude",
        title: "Smallest altitude along the cut",
        axis: "altitude / mm",
        log: true,
        solid: |_, f| f.min_altitude_mm,
        dashed: None,
        lines: SNAP,
    },
    Measure {
        file: "stable_step",
        title: "Largest stable step of the explicit model",
        axis: "step / us",
        log: true,
        solid: |_, f| f.stable_step_us,
        dashed: None,
        lines: SNAP,
    },
];

/// Every measure for every stroke, at the coarser rate, then the sweep of the snapping threshold.
///
/// # Errors
/// What the drawing library says.
pub fn all(study: &Study) -> Result<Vec<Drawing>, StudyError> {
    let mut drawings = Vec::new();
    for measure in &MEASURES {
        for &stroke in &study.plan.strokes {
            drawings.push(draw(&grid(study, measure, stroke))?);
        }
    }
    drawings.push(draw(&sweep(study))?);
    Ok(drawings)
}

fn grid<'a>(study: &Study, measure: &Measure, stroke: Stroke) -> Grid<'a> {
    let rate = study.plan.rates.first().copied().unwrap_or_default();
    let [on, off] = Plan::snaps();
    let lines = |mesh: usize, pattern: Pattern| {
        let mut lines = Vec::new();
        for (colour, method) in METHODS.into_iter().enumerate() {
            let runs = study
                .runs
                .iter()
                .map(|r| (r, r.combination))
                .filter(|(_, c)| c.mesh == mesh && c.pattern == pattern && c.stroke == stroke && c.method == method && c.rate == rate);
            for (run, c) in runs {
                let points =
                    |of: fn(&Run, &Figures) -> Option<f64>| run.figures.iter().filter_map(|f| Some((f.progress, of(run, f)?))).collect();
                match measure.dashed {
                    Some(dashed) if c.snap == on => {
                        lines.push(Line { colour, dashed: false, points: points(measure.solid) });
                        lines.push(Line { colour, dashed: true, points: points(dashed) });
                    }
                    None => lines.push(Line { colour, dashed: c.snap == off, points: points(measure.solid) }),
                    Some(_) => {}
                }
            }
        }
        lines
    };
    let meshes = 0..study.plan.meshes.len();
    let mut legend: Vec<(String, usize, bool)> = METHODS.iter().enumerate().map(|(i, m)| (method_name(*m).into(), i, false)).collect();
    legend.push((measure.lines[0].into(), usize::MAX, false));
    legend.push((measure.lines[1].into(), usize::MAX, true));
    Grid {
        name: format!("{}_{}.svg", measure.file, stroke.name()),
        title: format!("{}; stroke {}, a sample every {rate} of an edge", measure.title, stroke.name()),
        x: "progress of the blade",
        columns: study.plan.meshes.iter().map(|m| m.name.clone()).collect(),
        rows: PATTERNS.iter().map(|p| Row { name: p.name(), axis: measure.axis, log: measure.log }).collect(),
        legend,
        panels: PATTERNS.iter().map(|p| meshes.clone().map(|m| lines(m, *p)).collect()).collect(),
    }
}

fn sweep<'a>(study: &Study) -> Grid<'a> {
    let measures: [(&str, &'static str, fn(&Run) -> Option<f64>); 7] = [
        ("smallest dihedral angle", "degrees", |r| r.end().min_dihedral_deg),
        ("first percentile of dihedral angles", "degrees", |r| r.end().p1_dihedral_deg),
        ("core: smallest dihedral angle", "degrees", |r| Some(r.core?.min_dihedral_deg)),
        ("core: first percentile", "degrees", |r| Some(r.core?.p1_dihedral_deg)),
        ("smallest altitude", "mm", |r| r.end().min_altitude_mm),
        ("growth", "tets / at start", |r| Some(r.end().growth)),
        ("stable step", "us", |r| r.end().stable_step_us),
    ];
    let strokes = &study.plan.strokes;
    let line = |of: fn(&Run) -> Option<f64>, stroke: Stroke, mesh: usize| {
        let runs = study.sweep.iter().filter(|r| r.combination.stroke == stroke && r.combination.mesh == mesh);
        Line { colour: mesh, dashed: false, points: runs.filter_map(|r| Some((r.combination.snap, of(r)?))).collect() }
    };
    let meshes = 0..study.plan.meshes.len();
    Grid {
        name: "snap.svg".into(),
        title: "Snapping threshold T: hybrid, minimal patterns, at the end of the cut".into(),
        x: "T",
        columns: strokes.iter().map(|s| s.name().into()).collect(),
        rows: measures.iter().map(|(name, axis, _)| Row { name: (*name).into(), axis, log: *axis != "tets / at start" }).collect(),
        legend: study.plan.meshes.iter().enumerate().map(|(i, m)| (m.name.clone(), i, false)).collect(),
        panels: measures
            .iter()
            .map(|(_, _, of)| strokes.iter().map(|s| meshes.clone().map(|m| line(*of, *s, m)).collect()).collect())
            .collect(),
    }
}
