//! What agrees with the paper and what does not, in words.

use crate::study::Study;
use crate::study::claims::{self, Avoided, PAPER_AVOIDED, PAPER_HYBRID, PAPER_SYMMETRIC, Quality};
use crate::study::markup::{cell, percent, settings, table, verdict};
use crate::study::plan::{METHODS, method_name};
use crate::study::run::Run;
use crate::study::thresholds::{self, JUDGED, JUDGED_CORE};
use keyhole_whiteboard::CutMethod;
use maud::{Markup, html};

/// The wound and the blade.
pub(crate) fn lag(study: &Study) -> Markup {
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
            " edges. A blade that has entered through the inside of a face, or goes on through one of an earlier cut, has no wound there until it crosses an edge: then every method lags."
        }
        (table(&["method", "rate", "mean lag / edge", "largest lag / edge", "where"], &rows))
    }
}

/// Whether the cuts went through.
pub(crate) fn through(study: &Study) -> Markup {
    let all = claims::through(study);
    let runs: usize = all.iter().map(|t| t.runs.len()).sum();
    let bridged: usize = all.iter().map(|t| t.bridged().len()).sum();
    let rows: Vec<Vec<Markup>> = all
        .iter()
        .map(|t| {
            let [least, most] = t.opened();
            let mut of: Vec<String> =
                t.bridged().iter().map(|r| format!("{} pieces at rate {}", r.fragments, r.combination.rate)).collect();
            of.sort();
            of.dedup();
            let pieces = t.pieces().iter().max().copied().unwrap_or_default();
            vec![
                cell(t.runs.first().map_or(String::new(), |r| claims::place(study, r))),
                cell(t.runs.len()),
                cell(pieces),
                cell(t.bridged().len()),
                cell(of.join(", ")),
                cell(format!("{least:.3} to {most:.3}")),
            ]
        })
        .collect();
    html! {
        p {
            "Methods, patterns, snapping and rates differ, the stroke does not: all of its cuts should leave the same number of pieces. "
            @if bridged == 0 { "They do, in all " (runs) " cuts." }
            @else { (bridged) " of " (runs) " cuts left " b { "fewer pieces than another cut of the same stroke" } ": a bridge of tissue, where the opened area stays below the swept one." }
        }
        (table(&["mesh, stroke", "cuts", "pieces", "with fewer", "which", "opened / swept"], &rows))
    }
}

/// How many times the elements.
pub(crate) fn growth(study: &Study) -> Markup {
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
                (percent(1.0 - c.symmetric.core_share())) " of what is cut there, hybrid releases at once. Of the whole difference the pattern makes "
                (format!("{:.2}", c.symmetric.end().growth - c.minimal.end().growth)) " (progressive with minimal patterns grows to " (g(c.minimal))
                "), the release " (format!("{:.2}", c.minimal.end().growth - c.hybrid_unsnapped.end().growth)) ", snapping, which waiting makes possible, "
                (format!("{:.2}", c.hybrid_unsnapped.end().growth - c.hybrid.end().growth)) ". The growth is set by how much of the mesh is cut: the finer "
                "the mesh, the smaller."
            }
        }
        p { "That hybrid minimal stays at " (PAPER_HYBRID) " or below wherever symmetric makes " (low) " to " (high) ": "
            @let cases: Vec<_> = all.iter().filter(|c| c.is_the_papers_case()).collect();
            (cases.iter().filter(|c| c.agrees()).count()) " of " (cases.len()) " cuts." }
        (table(&["mesh, stroke", "cut", "progressive symmetric", "hybrid minimal", "... no snapping", "hybrid mixture", "... no snapping", "paper's case"], &rows))
    }
}

/// What hybrid avoids.
pub(crate) fn operations(study: &Study) -> Markup {
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
        @if same.iter().any(|a| a.deleted() < 0.0) {
            p {
                "Where deletions avoided are negative, hybrid deletes more than progressive: with symmetric patterns progressive mostly moves points that it has, "
                "and a method that waits makes its children from scratch."
            }
        }
        details open { summary { "Against symmetric progressive subdivision without snapping" } (table(&header, &symmetric.iter().map(row).collect::<Vec<_>>())) }
        details { summary { "With the same patterns and snapping" } (table(&header, &same.iter().map(row).collect::<Vec<_>>())) }
    }
}

/// The mean edge ratio during the cut.
pub(crate) fn quality(study: &Study) -> Markup {
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
    let mut other: Vec<String> = plain.iter().filter(|q| !q.same_end()).map(|q| claims::place(study, q.runs[0])).collect();
    other.dedup();
    html! {
        p {
            "Paper: progressive's mean edge ratio has local minima while tetrahedra are half cut. Here it has in " (dips) " of " (all.len()) " cuts: "
            (verdict(2 * dips > all.len())) ". The deepest of them is shallower with hybrid in " (less) " and deeper in " (deeper) ": " (verdict(less > deeper))
            ". Over the cut its mean edge ratio is above progressive's in " (above) " of " (all.len()) "."
        }
        p {
            "At the end, with snapping, the order is non-progressive, hybrid, progressive in " (ordered) " of " (snapped.len()) " cuts: what is released at once is not snapped. Without snapping "
            "the three methods end in the same mesh to the bit in " (same) " of " (plain.len()) " cuts (" (uniform_same) " of " (uniform)
            " with one pattern for hull and core), and there the final quality is a matter of the pattern alone."
            @if !other.is_empty() { " Not so: " (other.join("; ")) "." }
        }
        details {
            summary { "All cuts. Dip: depth of the deepest local minimum, below what was before and after it; in brackets the number of local minima" }
            (table(&["mesh, stroke", "hull/core, snapping", "progressive end", "non-progr. end", "hybrid end", "progressive dip", "hybrid dip", "hybrid - progressive", "same mesh"],
                &all.iter().map(row).collect::<Vec<_>>()))
        }
    }
}

/// The sweep of the threshold.
pub(crate) fn snapping(study: &Study) -> Markup {
    let all = thresholds::thresholds(study);
    let judged = || JUDGED.iter().chain(&JUDGED_CORE);
    let rows: Vec<Vec<Markup>> = all
        .iter()
        .map(|t| std::iter::once(cell(t.snap)).chain(judged().map(|(_, of, _)| cell(format!("{:.3}", of(t))))).collect())
        .collect();
    let header: Vec<&str> = std::iter::once("T").chain(judged().map(|(name, _, _)| *name)).collect();
    let alone: Vec<_> = JUDGED.into_iter().filter(|(_, _, more)| *more).collect();
    let unchanged: Vec<&str> =
        judged().filter(|(_, of, _)| all.iter().all(|t| (of(t) - 1.0).abs() < 1e-3)).map(|(name, _, _)| *name).collect();
    html! {
        p {
            "Hybrid, minimal patterns, at the end of the cut; geometric mean over all meshes and strokes, relative to no snapping. Of growth less is better, of all else more. "
            "A node snaps only before any of its crossings is released, and hybrid releases those of the hull at once: what snapping does to shape shows most in what was core."
        }
        (table(&header, &rows))
        @if !unchanged.is_empty() { p { "No threshold changes by a thousandth: " (unchanged.join(", ")) "." } }
        ul {
            @for (name, of, more) in judged().filter(|(name, _, _)| !unchanged.contains(name)) {
                @if let Some(best) = thresholds::best_by(&all, *of, *more) { li { "best by " (name) ": T = " (best) } }
            }
        }
        @if let (Some(best), Some(shape), Some(core)) = (thresholds::best(&all, &JUDGED), thresholds::best(&all, &alone), thresholds::best(&all, &JUDGED_CORE)) {
            p {
                "Best by the first five together, with equal weights (geometric mean of the gains): " b { "T = " (best) } "; without growth T = " (shape)
                "; by the shape of what was core T = " (core) ". The default is " (keyhole_whiteboard::CutSettings::default().snap) "."
            }
        }
    }
}
