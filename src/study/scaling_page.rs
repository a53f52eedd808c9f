//! What ticks and memory grow with, and what each module costs: tables, plots and one page.

use crate::modules::Module;
use crate::study::loglog::{draw, exponent};
use crate::study::markup::{cell, frame, table};
use crate::study::scaling::{Law, Run, STAGES, Scaling};
use crate::study::scaling_case::{Measured, ModuleUse};
use crate::study::svg::{Drawing, number};
use crate::study::{StudyError, write};
use maud::{Markup, html};
use std::path::Path;

/// Writes `scaling.csv`, `modules.csv`, `exponents.csv`, `scaling.json`, the plots and `index.html` into a folder.
///
/// # Errors
/// The first file that cannot be written.
pub fn write_all(study: &Scaling, folder: &Path) -> Result<(), StudyError> {
    let laws = study.laws();
    cases(study, &folder.join("scaling.csv"))?;
    modules(study, &folder.join("modules.csv"))?;
    exponents(&laws, &folder.join("exponents.csv"))?;
    let path = folder.join("scaling.json");
    let json = serde_json::to_string_pretty(&serde_json::json!({ "runs": study.runs, "laws": laws }));
    write(&path, &(json.map_err(|e| StudyError::File { path: path.clone(), source: e.into() })? + "\n"))?;
    let plots = plots(&laws)?;
    for plot in &plots {
        write(&folder.join(&plot.name), &plot.svg)?;
    }
    write(&folder.join("index.html"), &page(study, &laws, &plots))
}

fn rows(path: &Path, header: &[&str], rows: impl Iterator<Item = Vec<String>>) -> Result<(), StudyError> {
    let named = |source| StudyError::Table { path: path.into(), source };
    let mut writer = csv::Writer::from_path(path).map_err(named)?;
    writer.write_record(header).map_err(named)?;
    for row in rows {
        writer.write_record(row).map_err(named)?;
    }
    writer.flush().map_err(|e| named(e.into()))
}

/// One row a case.
fn cases(study: &Scaling, path: &Path) -> Result<(), StudyError> {
    let stages: Vec<String> = study.nothing().map(|m| m.stage_ms.iter().map(|(name, _)| name.clone()).collect()).unwrap_or_default();
    let mut header = vec!["case", "organs", "tets", "tets_after", "start_s", "ticks", "tick_mean_ms", "tick_p50_ms", "tick_p99_ms"];
    let columns: Vec<String> = stages.iter().map(|s| format!("{}_mean_ms", s.to_lowercase())).collect();
    header.extend(columns.iter().map(String::as_str));
    header.extend(["peak_bytes", "solver_bytes", "stepped", "asleep", "iterations", "looked_at", "contacts"]);
    let row = |Run { case, measured: m }: &Run| {
        let mut row =
            vec![case.in_words(), m.organs.to_string(), m.tets.to_string(), m.tets_after.to_string(), format!("{:.4}", m.start_s)];
        row.push(m.ticks.to_string());
        row.extend([m.tick_ms.mean, m.tick_ms.p50, m.tick_ms.p99].map(|ms| format!("{ms:.5}")));
        row.extend(stages.iter().map(|s| format!("{:.5}", m.stage(s).mean)));
        row.push(m.peak_bytes.map_or_else(String::new, |b| b.to_string()));
        row.push(m.solver_bytes.to_string());
        row.extend([m.stepped, m.asleep, m.iterations, m.looked_at, m.contacts].map(|v| format!("{v:.3}")));
        row
    };
    rows(path, &header, study.runs.iter().map(row))
}

/// One row for each module that a case requires.
fn modules(study: &Scaling, path: &Path) -> Result<(), StudyError> {
    let header = ["case", "module", "mean_ms", "system_runs_a_tick", "entities", "bytes_on_entities", "resource_bytes"];
    let row = |run: &Run, u: &ModuleUse| {
        vec![
            run.case.in_words(),
            u.module.name().into(),
            format!("{:.5}", u.ms),
            format!("{:.3}", u.runs as f64 / run.measured.ticks as f64),
            u.entities.to_string(),
            u.bytes.to_string(),
            u.resource_bytes.to_string(),
        ]
    };
    let required = study.runs.iter().flat_map(|run| run.measured.modules.iter().filter(|u| u.required).map(move |u| (run, u)));
    rows(path, &header, required.map(|(run, u)| row(run, u)))
}

fn exponents(laws: &[Law], path: &Path) -> Result<(), StudyError> {
    let row = |law: &Law| {
        let fit = law.law?;
        let error = fit.error.map_or_else(String::new, |e| format!("{e:.4}"));
        let end = law.at_the_end.map_or_else(String::new, |e| format!("{e:.4}"));
        Some(vec![law.what.clone(), law.against.into(), format!("{:.4}", fit.exponent), error, end, law.points.len().to_string()])
    };
    rows(path, &["what", "against", "exponent", "standard_error", "between_the_largest_two", "points"], laws.iter().filter_map(row))
}

fn plots(laws: &[Law]) -> Result<Vec<Drawing>, StudyError> {
    let of = |against: &str, wanted: &dyn Fn(&str) -> bool| -> Vec<&Law> {
        laws.iter().filter(|l| l.against == against && wanted(&l.what)).collect()
    };
    let ms = |what: &str| what.ends_with("/ ms");
    let mb = |what: &str| what.ends_with("/ MB");
    Ok(vec![
        draw("tick.svg", "Cost of a tick against the size of a mesh", "ms", &of("tetrahedra", &ms))?,
        draw("memory.svg", "Memory against the size of a mesh", "MB", &of("tetrahedra", &mb))?,
        draw("organs.svg", "Cost of a tick against the number of organs, all awake", "ms", &of("organs awake", &ms))?,
        draw("asleep.svg", "Cost of a tick against the number of organs, all asleep", "ms", &of("organs asleep", &ms))?,
    ])
}

fn page(study: &Scaling, laws: &[Law], plots: &[Drawing]) -> String {
    let plot = |name: &str| {
        let found = plots.iter().find(|p| p.name == name);
        html! { @if let Some(d) = found { figure { img src=(d.name) alt=(d.caption); figcaption { (d.caption) } } } }
    };
    let body = html! {
        p {
            "Each case in a process of its own, one after another; of several runs of a case the fastest counts. Wall-clock figures are of this machine; numbers of tetrahedra, iterations, runs and bytes on entities are the same everywhere. "
            "Memory is the most that a process has had resident, less that of the program without a scene"
            @match study.nothing().and_then(|m| m.peak_bytes) {
                Some(bytes) => { " (" (mb(bytes as f64)) " MB, with every module there and none required)." }
                None => { "; this system does not tell it (there is no VmHWM in /proc/self/status), so it is left out." }
            }
        }
        h2 { "Against the size of the mesh" }
        p { "A block of 60 mm held at one side; a grasper presses it twice a second, a scalpel cuts a slit into it. The same second and a half of it at every size." }
        (sizes(study))
        (laws_of(laws, "tetrahedra"))
        (plot("tick.svg"))
        (plot("memory.svg"))
        h2 { "Against the number of organs" }
        p { "Blocks of 40 mm, each held at one side. Awake they swing under their weight; without weight they fall asleep, and are then neither solved nor looked at." }
        (organs(study))
        (laws_of(laws, "organs awake"))
        (laws_of(laws, "organs asleep"))
        (plot("organs.svg"))
        (plot("asleep.svg"))
        h2 { "Scenes" }
        (scenes(study))
        h2 { "Modules" }
        p { "Mean cost of the stages of a tick that are a module's own, ms. A dash: the scene does not ask for the module." }
        (modules_of_scenes(study))
        (idle(study))
        h2 { "One module more, or less" }
        (toggled(study))
        h2 { "Tables" }
        p {
            a href="scaling.csv" { "scaling.csv" } " (a row a case), " a href="modules.csv" { "modules.csv" } " (a row for each module that a case requires), "
            a href="exponents.csv" { "exponents.csv" } ", " a href="scaling.json" { "scaling.json" } " (all of it)."
        }
    };
    frame("What a tick costs, and what it grows with", &body)
}

fn mb(bytes: f64) -> String {
    number(bytes / 1e6)
}

fn memory(study: &Scaling, m: &Measured) -> Markup {
    cell(study.memory(m).map_or_else(|| "\u{2013}".into(), mb))
}

/// Mean and 99th percentile of the whole tick, then the mean of some stages.
fn ticks(m: &Measured, stages: &[&str]) -> Vec<Markup> {
    let mut row = vec![cell(m.ticks), cell(number(m.tick_ms.mean)), cell(number(m.tick_ms.p99))];
    row.extend(stages.iter().map(|stage| cell(number(m.stage(stage).mean))));
    row
}

const TICKS: [&str; 3] = ["ticks", "tick, mean / ms", "p99"];

fn sizes(study: &Scaling) -> Markup {
    let row = |m: &Measured| {
        let mut row = vec![cell(m.tets)];
        row.extend(ticks(m, &STAGES));
        row.push(memory(study, m));
        row.push(cell(study.memory(m).map_or_else(|| "\u{2013}".into(), |b| number(b / m.tets as f64))));
        row.push(cell(number(m.solver_bytes as f64 / m.tets as f64)));
        row.extend([cell(number(m.iterations)), cell(number(m.looked_at)), cell(number(m.start_s))]);
        row
    };
    let mut header = vec!["tetrahedra"];
    header.extend(TICKS.iter().chain(&STAGES).copied());
    header.extend([
        "memory / MB",
        "bytes a tet",
        "of these the solver's",
        "iterations a tick",
        "looked at by collision a tick",
        "start / s",
    ]);
    let rows: Vec<Vec<Markup>> = study.blocks().map(row).collect();
    html! { div.wide { (table(&header, &rows)) } }
}

fn laws_of(laws: &[Law], against: &str) -> Markup {
    let row = |law: &Law| {
        let fit = law.law?;
        let end = law.at_the_end.map_or_else(|| "\u{2013}".into(), |e| format!("{e:.2}"));
        Some(vec![cell(&law.what), cell(exponent(fit.exponent, fit.error)), cell(end)])
    };
    let rows: Vec<Vec<Markup>> = laws.iter().filter(|l| l.against == against).filter_map(row).collect();
    let head = format!("grows as ({against}) to the power of");
    html! {
        (table(&["", &head, "between the largest two"], &rows))
        p { "Least squares of the logarithms; \u{b1} the standard error of the exponent. Between the largest two what does not depend on the size weighs least." }
    }
}

fn organs(study: &Scaling) -> Markup {
    let row = |state: &str, m: &Measured| {
        let mut row = vec![cell(format!("{}, {state}", m.organs)), cell(m.tets)];
        row.extend(ticks(m, &["Collide", "Tissue"]));
        row.extend([cell(number(m.stepped)), cell(number(m.asleep)), cell(number(m.iterations)), cell(number(m.looked_at))]);
        row.push(memory(study, m));
        row
    };
    let rows: Vec<Vec<Markup>> = study.organs(false).map(|m| row("awake", m)).chain(study.organs(true).map(|m| row("asleep", m))).collect();
    let mut header = vec!["organs", "tetrahedra"];
    header.extend(TICKS);
    header.extend(["Collide", "Tissue", "solved a tick", "asleep a tick", "iterations a tick", "looked at a tick", "memory / MB"]);
    html! { div.wide { (table(&header, &rows)) } }
}

fn scenes(study: &Scaling) -> Markup {
    let stages: Vec<&str> = study.nothing().map(|m| m.stage_ms.iter().map(|(name, _)| name.as_str()).collect()).unwrap_or_default();
    let row = |run: &Run| {
        let m = &run.measured;
        let mut row = vec![cell(&m.name), cell(m.tets), cell(m.tets_after)];
        row.extend(ticks(m, &stages));
        row.extend([memory(study, m), cell(number(m.start_s))]);
        row
    };
    let mut rows: Vec<Vec<Markup>> = study.scenes().map(row).collect();
    if let Some(nothing) = study.nothing() {
        let mut row = vec![cell("(nothing)"), cell(0), cell(0)];
        row.extend(ticks(nothing, &stages));
        row.extend([cell(0), cell(number(nothing.start_s))]);
        rows.push(row);
    }
    let mut header = vec!["scene", "tetrahedra", "at the end"];
    header.extend(TICKS.iter().chain(&stages).copied());
    header.extend(["memory / MB", "start / s"]);
    html! {
        div.wide { (table(&header, &rows)) }
        p { "The last row is what a tick costs in which no module is required: the engine asks each system's condition, and the clock of the stages runs." }
    }
}

fn modules_of_scenes(study: &Scaling) -> Markup {
    let scenes: Vec<&Measured> = study.scenes().map(|run| &run.measured).collect();
    let using = |m: &Measured, module: Module| m.modules.iter().find(|u| u.module == module && u.required).map(|u| number(u.ms));
    let row = |module: Module| {
        let cells = scenes.iter().map(|m| cell(using(m, module).unwrap_or_else(|| "\u{2013}".into())));
        std::iter::once(cell(module.name())).chain(cells).collect::<Vec<_>>()
    };
    let mut header = vec!["module"];
    header.extend(scenes.iter().map(|m| m.name.as_str()));
    let rows: Vec<Vec<Markup>> = Module::ALL.into_iter().map(row).collect();
    html! {
        div.wide { (table(&header, &rows)) }
        p {
            "Stages: Sense is instruments', Collide collision's with the clips that go with the tissue, Adopt and Tissue tissue's, Assess assessment's with the forces on the instruments; the gestures "
            "are timed each on its own."
        }
    }
}

/// What was paid for what nobody asked for.
fn idle(study: &Scaling) -> Markup {
    let idle: Vec<&ModuleUse> = study.runs.iter().flat_map(|r| &r.measured.modules).filter(|u| !u.required).collect();
    let sum = |of: fn(&ModuleUse) -> u64| idle.iter().map(|u| of(u)).sum::<u64>();
    let (runs, entities, bytes) = (sum(|u| u.runs), sum(|u| u.entities as u64), sum(|u| u.bytes as u64));
    let kind = if runs + entities + bytes == 0 { "yes" } else { "no" };
    let most = idle.iter().map(|u| u.resource_bytes).max().unwrap_or(0);
    html! {
        p {
            "What a scene pays for modules that it does not ask for, in all " (study.runs.len()) " cases together, which is " (idle.len()) " modules that were there and not required: "
            span class=(kind) { (runs) " runs of their systems, " (entities) " entities with anything of theirs, " (bytes) " bytes on them" }
            ". Their settings and empty lists are in the program whatever the scene is: at most " (most) " bytes a module."
        }
    }
}

fn toggled(study: &Scaling) -> Markup {
    let runs = study.toggled();
    let Some(plain) = runs.first() else { return html! {} };
    let change = |now: f64, was: f64| format!("{}{}", if now < was { "\u{2212}" } else { "+" }, number((now - was).abs()));
    let row = |run: &&Run| {
        let (m, was) = (&run.measured, &plain.measured);
        let what = match run.case.toggled {
            None => "as it is".to_owned(),
            Some(module) => {
                let required = m.modules.iter().any(|u| u.module == module && u.required);
                format!("{} {}", if required { "with" } else { "without" }, module.name())
            }
        };
        let peak = |m: &Measured| m.peak_bytes.map(|b| b as f64 / 1e6);
        let grown = peak(m).zip(peak(was)).map_or_else(|| "\u{2013}".into(), |(now, was)| change(now, was));
        let mut row = vec![cell(what), cell(m.ticks), cell(number(m.tick_ms.mean)), cell(change(m.tick_ms.mean, was.tick_ms.mean))];
        row.extend([cell(number(m.tick_ms.p99)), memory(study, m), cell(grown), cell(m.tets_after)]);
        row
    };
    let rows: Vec<Vec<Markup>> = runs.iter().map(row).collect();
    html! {
        p {
            (plain.measured.name) " as it is, then with each module that it asks for left out and each that it does not ask for required. What is left out is missed by others: without collision nothing "
            "falls onto anything, without instruments nothing is cut."
        }
        div.wide { (table(&["", "ticks", "tick, mean / ms", "change", "p99 / ms", "memory / MB", "change", "tetrahedra at the end"], &rows)) }
    }
}
