//! The trade between cost and error as a table, plots and one page.

use crate::study::contender::Contender;
use crate::study::filmed::Filmed;
use crate::study::markup::{cell, frame, table};
use crate::study::refinement::Refined;
use crate::study::scatter::{Dot, Scatter, draw};
use crate::study::specimen::Case;
use crate::study::svg::Drawing;
use crate::study::trade::{Trade, TradeRun};
use crate::study::{StudyError, write};
use maud::{Markup, html};
use std::path::Path;

/// Errors for which the page names the cheapest.
const ASKED: [f64; 3] = [0.1, 0.01, 0.001];
/// Errors at rest and on the way within which the default is sought: the first is below that of any mesh that is stepped in real time, the second below what an eye
/// sees of a swing.
pub const WANTED: (f64, f64) = (0.01, 0.05);
/// A cost that leaves half of one core to all else, s a simulated second.
const REAL_TIME: f64 = 0.5;

fn percent(part: f64) -> String {
    if part.is_finite() { format!("{:+.2} %", part * 100.0) } else { "fails".into() }
}

/// The row of a run in `trade.csv`.
fn row(trade: &Trade, run: &TradeRun) -> Vec<String> {
    let bench = &trade.benches[run.bench];
    let number = |x: f64| format!("{x:.6e}");
    vec![
        bench.case.name().into(),
        bench.tets.to_string(),
        run.contender.name().into(),
        run.contender.setting(),
        number(run.cost),
        number(run.answer),
        number(bench.reference),
        number(bench.truth),
        bench.is_closed.to_string(),
        number(run.error),
        number(run.total_error),
        number(run.shape_error),
        trade.front(run.bench).iter().any(|f| f.contender == run.contender).to_string(),
        run.way_error.map(number).unwrap_or_default(),
        run.swing_error.map(number).unwrap_or_default(),
    ]
}

const HEADER: [&str; 15] = [
    "case",
    "tets",
    "model",
    "setting",
    "cost_s_per_s",
    "answer",
    "reference_same_mesh",
    "truth",
    "truth_is_closed_form",
    "error",
    "total_error",
    "shape_error",
    "on_front",
    "way_error",
    "swing_error",
];

/// Writes `trade.csv`, a plot for each case and `index.html` into a folder.
///
/// # Errors
/// The first file that cannot be written.
pub fn write_all(trade: &Trade, refined: &[Refined], filmed: Option<&Filmed>, folder: &Path) -> Result<(), StudyError> {
    let path = folder.join("trade.csv");
    let named = |source| StudyError::Table { path: path.clone(), source };
    let mut writer = csv::Writer::from_path(&path).map_err(named)?;
    writer.write_record(HEADER).map_err(named)?;
    for run in &trade.runs {
        writer.write_record(row(trade, run)).map_err(named)?;
    }
    writer.flush().map_err(|e| named(e.into()))?;
    if let Some(filmed) = filmed {
        filmed.write(&folder.join("filmed.csv"))?;
    }
    let plots = plots(trade)?;
    for plot in &plots {
        write(&folder.join(&plot.name), &plot.svg)?;
    }
    write(&folder.join("index.html"), &page(trade, refined, filmed, &plots))
}

fn plots(trade: &Trade) -> Result<Vec<Drawing>, StudyError> {
    let mut names: Vec<String> = Vec::new();
    for run in &trade.runs {
        if !names.iter().any(|n| n == run.contender.name()) {
            names.push(run.contender.name().into());
        }
    }
    let colour = |run: &TradeRun| names.iter().position(|n| n == run.contender.name()).unwrap_or(0);
    let mut drawings = Vec::new();
    for (index, bench) in trade.benches.iter().enumerate() {
        // On a logarithmic axis nothing is zero: what f32 can tell is a millionth.
        let place = |run: &TradeRun| (run.cost, run.error.abs().max(1e-6));
        let own = trade.runs.iter().filter(|r| r.bench == index && r.error.is_finite());
        let dots = own
            .map(|r| Dot {
                at: place(r),
                colour: colour(r),
                label: r.contender.setting(),
                ringed: r.contender == Contender::default_of_the_simulator(),
            })
            .collect();
        let front: Vec<(f64, f64)> = trade.front(index).into_iter().map(place).collect();
        drawings.push(draw(&Scatter {
            name: format!("{}_{}.svg", bench.case.name(), bench.tets),
            title: format!("{}, {} tets: {}", bench.case.name(), bench.tets, bench.case.answer()),
            x: "seconds of one core for a simulated second",
            y: "error against the reference on the same mesh",
            legend: names.clone(),
            ring: "the default",
            dots,
            line: front,
        })?);
    }
    Ok(drawings)
}

fn page(trade: &Trade, refined: &[Refined], filmed: Option<&Filmed>, plots: &[Drawing]) -> String {
    let body = html! {
        p {
            "Every soft-tissue model of this program, with the settings between which one would choose, on bodies whose answer is known. Ticks of 1/60 s, one thread; "
            "wall time is sixty times the lower decile of the ticks, so another run gives other costs, and the same errors."
        }
        h2 { "Which to choose" }
        (choice(trade))
        h2 { "All that were compared" }
        (summary(trade))
        h2 { "Cost and error" }
        p { "The line joins what nothing else beats in both: the front. A ring is around the simulator's default. Numbers are substeps, with the tolerance of the implicit model and the sweeps of vertex block descent. Errors below a millionth are drawn there." }
        @for d in plots { figure { img src=(d.name) alt=(d.caption); figcaption { (d.caption) } } }
        h2 { "Meshes" }
        (meshes(trade))
        @if !refined.is_empty() { h2 { "The reference under refinement" } (refinement(refined)) }
        @if let Some(filmed) = filmed { h2 { "The filmed beam" } (filmed.markup()) }
        h2 { "Table" }
        p { a href="trade.csv" { "trade.csv" } ": every run, and whether it is on its mesh's front" @if filmed.is_some() { "; " a href="filmed.csv" { "filmed.csv" } ": the filmed beam" } "." }
        h2 { "Words" }
        dl {
            dt { "error" } dd { "the answer at rest against that of the reference on the same mesh (f64, Newton's method): what the model makes of it" }
            dt { "total error" } dd { "against the closed form, or the reference in ten-node elements on the finest mesh: with the mesh's own error" }
            dt { "shape" } dd { "root mean square distance of all nodes from the reference's, by that of theirs from rest" }
            dt { "way" } dd { "largest distance of the tip from the reference's in the quarter of a second after the load was dropped on the beam, without drag, as a part of its sag at rest" }
            dt { "swing" } dd { "time of the first turn of the beam after the load was dropped on it, without drag, against the reference's" }
        }
    };
    frame("Soft tissue: cost and error", &body)
}

fn choice(trade: &Trade) -> Markup {
    let own = Contender::default_of_the_simulator();
    let (error, way) = WANTED;
    let found = trade.cheapest(error, way);
    let rows: Vec<Vec<Markup>> = ASKED
        .iter()
        .map(|asked| {
            let best = trade.cheapest(*asked, f64::INFINITY);
            let cost = best.map_or(String::new(), |c| format!("{:.3}", trade.mean_cost(&c)));
            vec![cell(format!("{} %", asked * 100.0)), cell(best.map_or("none".into(), |c| c.full_name())), cell(cost)]
        })
        .collect();
    html! {
        p {
            "Within " (format!("{} %", error * 100.0)) " at rest on every mesh, and never further than " (format!("{} %", way * 100.0)) " of its sag from the reference's way when the load is dropped on the beam, the cheapest is "
            @match found {
                Some(c) => {
                    strong { (c.full_name()) } ", " (format!("{:.3}", trade.mean_cost(&c))) " s a simulated second in the mean. "
                    @if c == own { "It is the simulator's default." }
                    @else {
                        "The simulator's default is " (own.full_name()) ": " (format!("{:.3}", trade.mean_cost(&own))) " s, at most " (percent(trade.worst(&own))) " at rest, "
                        (percent(trade.worst_way(&own))) " on its way."
                    }
                }
                None => { strong { "none of these" } "." }
            }
        }
        p { "Within an error at rest everywhere, whatever the motion:" }
        (table(&["error at most", "the cheapest", "mean cost, s a s"], &rows))
    }
}

fn summary(trade: &Trade) -> Markup {
    let mut contenders = trade.contenders();
    contenders.sort_by(|a, b| trade.mean_cost(a).total_cmp(&trade.mean_cost(b)));
    let rows: Vec<Vec<Markup>> = contenders
        .iter()
        .map(|c| {
            let mut row = vec![
                cell(c.full_name()),
                cell(format!("{:.3}", trade.mean_cost(c))),
                cell(if trade.mean_cost(c) < REAL_TIME { "yes" } else { "no" }),
            ];
            for (i, _) in trade.benches.iter().enumerate() {
                let run = trade.runs.iter().find(|r| r.bench == i && r.contender == *c);
                row.push(cell(run.map_or("too slow".into(), |r| percent(r.error))));
            }
            row.push(cell(percent(trade.worst_way(c))));
            row
        })
        .collect();
    let mut header: Vec<String> = vec!["model".into(), "mean cost, s a s".into(), format!("below {REAL_TIME}")];
    header.extend(trade.benches.iter().map(|b| format!("{} {}", b.case.name(), b.tets)));
    header.push("way, worst".into());
    table(&header.iter().map(String::as_str).collect::<Vec<_>>(), &rows)
}

fn meshes(trade: &Trade) -> Markup {
    let rows: Vec<Vec<Markup>> = trade
        .benches
        .iter()
        .map(|b| {
            let base = if b.case == Case::Uniaxial { 1.0 } else { 0.0 };
            let own = (b.reference - base) / (b.truth - base) - 1.0;
            let kind = if b.is_closed { "closed form" } else { "ten-node elements" };
            vec![
                cell(b.case.name()),
                cell(b.tets),
                cell(b.case.answer()),
                cell(format!("{:.4}", b.reference)),
                cell(format!("{:.4}, {kind}", b.truth)),
                cell(percent(own)),
            ]
        })
        .collect();
    table(&["case", "tets", "answer", "reference", "truth", "error of the mesh"], &rows)
}

fn refinement(refined: &[Refined]) -> Markup {
    let row = |r: &Refined| {
        let closed = |i: usize| {
            r.closed.get(i).map_or(cell("\u{2013}"), |(name, x)| cell(format!("{:+.2} % of {name}", (r.answer / x - 1.0) * 100.0)))
        };
        vec![cell(r.what), cell(r.elements.name()), cell(r.tets), cell(format!("{:.4}", r.answer)), closed(0), closed(1)]
    };
    html! {
        p {
            "All models but the explicit one share linear elements and the reference's equilibrium on a mesh; this is what the mesh itself is worth."
        }
        (table(&["what", "elements", "tets", "displacement of the end, mm", "closed form", "closed form with shear"], &refined.iter().map(row).collect::<Vec<_>>()))
    }
}
