//! What the models survived, as tables, pictures of the worst and one page.

use crate::study::contender::Contender;
use crate::study::markup::{cell, frame, percent, table};
use crate::study::solid_picture::{Still, draw};
use crate::study::stability::{BACK, Ordeal, Stability};
use crate::study::{StudyError, write};
use maud::{Markup, html};
use std::path::Path;

/// Pictures on the page.
const PICTURES: usize = 9;

/// Whether it survived, in words.
fn survival(o: &Ordeal) -> String {
    match o.broke_s {
        Some(t) => format!("not finite after {t:.3} s"),
        None if !o.finished => format!("too slow: {:.2} s of {} in {:.0} s", o.simulated_s, o.hardship.seconds(), o.wall_s),
        None if o.survived => "survived".into(),
        None => format!("energy {:.1e} of what it may be", o.energy),
    }
}

/// Whether it came back, and when, in words; nothing where it is not to.
fn recovery(o: &Ordeal) -> Option<String> {
    let off = o.off?;
    Some(match o.back_s {
        Some(t) => format!("back in {t:.2} s"),
        None if off.is_finite() => format!("{} of its length off", percent(off)),
        None => "not back".into(),
    })
}

/// How bad: not finite, too much energy, not back. What was too slow to tell is not among the worst.
fn badness(o: &Ordeal) -> f64 {
    match o.broke_s {
        Some(_) => f64::INFINITY,
        None if o.energy > 1.0 => 1e6 * o.energy.min(1e6),
        None if !o.finished => 0.0,
        None => o.off.filter(|off| *off > BACK).unwrap_or(0.0),
    }
}

/// Whether all is well: survived, and back where it should be.
fn is_well(o: &Ordeal) -> bool {
    o.survived && o.off.is_none_or(|off| off <= BACK)
}

/// Writes `stability.csv`, `step_limits.csv`, `worst.svg` and `index.html` into a folder.
///
/// # Errors
/// The first file that cannot be written.
pub fn write_all(study: &Stability, folder: &Path) -> Result<(), StudyError> {
    let path = folder.join("stability.csv");
    let named = |source| StudyError::Table { path: path.clone(), source };
    let mut writer = csv::Writer::from_path(&path).map_err(named)?;
    writer
        .write_record([
            "hardship",
            "model",
            "setting",
            "survived",
            "finished",
            "energy",
            "off_part_of_length",
            "back_s",
            "broke_s",
            "simulated_s",
            "wall_s",
        ])
        .map_err(named)?;
    for o in &study.ordeals {
        let text = |x: Option<f64>| x.map(|x| format!("{x:.4e}")).unwrap_or_default();
        let record = [
            o.hardship.name(),
            o.contender.name().into(),
            o.contender.setting(),
            o.survived.to_string(),
            o.finished.to_string(),
            format!("{:.4e}", o.energy),
            text(o.off),
            text(o.back_s.map(f64::from)),
            text(o.broke_s.map(f64::from)),
            format!("{:.4}", o.simulated_s),
            format!("{:.3}", o.wall_s),
        ];
        writer.write_record(record).map_err(named)?;
    }
    writer.flush().map_err(|e| named(e.into()))?;
    let path = folder.join("step_limits.csv");
    let named = |source| StudyError::Table { path: path.clone(), source };
    let mut writer = csv::Writer::from_path(&path).map_err(named)?;
    writer.write_record(["mesh", "predicted_us", "continuum_us", "measured_us"]).map_err(named)?;
    for l in &study.limits {
        let us = |s: f64| format!("{:.3}", s * 1e6);
        writer.write_record([l.name.clone(), us(l.predicted_s), us(l.continuum_s), us(l.measured_s)]).map_err(named)?;
    }
    writer.flush().map_err(|e| named(e.into()))?;

    let mut worst: Vec<&Ordeal> = study.ordeals.iter().filter(|o| badness(o) > 0.0 && o.end.1.iter().any(|p| p.is_finite())).collect();
    worst.sort_by(|a, b| badness(b).total_cmp(&badness(a)));
    let title = |o: &Ordeal| {
        let fate = if o.survived { recovery(o).unwrap_or_default() } else { survival(o) };
        [format!("{}, {}", o.hardship.name(), o.contender.name()), fate]
    };
    let stills: Vec<Still> = worst.iter().take(PICTURES).map(|o| Still { title: title(o), mesh: &o.end.0, positions: &o.end.1 }).collect();
    let caption = "The worst ends, one of each model and hardship: what is not finite is not drawn, red faces are inside out. Each is as large as its panel.";
    let picture = draw("worst.svg", caption, &stills)?;
    write(&folder.join(&picture.name), &picture.svg)?;
    write(&folder.join("index.html"), &page(study, caption))
}

fn page(study: &Stability, caption: &str) -> String {
    let body = html! {
        p {
            "A beam of 60 x 30 x 30 mm in 270 tetrahedra, clamped at one end, E 10 kPa, nu 0.45, 1050 kg/m3, drag 6 1/s, ticks of 1/60 s where nothing else is said. Without gravity it is let go stretched by a third and bent, or as the row says, and is to come back "
            "to its rest shape."
        }
        p {
            strong { "Survived" } ": every number stayed finite, with nothing here that puts a broken state back, and kinetic and elastic energy at the end are no more than one and a half times what there was, what a tool did and what the weight gave. "
            strong { "Back" } ": no node further from its rest place than " (percent(BACK)) " of the length, for good, and since when. A dash: under gravity, or too slow a swing for the time, there is no rest shape to come back to."
        }
        (verdicts(study))
        (ordeals(study))
        h2 { "The worst" }
        figure { img src="worst.svg" alt=(caption); figcaption { (caption) } }
        h2 { "The explicit model's largest step" }
        (limits(study))
        h2 { "Tables" }
        p { a href="stability.csv" { "stability.csv" } ", " a href="step_limits.csv" { "step_limits.csv" } "." }
    };
    frame("Soft tissue: what it survives", &body)
}

/// The models in the order in which they were run.
fn contenders(study: &Stability) -> Vec<Contender> {
    let mut contenders: Vec<Contender> = Vec::new();
    for o in &study.ordeals {
        if !contenders.contains(&o.contender) {
            contenders.push(o.contender);
        }
    }
    contenders
}

/// Each model in a sentence: how much it survived, and every failure by name.
fn verdicts(study: &Stability) -> Markup {
    let of = |c: &Contender| study.ordeals.iter().filter(|o| o.contender == *c).collect::<Vec<_>>();
    let failures = |c: &Contender| {
        let named = |o: &&Ordeal| {
            let fate = if o.survived { recovery(o).unwrap_or_default() } else { survival(o) };
            format!("{} ({fate})", o.hardship.name())
        };
        of(c).iter().filter(|o| !is_well(o)).map(named).collect::<Vec<_>>().join("; ")
    };
    html! {
        ul {
            @for c in contenders(study) {
                li {
                    strong { (c.full_name()) @if c == Contender::default_of_the_simulator() { ", the simulator's default" } } ": survived "
                    (of(&c).iter().filter(|o| o.survived).count()) " of " (of(&c).len()) ", back " (of(&c).iter().filter(|o| o.back_s.is_some()).count()) " of "
                    (of(&c).iter().filter(|o| o.off.is_some()).count()) ". "
                    @if failures(&c).is_empty() { span.yes { "Nothing failed." } } @else { span.no { "Failed: " } (failures(&c)) "." }
                }
            }
        }
    }
}

fn ordeals(study: &Stability) -> Markup {
    let contenders = contenders(study);
    let mut hardships: Vec<String> = Vec::new();
    for o in &study.ordeals {
        if !hardships.contains(&o.hardship.name()) {
            hardships.push(o.hardship.name());
        }
    }
    let mut header: Vec<String> = vec!["hardship".into()];
    header.extend(contenders.iter().flat_map(|c| [c.full_name(), "back".into()]));
    let find = |h: &str, c: &Contender| study.ordeals.iter().find(|o| o.hardship.name() == h && o.contender == *c);
    let coloured = |good: bool, text: String| html! { span class=(if good { "yes" } else { "no" }) { (text) } };
    let both = |o: &Ordeal| {
        let back = recovery(o).map_or(cell("\u{2013}"), |text| coloured(o.back_s.is_some(), text.trim_start_matches("back in ").into()));
        [coloured(o.survived, survival(o)), back]
    };
    let row = |h: &String| {
        let mut row = vec![cell(h)];
        row.extend(contenders.iter().flat_map(|c| find(h, c).map_or([cell("not possible"), cell("")], both)));
        row
    };
    let rows: Vec<Vec<Markup>> = hardships.iter().map(row).collect();
    html! { div.wide { (table(&header.iter().map(String::as_str).collect::<Vec<_>>(), &rows)) } }
}

fn limits(study: &Stability) -> Markup {
    let rows: Vec<Vec<Markup>> = study
        .limits
        .iter()
        .map(|l| {
            let us = |s: f64| cell(format!("{:.1}", s * 1e6));
            let off = l.measured_s / l.predicted_s - 1.0;
            let kind = if off.abs() <= 0.2 { "yes" } else { "no" };
            vec![
                cell(&l.name),
                us(l.predicted_s),
                us(l.measured_s),
                html! { span class=(kind) { (format!("{:+.1} %", off * 100.0)) } },
                us(l.continuum_s),
            ]
        })
        .collect();
    html! {
        (table(&["mesh", "predicted, microseconds", "measured", "difference", "continuum on the same mesh"], &rows))
        p { "Predicted: 2 / omega_max of the model's own springs and volumes. Continuum: the same of linear elasticity with the same lumped masses." }
    }
}
