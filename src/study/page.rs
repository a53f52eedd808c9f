//! The study as one page: what agrees with the paper and what does not, then every plot. Nothing on it was written before the numbers were
//! known but the paper's own.

use crate::study::markup::{cell, frame, percent, settings, table};
use crate::study::plan::method_name;
use crate::study::run::elastic;
use crate::study::stable_step::TOLERANCE;
use crate::study::svg::Drawing;
use crate::study::{Study, claims, verdicts};
use maud::{Markup, html};

/// The whole page.
#[must_use]
pub fn page(study: &Study, plots: &[Drawing], pictures: &[Drawing]) -> String {
    let figure = |d: &Drawing| html! { figure { img src=(d.name) alt=(d.caption); figcaption { (d.caption) } } };
    let first = study.plan.strokes.first().map(|s| format!("_{}.svg", s.name())).unwrap_or_default();
    let of_first = |d: &&Drawing| d.name.ends_with(&first) || d.name == "snap.svg";
    let body = html! {
        p {
            "The evaluation of \u{201c}A minimal invasive surgery simulator employing a novel hybrid cutting method\u{201d}, repeated with this program's cutting. "
            "The same kernel cuts by three release policies and two patterns, so a difference between two lines is a difference of what the lines are called. "
            "Seed " (study.plan.seed) ". All tables but " a href="latency.html" { "latency" } " are the same bit for bit whenever the same program cuts the same meshes with the same seed."
        }
        (meshes(study))
        h2 { "The visible wound and the blade" }
        (verdicts::lag(study))
        @for d in pictures { (figure(d)) }
        h2 { "Growth" }
        (verdicts::growth(study))
        h2 { "Operations" }
        (verdicts::operations(study))
        h2 { "Shape during the cut" }
        (verdicts::quality(study))
        h2 { "Which snapping threshold" }
        (verdicts::snapping(study))
        h2 { "Plots" }
        @for d in plots.iter().filter(of_first) { (figure(d)) }
        @if plots.iter().any(|d| !of_first(&d)) {
            details { summary { "The other strokes" } @for d in plots.iter().filter(|d| !of_first(d)) { (figure(d)) } }
        }
        h2 { "Tables" }
        ul {
            li { a href="figures.csv" { "figures.csv" } ": every figure at every moment of every cut" }
            li { a href="summary.csv" { "summary.csv" } ": one row a cut, as it ended" }
            li { a href="snap.csv" { "snap.csv" } ": the sweep of the snapping threshold" }
            li { a href="latency.csv" { "latency.csv" } ": what the wall clock said; the only figures that another run does not repeat" }
        }
        h2 { "Words" }
        (words())
    };
    frame("Cutting, measured", &body)
}

fn meshes(study: &Study) -> Markup {
    let edge = |i: usize| study.runs.iter().find(|r| r.combination.mesh == i).map_or(0.0, |r| r.mean_edge_mm);
    let rows: Vec<Vec<Markup>> = study
        .plan
        .meshes
        .iter()
        .enumerate()
        .map(|(i, m)| {
            let hull = m.mesh.iter().filter(|(t, _)| m.mesh.tet(*t).hull).count();
            let tets = m.mesh.tet_count();
            vec![
                cell(&m.name),
                cell(tets),
                cell(m.mesh.node_count()),
                cell(percent(hull as f64 / tets.max(1) as f64)),
                cell(format!("{:.1}", edge(i))),
            ]
        })
        .collect();
    let strokes = study.plan.strokes.iter().map(|s| s.name()).collect::<Vec<_>>().join(", ");
    html! {
        (table(&["mesh", "tets", "nodes", "hull", "mean edge / mm"], &rows))
        p { "Strokes: " (strokes) ". " (study.runs.len() + study.sweep.len()) " cuts in all." }
    }
}

fn words() -> Markup {
    let e = elastic();
    let young = e.mu * (3.0 * e.lambda + 2.0 * e.mu) / (e.lambda + e.mu);
    let nu = e.lambda / (2.0 * (e.lambda + e.mu));
    html! {
        dl {
            dt { "along the cut" } dd { "the parts of all original tetrahedra that the cut has split or of which it has moved a node, so far" }
            dt { "edge ratio" } dd { "shortest / longest edge of a tetrahedron; 1 is best. It cannot see slivers: hence angles and altitudes" }
            dt { "hull, core" } dd { "tetrahedra that share a node with the surface; the others" }
            dt { "lag" } dd { "distance from where the blade goes through the surface to the nearest point of the wound there; the largest of the moments looked at" }
            dt { "rate" } dd { "way of the blade from one sample to the next, as a part of the mean edge" }
            dt { "stable step" } dd {
                "2 / omega_max of linear elasticity with lumped masses: E = " (format!("{young:.0}")) " Pa, Poisson's ratio " (format!("{nu:.2}")) ", " (e.density)
                " kg/m3 for all tetrahedra; matrix-free power iteration over the tetrahedra along the cut and their neighbours until the eigenvalue grows by less than "
                (TOLERANCE) " of itself in ten iterations, so the step is an upper bound"
            }
        }
    }
}

/// What the wall clock said, on a page of its own.
#[must_use]
pub fn latency(study: &Study) -> String {
    let rows: Vec<Vec<Markup>> = study
        .runs
        .iter()
        .map(|r| {
            let l = r.latency;
            vec![
                cell(claims::place(study, r)),
                cell(method_name(r.combination.method)),
                cell(settings(r)),
                cell(r.combination.rate),
                cell(l.events),
                cell(l.p50_us),
                cell(l.p99_us),
                cell(l.max_us),
            ]
        })
        .collect();
    let body = html! {
        p { "Wall-clock time from a blade sample to the new topology, microseconds, over the samples that changed something. Another run gives other numbers." }
        (table(&["mesh, stroke", "method", "hull/core, snapping", "rate", "events", "p50", "p99", "max"], &rows))
    };
    frame("Latency of a cut", &body)
}
