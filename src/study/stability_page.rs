//! What the models survived, as tables, pictures of the worst and one page.

use crate::study::contender::Contender;
use crate::study::markup::{cell, frame, table};
use crate::study::solid_picture::{Still, draw};
use crate::study::stability::{BACK, Ordeal, Stability};
use crate::study::{StudyError, write};
use maud::{Markup, html};
use std::path::Path;

/// Pictures on the page.
const PICTURES: usize = 9;

fn outcome(o: &Ordeal) -> String {
    if let Some(t) = o.broke_s {
        return format!("not finite after {t:.3} s");
    }
    let energy = if o.survived { String::new() } else { format!("energy {:.1e} times too large", o.energy) };
    let place = match (o.off, o.back_s) {
        (Some(_), Some(t)) => format!("back in {t:.2} s"),
        (Some(off), None) => format!("{:.0} % of the length off", off * 100.0),
        (None, _) => "survived".into(),
    };
    let stopped = if o.simulated_s < 0.99 * o.hardship.seconds() { format!(", stopped at {:.2} s", o.simulated_s) } else { String::new() };
    format!("{}{stopped}", if energy.is_empty() { place } else { energy })
}

/// How bad: not finite, too much energy, not back.
fn badness(o: &Ordeal) -> f64 {
    match (o.broke_s, o.survived) {
        (Some(_), _) => f64::INFINITY,
        (None, false) => 1e6 * o.energy.min(1e6),
        _ => o.off.filter(|off| *off > BACK).unwrap_or(0.0),
    }
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
    let title = |o: &Ordeal| format!("{}, {}: {}", o.hardship.name(), o.contender.name(), outcome(o));
    let stills: Vec<Still> = worst.iter().take(PICTURES).map(|o| Still { title: title(o), mesh: &o.end.0, positions: &o.end.1 }).collect();
    let caption = "The worst ends: what is not finite is not drawn, red faces look inwards. Each is as large as its panel.";
    let picture = draw("worst.svg", caption, &stills)?;
    write(&folder.join(&picture.name), &picture.svg)?;
    write(&folder.join("index.html"), &page(study, caption))
}

fn page(study: &Stability, caption: &str) -> String {
    let body = html! {
        p {
            "A beam of 60 x 30 x 30 mm in 270 tetrahedra, clamped at one end, E 10 kPa, nu 0.45, 1050 kg/m3, drag 6 1/s, ticks of 1/60 s where nothing else is said. Nothing puts a broken state back here. "
            "Without gravity it is let go stretched by a third and bent, or as the row says, and is to come back to its rest shape: \u{201c}back\u{201d} is within "
            (format!("{:.0} %", BACK * 100.0)) " of its length for good."
        }
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

fn ordeals(study: &Stability) -> Markup {
    let mut contenders: Vec<Contender> = Vec::new();
    let mut hardships: Vec<String> = Vec::new();
    for o in &study.ordeals {
        if !contenders.contains(&o.contender) {
            contenders.push(o.contender);
        }
        if !hardships.contains(&o.hardship.name()) {
            hardships.push(o.hardship.name());
        }
    }
    let mut header: Vec<String> = vec!["hardship".into()];
    header.extend(contenders.iter().map(|c| format!("{} {}", c.name(), c.setting())));
    let find = |h: &str, c: &Contender| study.ordeals.iter().find(|o| o.hardship.name() == h && o.contender == *c);
    let mark = |o: &Ordeal| html! { span class=(if badness(o) > 0.0 { "no" } else { "yes" }) { (outcome(o)) } };
    let mut rows: Vec<Vec<Markup>> = hardships
        .iter()
        .map(|h| {
            let mut row = vec![cell(h)];
            row.extend(contenders.iter().map(|c| find(h, c).map_or(cell("not possible"), mark)));
            row
        })
        .collect();
    let mut sums = vec![cell("survived, and back where it should")];
    sums.extend(contenders.iter().map(|c| {
        let own: Vec<&Ordeal> = study.ordeals.iter().filter(|o| o.contender == *c).collect();
        let survived = own.iter().filter(|o| o.survived).count();
        cell(format!("{survived}, {} of {}", own.iter().filter(|o| badness(o) <= 0.0).count(), own.len()))
    }));
    rows.push(sums);
    table(&header.iter().map(String::as_str).collect::<Vec<_>>(), &rows)
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
