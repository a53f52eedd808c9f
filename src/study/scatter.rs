//! A plot of points on two logarithmic axes with a line through some of them.

use crate::study::StudyError;
use crate::study::svg::{COLOURS, Drawing, FONT, extent, number, svg};
use plotters::prelude::*;

const SIZE: (u32, u32) = (1000, 620);
/// A point.
pub(crate) struct Dot {
    pub at: (f64, f64),
    pub colour: usize,
    pub label: String,
    /// Whether it is to stand out: with a ring around it.
    pub ringed: bool,
}

/// A plot.
pub(crate) struct Scatter<'a> {
    pub name: String,
    pub title: String,
    pub x: &'a str,
    pub y: &'a str,
    pub legend: Vec<String>,
    /// What a ring says.
    pub ring: &'a str,
    pub dots: Vec<Dot>,
    pub line: Vec<(f64, f64)>,
}

/// Full decades around some values.
fn decades(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let Some((low, high)) = extent(values, true) else { return (0.1, 1.0) };
    let (low, high) = (low.log10().floor(), (high * 1.02).log10().ceil());
    (10_f64.powf(low), 10_f64.powf(high.max(low + 1.0)))
}

/// Draws it.
pub(crate) fn draw(plot: &Scatter) -> Result<Drawing, StudyError> {
    let text = svg(&plot.name, SIZE, |canvas| {
        let (x, y) = (decades(plot.dots.iter().map(|d| d.at.0)), decades(plot.dots.iter().map(|d| d.at.1)));
        let mut chart = ChartBuilder::on(canvas)
            .caption(&plot.title, (FONT, 18))
            .margin(14)
            .margin_right(170)
            .x_label_area_size(44)
            .y_label_area_size(76)
            .build_cartesian_2d((x.0..x.1).log_scale(), (y.0..y.1).log_scale())?;
        chart
            .configure_mesh()
            .x_desc(plot.x)
            .y_desc(plot.y)
            .x_label_formatter(&|v| number(*v))
            .y_label_formatter(&|v| format!("{} %", number(*v * 100.0)))
            .label_style((FONT, 13))
            .draw()?;
        chart.draw_series(LineSeries::new(plot.line.iter().copied(), RGBColor(120, 120, 120).stroke_width(2)))?;
        for dot in &plot.dots {
            let colour = COLOURS[dot.colour % COLOURS.len()];
            let mark = EmptyElement::at(dot.at)
                + Circle::new((0, 0), 5, colour.filled())
                + Text::new(dot.label.clone(), (7, -14), (FONT, 12).into_font().color(&colour));
            chart.draw_series(std::iter::once(mark))?;
            if dot.ringed {
                let ring = EmptyElement::at(dot.at) + Circle::new((0, 0), 10, BLACK.stroke_width(2));
                chart.draw_series(std::iter::once(ring))?;
            }
        }
        let (left, top) = (SIZE.0 as i32 - 160, 60 + 22 * plot.legend.len() as i32 + 8);
        canvas.draw(&Circle::new((left, top + 7), 8, BLACK.stroke_width(2)))?;
        canvas.draw(&Text::new(plot.ring.to_owned(), (left + 12, top), (FONT, 14).into_font()))?;
        for (i, name) in plot.legend.iter().enumerate() {
            let (left, top) = (SIZE.0 as i32 - 160, 60 + 22 * i as i32);
            canvas.draw(&Circle::new((left, top + 7), 5, COLOURS[i % COLOURS.len()].filled()))?;
            canvas.draw(&Text::new(name.clone(), (left + 12, top), (FONT, 14).into_font()))?;
        }
        Ok(())
    })?;
    Ok(Drawing { name: plot.name.clone(), caption: plot.title.clone(), svg: text })
}
