//! The study as one page: what agrees with the paper and what does not, then every plot. Nothing on it was written before the numbers were
//! known but the paper's own.

use crate::study::Study;
use crate::study::claims::{self, Avoided, JUDGED, PAPER_AVOIDED, PAPER_HYBRID, PAPER_SYMMETRIC, Quality};
use crate::study::plan::{METHODS, method_name, pattern_name};
use crate::study::plots::Drawing;
use crate::study::run::{Run, elastic};
use crate::study::stable_step::TOLERANCE;
use keyhole_whiteboard::CutMethod;
use maud::{DOCTYPE, Markup, PreEscaped, html};

const STYLE: &str = "body{font:16px/1.45 system-ui,sans-serif;max-width:1100px;margin:2em auto;padding:0 1em;color:#222}\
table{border-collapse:collapse;margin:1em 0;font-size:14px;font-variant-numeric:tabular-nums}\
td,th{border:1px solid #ccc;padding:.25em .6em;text-align:right}td:first-child,th:first-child{text-align:left}th{background:#f3f3f3}\
img{width:100%;border:1px solid #ddd}figure{margin:1.5em 0}figcaption{font-size:14px;color:#444}\
.yes{color:#06703f;font-weight:600}.no{color:#a33000;font-weight:600}details{margin:1em 0}summary{cursor:pointer}";

/// A page of the study.
fn frame(title: &str, body: &Markup) -> String {
    html! {
        (DOCTYPE)
        html lang="en" {
            head { meta charset="utf-8"; title { (title) } style { (PreEscaped(STYLE)) } }
            body { h1 { (title) } (body) }
        }
    }
    .into_string()
}

fn verdict(agrees: bool) -> Markup {
    html! { @if agrees { span.yes { "agrees" } } @else { span.no { "does not agree" } } }
}

fn percent(part: f64) -> String {
    format!("{:.0} %", part * 100.0)
}

fn settings(run: &Run) -> String {
    let c = run.combination;
    let pattern = c.pattern;
    format!(
        "{}/{}, {}",
        pattern_name(pattern.hull),
        pattern_name(pattern.core),
        if c.snap > 0.0 { format!("T = {}", c.snap) } else { "no snapping".into() }
    )
}

fn table(header: &[&str], rows: &[Vec<Markup>]) -> Markup {
    html! {
        table {
            tr { @for h in header { th { (h) } } }
            @for row in rows { tr { @for cell in row { td { (cell) } } } }
        }
    }
}

fn cell(text: impl std::fmt::Display) -> Markup {
    let text = text.to_string();
    html! { (text) }
}

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
        (lag(study))
        @for d in pictures { (figure(d)) }
        h2 { "Growth" }
        (growth(study))
        h2 { "Operations" }
        (operations(study))
        h2 { "Shape during the cut" }
        (quality(study))
        h2 { "Which snapping threshold" }
        (snapping(study))
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

fn lag(study: &Study) -> Markup {
    let rates = &study.plan.rates;
    let mut rows = Vec::new();
    for method in METHODS {
        for &rate in rates {
            let Some((run, lag)) = claims::largest_lag(study, method, rate) else { continue };
            let at = run.figures.iter().max_by(|a, b| a.lag_mm.total_cmp(&b.lag_mm)).map_or(0.0, |f| f.progress);
            rows.push(vec![
                cell(method_name(method)),
                cell(rate),
                cell(format!("{:.3}", claims::mean_lag(study, method, rate))),
                cell(format!("{lag:.2}")),
                cell(format!("{}, {}, at {}", claims::place(study, run), settings(run), percent(at))),
            ]);
        }
    }
    let largest = |method, rate| claims::largest_lag(study, method, rate).map_or(0.0, |(_, lag)| lag);
    let cases: Vec<(CutMethod, f64)> =
        [CutMethod::Progressive, CutMethod::Hybrid].into_iter().flat_map(|m| rates.iter().map(move |r| (m, *r))).collect();
    let within = cases.iter().all(|(m, r)| claims::mean_lag(study, *m, *r) <= *r);
    let trails = rates.iter().all(|r| claims::mean_lag(study, CutMethod::NonProgressive, *r) > 0.5);
    let worst = cases.iter().map(|(m, r)| largest(*m, *r)).fold(0.0, f64::max);
    html! {
        p {
            "Paper: the non-progressive wound visibly trails behind the blade, that of progressive and hybrid does not. Here, on average of all cuts and moments, non-progressive trails by more than half an edge: "
            (verdict(trails)) ", the others by no more than a sample: " (verdict(within)) ". The largest lag of the others is " (format!("{worst:.2}"))
            " of an edge, of non-progressive " (format!("{:.1}", rates.iter().map(|r| largest(CutMethod::NonProgressive, *r)).fold(0.0, f64::max)))
            " edges. A blade that has entered through the inside of a face has no wound yet until it crosses the first edge: there every method lags."
        }
        (table(&["method", "rate", "mean lag / edge", "largest lag / edge", "where"], &rows))
    }
}

fn growth(study: &Study) -> Markup {
    let all = claims::growth(study);
    let [low, high] = PAPER_SYMMETRIC;
    let g = |r: &Run| format!("{:.2}", r.end().growth);
    let rows: Vec<Vec<Markup>> = all
        .iter()
        .map(|c| {
            vec![
                cell(claims::place(study, c.symmetric)),
                cell(percent(c.symmetric.cut_share())),
                cell(g(c.symmetric)),
                cell(g(c.hybrid)),
                cell(g(c.hybrid_unsnapped)),
                cell(g(c.mixture)),
                cell(g(c.mixture_unsnapped)),
                cell(if c.is_the_papers_case() { "yes" } else { "" }),
            ]
        })
        .collect();
    let case = claims::closest(&all);
    html! {
        p { "Paper: where symmetric subdivision makes almost 3 times the elements, hybrid makes " (PAPER_HYBRID) " times." }
        @if let Some(c) = case {
            p {
                @if c.is_the_papers_case() { "The case most like the paper's, with symmetric growth from " (low) " to " (high) ", is " }
                @else { "No cut has a symmetric growth from " (low) " to " (high) ". The closest is " }
                b { (claims::place(study, c.symmetric)) } ": progressive symmetric " b { (g(c.symmetric)) } " (paper: almost 3), hybrid minimal " b { (g(c.hybrid)) }
                " (paper: " (PAPER_HYBRID) "), the paper's own mixture of symmetric hull and minimal core " b { (g(c.mixture)) } ". That hybrid stays at "
                (PAPER_HYBRID) " or below: " (verdict(c.agrees())) "."
            }
            p {
                (percent(c.hybrid_unsnapped.cut_share())) " of the tetrahedra are cut there, whatever the method. Progressive symmetric makes "
                (format!("{:.1}", c.symmetric.parts_a_tet())) " parts of each on average, minimal " (format!("{:.1}", c.hybrid_unsnapped.parts_a_tet()))
                " without snapping; a growth of " (PAPER_HYBRID) " allows " (format!("{:.1}", c.parts_allowed())) ". Snapping cuts fewer of them ("
                (percent(c.hybrid.cut_share())) "), but only where the blade has settled before anything is released: in the hull, which is "
                (percent(1.0 - c.symmetric.core_share())) " of what is cut there, hybrid releases at once. The growth is set by how much of the mesh is cut: the finer "
                "the mesh, the smaller."
            }
        }
        p { "That hybrid minimal stays at " (PAPER_HYBRID) " or below wherever symmetric makes " (low) " to " (high) ": "
            @let cases: Vec<_> = all.iter().filter(|c| c.is_the_papers_case()).collect();
            (cases.iter().filter(|c| c.agrees()).count()) " of " (cases.len()) " cuts." }
        (table(&["mesh, stroke", "cut", "progressive symmetric", "hybrid minimal", "... no snapping", "hybrid mixture", "... no snapping", "paper's case"], &rows))
    }
}

fn operations(study: &Study) -> Markup {
    let row = |a: &Avoided| {
        vec![
            cell(claims::place(study, a.hybrid)),
            cell(settings(a.hybrid)),
            cell(a.hybrid.combination.rate),
            cell(percent(a.progressive.core_share())),
            cell(percent(a.deleted())),
            cell(percent(a.created())),
            cell(percent(a.updated())),
            cell(percent(a.deleted_and_updated())),
            cell(percent(a.expected())),
        ]
    };
    let header =
        ["mesh, stroke", "hull/core, snapping", "rate", "core share", "deleted", "created", "updated", "deleted + updated", "expected"];
    let same = claims::avoided(study);
    let symmetric = claims::avoided_of_symmetric(study);
    let range = |all: &[Avoided]| {
        let parts = || all.iter().map(Avoided::deleted_and_updated);
        (parts().fold(f64::INFINITY, f64::min), parts().fold(f64::NEG_INFINITY, f64::max))
    };
    let at = |rate: f64| {
        let of: Vec<&Avoided> = same.iter().filter(|a| a.hybrid.combination.rate == rate).collect();
        let mean = |f: &dyn Fn(&Avoided) -> f64| of.iter().map(|a| f(a)).sum::<f64>() / of.len().max(1) as f64;
        (mean(&|a| a.deleted()), mean(&|a| a.updated()), mean(&|a| a.expected()), mean(&|a| a.progressive.core_share()))
    };
    let count = |all: &[Avoided]| all.iter().filter(|a| a.agrees()).count();
    let ((a, b), (c, d)) = (range(&same), range(&symmetric));
    html! {
        p {
            "Paper: hybrid avoids four of five operations of progressive. Here, with patterns and snapping the same for both, hybrid avoids " b { (percent(a)) " to " (percent(b)) }
            " of deletions and updates; at least " (percent(PAPER_AVOIDED)) " in " (count(&same)) " of " (same.len()) " cuts: " (verdict(count(&same) == same.len())) ". Hybrid with minimal patterns and snapping against "
            "symmetric progressive subdivision: " b { (percent(c)) " to " (percent(d)) } ", at least " (percent(PAPER_AVOIDED)) " in " (count(&symmetric)) " of " (symmetric.len()) "."
        }
        @for rate in &study.plan.rates {
            @let (deleted, updated, expected, core) = at(*rate);
            p { "At a sample every " (rate) " of an edge: deletions avoided " (percent(deleted)) ", updates " (percent(updated)) " on average, core share " (percent(core)) ", expected " (percent(expected)) "." }
        }
        p {
            "What can be avoided is bounded by the mesh: hull tetrahedra are treated as progressive does. Were core tetrahedra as costly as hull ones, hybrid would avoid the core's "
            "share of what the non-progressive method avoids; that is the column \u{201c}expected\u{201d}. The finer the mesh, the larger the core's share, and the more samples an edge takes, the more "
            "updates progressive makes of each tetrahedron."
        }
        details open { summary { "Against symmetric progressive subdivision without snapping" } (table(&header, &symmetric.iter().map(row).collect::<Vec<_>>())) }
        details { summary { "With the same patterns and snapping" } (table(&header, &same.iter().map(row).collect::<Vec<_>>())) }
    }
}

fn quality(study: &Study) -> Markup {
    let all = claims::quality(study);
    let end = |r: &Run| r.end().mean_edge_ratio.unwrap_or_default();
    let row = |q: &Quality| {
        let [p, n, h] = q.runs;
        let mut row = vec![cell(claims::place(study, p)), cell(settings(p))];
        row.extend([p, n, h].map(|r| cell(format!("{:.3}", end(r)))));
        row.extend([p, h].map(|r| cell(format!("{:.3} ({})", Quality::dip(r), Quality::minima(r)))));
        row.push(cell(format!("{:+.3}", q.hybrid_above_progressive())));
        row.push(cell(if q.same_end() { "yes" } else { "" }));
        row
    };
    let dips = all.iter().filter(|q| q.progressive_dips()).count();
    let less = all.iter().filter(|q| Quality::dip(q.runs[2]) < Quality::dip(q.runs[0])).count();
    let deeper = all.iter().filter(|q| Quality::dip(q.runs[2]) > Quality::dip(q.runs[0])).count();
    let above = all.iter().filter(|q| q.hybrid_above_progressive() > 0.0).count();
    let snapped: Vec<&Quality> = all.iter().filter(|q| q.runs[0].combination.snap > 0.0).collect();
    let plain: Vec<&Quality> = all.iter().filter(|q| q.runs[0].combination.snap == 0.0).collect();
    let ordered = snapped.iter().filter(|q| end(q.runs[1]) >= end(q.runs[2]) && end(q.runs[2]) >= end(q.runs[0])).count();
    let same = plain.iter().filter(|q| q.same_end()).count();
    let uniform = plain.iter().filter(|q| q.runs[0].combination.pattern.hull == q.runs[0].combination.pattern.core).count();
    let uniform_same =
        plain.iter().filter(|q| q.runs[0].combination.pattern.hull == q.runs[0].combination.pattern.core && q.same_end()).count();
    html! {
        p {
            "Paper: progressive's mean edge ratio has local minima while tetrahedra are half cut. Here it has in " (dips) " of " (all.len()) " cuts: "
            (verdict(2 * dips > all.len())) ". The deepest of them is shallower with hybrid in " (less) " and deeper in " (deeper) ": " (verdict(less > deeper))
            ". Over the cut its mean edge ratio is above progressive's in " (above) " of " (all.len()) "."
        }
        p {
            "At the end, with snapping, the order is non-progressive, hybrid, progressive in " (ordered) " of " (snapped.len()) " cuts: what is released at once is not snapped. Without snapping "
            "the three methods end in the same mesh to the bit in " (same) " of " (plain.len()) " cuts (" (uniform_same) " of " (uniform)
            " with one pattern for hull and core), so there the final quality is a matter of the pattern alone."
        }
        details {
            summary { "All cuts. Dip: depth of the deepest local minimum, below what was before and after it; in brackets the number of local minima" }
            (table(&["mesh, stroke", "hull/core, snapping", "progressive end", "non-progr. end", "hybrid end", "progressive dip", "hybrid dip", "hybrid - progressive", "same mesh"],
                &all.iter().map(row).collect::<Vec<_>>()))
        }
    }
}

fn snapping(study: &Study) -> Markup {
    let all = claims::thresholds(study);
    let rows: Vec<Vec<Markup>> = all
        .iter()
        .map(|t| std::iter::once(cell(t.snap)).chain(JUDGED.iter().map(|(_, of, _)| cell(format!("{:.3}", of(t))))).collect())
        .collect();
    let header: Vec<&str> = std::iter::once("T").chain(JUDGED.iter().map(|(name, _, _)| *name)).collect();
    html! {
        p { "Hybrid, minimal patterns, at the end of the cut; geometric mean over all meshes and strokes, relative to no snapping. Of growth less is better, of all else more." }
        (table(&header, &rows))
        ul {
            @for (name, of, more) in &JUDGED {
                @if let Some(best) = claims::best_by(&all, *of, *more) { li { "best by " (name) ": T = " (best) } }
            }
        }
        @if let Some(best) = claims::best(&all) {
            p { "Best by all five together, with equal weights (geometric mean of the gains): " b { "T = " (best) } ". The default is " (keyhole_whiteboard::CutSettings::default().snap) "." }
        }
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
