//! The results of a session as one page.

use crate::metrics::table::{Better, Scope};
use crate::metrics::{Margin, MetricId};
use crate::results::document::{date, figure, frame, number};
use crate::results::plots::{PlotError, cut_surface, histogram};
use crate::results::record::Results;
use keyhole_whiteboard::Hand;
use maud::{Markup, html};

/// The page. With the margin the surface that was cut is drawn on it.
///
/// # Errors
/// When a plot cannot be drawn.
pub fn page(results: &Results, margin: Option<&Margin>) -> Result<String, PlotError> {
    let distribution = results.margin.as_ref().map(histogram).transpose()?;
    let surface = margin.map(cut_surface).transpose()?;
    let body = html! {
        p {
            @if !results.trainee.is_empty() { (results.trainee) ", " }
            (date(results.ended_unix_s)) ", Keyhole " (results.program) "."
        }
        @if let Some(task) = &results.task { (task.markup()) }
        h2 { "Hands" }
        (hands(results))
        @for (title, scope) in [("Session", Scope::Session), ("Endoscope", Scope::Camera), ("Resection", Scope::Resection)] {
            @if results.figures.iter().any(|m| m.metric.metric().scope == scope) {
                h2 { (title) }
                (figures(results, scope))
            }
        }
        @if let Some(svg) = distribution {
            (figure(&svg, "How much of the surface that was cut is how far from the tumour."))
        }
        @if let Some(svg) = surface {
            (figure(&svg, "The surface that was cut, on what came free, seen from where most of it faces: black where the cut goes through tumour, orange near it, white 5 mm, blue 10 mm and more away."))
        }
        h2 { "What the figures mean" }
        (definitions())
    };
    Ok(frame(&results.scene, &body))
}

fn hands(results: &Results) -> Markup {
    let of_hands = MetricId::ALL.into_iter().filter(|m| m.metric().scope == Scope::Hand);
    let cell = |metric, hand| results.value(metric, Some(hand)).map_or_else(|| "–".to_owned(), number);
    html! {
        table {
            tr { th { "" } th { "unit" } th { "left" } th { "right" } }
            @for metric in of_hands {
                tr { td { (metric.metric().name) } td { (metric.metric().unit) } td { (cell(metric, Hand::Left)) } td { (cell(metric, Hand::Right)) } }
            }
        }
    }
}

fn figures(results: &Results, scope: Scope) -> Markup {
    html! {
        table {
            @for m in results.figures.iter().filter(|m| m.metric.metric().scope == scope) {
                tr { td { (m.metric.metric().name) } td { (number(m.value)) } td.text { (m.metric.metric().unit) } }
            }
        }
    }
}

/// The table of all metrics.
#[must_use]
pub fn definitions() -> Markup {
    let better = |b: Better| match b {
        Better::Less => "less",
        Better::More => "more",
        Better::Neither => "",
    };
    html! {
        table {
            tr { th { "metric" } th { "unit" } th { "better" } th { "definition" } th { "source" } }
            @for metric in MetricId::ALL.into_iter().map(MetricId::metric) {
                tr {
                    td { (metric.name) } td { (metric.unit) } td { (better(metric.better)) } td.text { (metric.definition) } td.text { (metric.source) }
                }
            }
        }
    }
}
