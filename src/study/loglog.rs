//! A plot of curves on two logarithmic axes, each with the power law through it.

use crate::study::StudyError;
use crate::study::scaling::Law;
use crate::study::svg::{COLOURS, Drawing, FONT, extent, number, svg};
use plotters::prelude::*;

/// Width and height, pixels.
const SIZE: (u32, u32) = (1000, 560);
/// Width of the legend, pixels.
const LEGEND: i32 = 330;

/// Draws curves; those without a law are left out.
///
/// # Errors
/// What the drawing library says.
pub(crate) fn draw(name: &str, title: &str, y: &str, laws: &[&Law]) -> Result<Drawing, StudyError> {
    let drawn: Vec<_> = laws.iter().filter_map(|law| Some((*law, law.law?))).collect();
    let points = || drawn.iter().flat_map(|(law, _)| law.points.iter().copied());
    let axis = |values: &mut dyn Iterator<Item = f64>| extent(values, true).map_or((0.1, 1.0), |(low, high)| (low / 1.3, high * 1.3));
    let (xs, ys) = (axis(&mut points().map(|p| p.0)), axis(&mut points().map(|p| p.1)));
    let x = drawn.first().map_or("", |(law, _)| law.against);
    let text = svg(name, SIZE, |canvas| {
        let mut chart = ChartBuilder::on(canvas)
            .caption(title, (FONT, 18))
            .margin(14)
            .margin_right(LEGEND)
            .x_label_area_size(44)
            .y_label_area_size(76)
            .build_cartesian_2d((xs.0..xs.1).log_scale(), (ys.0..ys.1).log_scale())?;
        chart
            .configure_mesh()
            .x_desc(x)
            .y_desc(y)
            .x_label_formatter(&|v| number(*v))
            .y_label_formatter(&|v| number(*v))
            .light_line_style(TRANSPARENT)
            .label_style((FONT, 13))
            .draw()?;
        for (i, (law, fit)) in drawn.iter().enumerate() {
            let colour = COLOURS[i % COLOURS.len()];
            let shown = || law.points.iter().copied().filter(|p| p.1 > 0.0);
            chart.draw_series(shown().map(|at| Circle::new(at, 4, colour.filled())))?;
            chart.draw_series(LineSeries::new(shown(), colour.stroke_width(2)))?;
            let ends = [xs.0 * 1.3, xs.1 / 1.3].map(|x| (x, fit.at(x)));
            chart.draw_series(DashedLineSeries::new(ends, 6, 4, colour.stroke_width(1)))?;
            let (left, top) = (SIZE.0 as i32 - LEGEND + 20, 60 + 24 * i as i32);
            canvas.draw(&Circle::new((left, top + 7), 5, colour.filled()))?;
            let of = law.what.split(" / ").next().unwrap_or_default();
            canvas.draw(&Text::new(format!("{of}: {}", exponent(fit.exponent, fit.error)), (left + 12, top), (FONT, 14).into_font()))?;
        }
        Ok(())
    })?;
    Ok(Drawing { name: name.into(), caption: format!("{title}. Dashed: the power laws."), svg: text })
}

/// An exponent with its standard error.
pub(crate) fn exponent(exponent: f64, error: Option<f64>) -> String {
    match error {
        Some(error) => format!("{exponent:.2} \u{b1} {error:.2}"),
        None => format!("{exponent:.2}"),
    }
}
