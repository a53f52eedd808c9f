//! What the pages are made of.

use crate::study::plan::pattern_name;
use crate::study::run::Run;
use maud::{DOCTYPE, Markup, PreEscaped, html};

const STYLE: &str = "body{font:16px/1.45 system-ui,sans-serif;max-width:1100px;margin:2em auto;padding:0 1em;color:#222}\
table{border-collapse:collapse;margin:1em 0;font-size:14px;font-variant-numeric:tabular-nums}\
td,th{border:1px solid #ccc;padding:.25em .6em;text-align:right}td:first-child,th:first-child{text-align:left}th{background:#f3f3f3}\
img{width:100%;border:1px solid #ddd}figure{margin:1.5em 0}figcaption{font-size:14px;color:#444}\
.yes{color:#06703f;font-weight:600}.no{color:#a33000;font-weight:600}.wide{overflow-x:auto}details{margin:1em 0}summary{cursor:pointer}";

/// A page of the study.
pub(crate) fn frame(title: &str, body: &Markup) -> String {
    html! {
        (DOCTYPE)
        html lang="en" {
            head { meta charset="utf-8"; title { (title) } style { (PreEscaped(STYLE)) } }
            body { h1 { (title) } (body) }
        }
    }
    .into_string()
}

/// In words and colour.
pub(crate) fn verdict(agrees: bool) -> Markup {
    html! { @if agrees { span.yes { "agrees" } } @else { span.no { "does not agree" } } }
}

/// A part as per cent.
pub(crate) fn percent(part: f64) -> String {
    format!("{:.0} %", part * 100.0)
}

/// A run's patterns and snapping.
pub(crate) fn settings(run: &Run) -> String {
    let c = run.combination;
    let pattern = c.pattern;
    format!(
        "{}/{}, {}",
        pattern_name(pattern.hull),
        pattern_name(pattern.core),
        if c.snap > 0.0 { format!("T = {}", c.snap) } else { "no snapping".into() }
    )
}

/// A table.
pub(crate) fn table(header: &[&str], rows: &[Vec<Markup>]) -> Markup {
    html! {
        table {
            tr { @for h in header { th { (h) } } }
            @for row in rows { tr { @for cell in row { td { (cell) } } } }
        }
    }
}

/// The content of a cell.
pub(crate) fn cell(text: impl std::fmt::Display) -> Markup {
    let text = text.to_string();
    html! { (text) }
}
