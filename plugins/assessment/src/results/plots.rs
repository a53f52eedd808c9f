//! Drawings of results as the text of SVG.

use crate::metrics::Margin;
use crate::results::record::MarginSummary;
use bevy_math::DVec3;
use plotters::coord::Shift;
use plotters::prelude::*;

/// What cannot be drawn, and why.
#[derive(Debug, thiserror::Error)]
#[error("{what} cannot be drawn: {why}")]
pub struct PlotError {
    /// The drawing.
    pub what: String,
    /// What the library says.
    pub why: String,
}

/// Okabe and Ito's colours, which all readers can tell apart.
const COLOURS: [RGBColor; 4] = [RGBColor(0, 114, 178), RGBColor(213, 94, 0), RGBColor(0, 158, 115), RGBColor(204, 121, 167)];

/// The margin from which on the colour is the last one, mm.
const WIDE_MM: f64 = 10.0;

type Canvas<'a> = DrawingArea<SVGBackend<'a>, Shift>;

fn svg(what: &str, size: (u32, u32), draw: impl FnOnce(&Canvas) -> Result<(), Box<dyn std::error::Error>>) -> Result<String, PlotError> {
    let mut text = String::new();
    let drawn = (|| {
        let canvas = SVGBackend::with_string(&mut text, size).into_drawing_area();
        canvas.fill(&WHITE)?;
        draw(&canvas)?;
        canvas.present()?;
        Ok(())
    })();
    drawn.map_err(|e: Box<dyn std::error::Error>| PlotError { what: what.into(), why: e.to_string() })?;
    Ok(text)
}

/// The colour of a margin: black where the cut goes through tumour, then from orange through white at half of 10 mm to blue.
#[must_use]
pub fn margin_colour(margin_m: f64) -> [f32; 3] {
    if margin_m <= 0.0 {
        return [0.0; 3];
    }
    let t = (margin_m * 1e3 / WIDE_MM).clamp(0.0, 1.0);
    let mix = |a: [f64; 3], b: [f64; 3], t: f64| [0, 1, 2].map(|i| (a[i] + (b[i] - a[i]) * t) as f32);
    let (near, middle, far) = ([0.835, 0.369, 0.0], [0.97, 0.97, 0.97], [0.0, 0.447, 0.698]);
    if t < 0.5 { mix(near, middle, 2.0 * t) } else { mix(middle, far, 2.0 * t - 1.0) }
}

/// How much of the cut surface has which margin.
///
/// # Errors
/// What the drawing library says.
pub fn histogram(summary: &MarginSummary) -> Result<String, PlotError> {
    let width = summary.class_mm;
    let end = (summary.classes.len().max(1) as f64) * width;
    let most = summary.classes.iter().copied().fold(0.0, f64::max).max(0.01) * 100.0;
    svg("the margin's distribution", (760, 300), |canvas| {
        let mut chart = ChartBuilder::on(canvas)
            .margin(12)
            .x_label_area_size(38)
            .y_label_area_size(52)
            .build_cartesian_2d(0.0..end, 0.0..most * 1.08)?;
        chart.configure_mesh().x_desc("margin / mm").y_desc("part of the cut surface / %").disable_x_mesh().draw()?;
        chart.draw_series(summary.classes.iter().enumerate().map(|(i, part)| {
            let from = i as f64 * width;
            let [r, g, b] = margin_colour((from + width / 2.0) * 1e-3).map(|c| (c * 255.0) as u8);
            Rectangle::new([(from, 0.0), (from + width, part * 100.0)], RGBColor(r, g, b).filled())
        }))?;
        chart.draw_series(summary.classes.iter().enumerate().map(|(i, part)| {
            let from = i as f64 * width;
            Rectangle::new([(from, 0.0), (from + width, part * 100.0)], BLACK.mix(0.5))
        }))?;
        Ok(())
    })
}

/// The cut surface seen from where most of it faces, each triangle in the colour of its margin.
///
/// # Errors
/// What the drawing library says.
pub fn cut_surface(margin: &Margin) -> Result<String, PlotError> {
    let place = |i: u32| margin.vertices[i as usize].place;
    let area = |[a, b, c]: [u32; 3]| (place(b) - place(a)).cross(place(c) - place(a));
    let toward = margin.triangles.iter().map(|t| area(*t)).sum::<DVec3>().try_normalize().unwrap_or(DVec3::Z);
    let across = toward.any_orthonormal_vector();
    let up = toward.cross(across);
    let flat = |i: u32| (place(i).dot(across) * 1e3, place(i).dot(up) * 1e3);
    let mut order: Vec<(f64, [u32; 3])> =
        margin.triangles.iter().map(|t| (t.iter().map(|i| place(*i).dot(toward)).sum::<f64>(), *t)).collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    let range = |of: fn((f64, f64)) -> f64| {
        let (low, high) = (0..margin.vertices.len() as u32)
            .map(|i| of(flat(i)))
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        ((low + high) / 2.0, high - low)
    };
    let ((x, width), (y, height)) = (range(|p| p.0), range(|p| p.1));
    let half = width.max(height).max(1e-6) * 0.53;
    svg("the cut surface", (520, 520), |canvas| {
        let mut chart = ChartBuilder::on(canvas)
            .margin(12)
            .x_label_area_size(38)
            .y_label_area_size(52)
            .build_cartesian_2d(x - half..x + half, y - half..y + half)?;
        chart.configure_mesh().x_desc("mm").y_desc("mm").disable_mesh().draw()?;
        chart.draw_series(order.iter().map(|(_, t)| {
            let mean = t.iter().map(|i| margin.vertices[*i as usize].margin_m).sum::<f64>() / 3.0;
            let [r, g, b] = margin_colour(mean).map(|c| (c * 255.0) as u8);
            Polygon::new(t.map(flat).to_vec(), RGBColor(r, g, b).filled())
        }))?;
        Ok(())
    })
}

/// A line a series over the sessions, numbered from 1. `level` is a dashed line across.
///
/// # Errors
/// What the drawing library says.
pub fn curve(title: &str, unit: &str, series: &[(&str, Vec<(f64, f64)>)], level: Option<(&str, f64)>) -> Result<String, PlotError> {
    let points = || series.iter().flat_map(|(_, p)| p.iter().copied()).filter(|p| p.1.is_finite());
    let last = points().map(|p| p.0).fold(2.0, f64::max);
    let values = || points().map(|p| p.1).chain(level.map(|l| l.1));
    let (low, high) = values().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    let (low, high) = if low.is_finite() { (low.min(0.0), high.max(0.0)) } else { (0.0, 1.0) };
    let room = ((high - low) * 0.06).max(1e-9);
    let from = if low < 0.0 { low - room } else { 0.0 };
    svg(title, (480, 260), |canvas| {
        let mut chart = ChartBuilder::on(canvas)
            .margin(12)
            .x_label_area_size(36)
            .y_label_area_size(62)
            .build_cartesian_2d(0.8..last + 0.2, from..high + room)?;
        let whole = |v: &f64| if (v - v.round()).abs() < 1e-6 { format!("{v:.0}") } else { String::new() };
        chart.configure_mesh().x_desc("session").y_desc(unit).x_labels(last as usize + 1).x_label_formatter(&whole).draw()?;
        for ((name, points), colour) in series.iter().zip(COLOURS) {
            let line = LineSeries::new(points.iter().copied(), colour.stroke_width(2));
            chart.draw_series(line)?.label(*name).legend(move |(x, y)| PathElement::new([(x, y), (x + 14, y)], colour.stroke_width(2)));
            chart.draw_series(points.iter().map(|p| Circle::new(*p, 3, colour.filled())))?;
        }
        if let Some((name, value)) = level {
            let dashes = DashedLineSeries::new([(0.8, value), (last + 0.2, value)], 6, 4, BLACK.stroke_width(1));
            chart.draw_series(dashes)?.label(name).legend(|(x, y)| PathElement::new([(x, y), (x + 14, y)], BLACK));
        }
        if series.len() > 1 || level.is_some() {
            chart.configure_series_labels().background_style(WHITE.mix(0.8)).border_style(BLACK.mix(0.3)).draw()?;
        }
        Ok(())
    })
}
