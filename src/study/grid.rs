//! A grid of panels with lines.

use crate::study::StudyError;
use crate::study::svg::{COLOURS, Canvas, Drawing, Drawn, FONT, extent, number, svg};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// Size of a panel, pixels.
const PANEL: (u32, u32) = (430, 260);
/// Height of title and legend, pixels.
const HEAD: u32 = 80;
/// A line of a panel.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Line {
    pub colour: usize,
    pub dashed: bool,
    pub points: Vec<(f64, f64)>,
}

/// A grid of panels that share their axes.
pub(crate) struct Grid<'a> {
    pub name: String,
    pub title: String,
    pub x: &'a str,
    pub columns: Vec<String>,
    /// Name and axis of each row.
    pub rows: Vec<Row>,
    pub legend: Vec<(String, usize, bool)>,
    pub panels: Vec<Vec<Vec<Line>>>,
}

pub(crate) struct Row {
    pub name: String,
    pub axis: &'static str,
    pub log: bool,
}

/// Draws a grid.
pub(crate) fn draw(grid: &Grid) -> Result<Drawing, StudyError> {
    let size = (PANEL.0 * grid.columns.len().max(1) as u32, HEAD + PANEL.1 * grid.rows.len() as u32);
    let text = svg(&grid.name, size, |canvas| {
        let (head, body) = canvas.split_vertically(HEAD);
        draw_head(&head, grid)?;
        let panels = body.split_evenly((grid.rows.len(), grid.columns.len()));
        // Panels with the same kind of axis share their range, so that they can be compared: all of them, but in the sweep each row has its own.
        let alike =
            |row: usize| (0..grid.rows.len()).filter(move |r| grid.rows[*r].axis == grid.rows[row].axis && grid.x != "T" || *r == row);
        for (row, of_row) in grid.panels.iter().enumerate() {
            let every = || alike(row).flat_map(|r| grid.panels[r].iter().flatten()).flat_map(|l| l.points.iter().copied());
            for (column, lines) in of_row.iter().enumerate() {
                let panel = &panels[row * grid.columns.len() + column];
                let title = format!("{}: {}", grid.columns[column], grid.rows[row].name);
                draw_panel(panel, &title, grid.x, &grid.rows[row], every(), lines)?;
            }
        }
        Ok(())
    })?;
    Ok(Drawing { name: grid.name.clone(), caption: grid.title.clone(), svg: text })
}

fn draw_head(head: &Canvas, grid: &Grid) -> Drawn {
    head.draw(&Text::new(grid.title.clone(), (12, 10), (FONT, 20).into_font()))?;
    let mut x = 14;
    let centre = Pos::new(HPos::Left, VPos::Center);
    for (name, colour, dashed) in &grid.legend {
        let colour = COLOURS.get(*colour).copied().unwrap_or(BLACK);
        let style = colour.stroke_width(2);
        let dashes: &[(i32, i32)] = if *dashed { &[(0, 7), (12, 19), (24, 30)] } else { &[(0, 30)] };
        for (from, to) in dashes {
            head.draw(&PathElement::new(vec![(x + from, 55), (x + to, 55)], style))?;
        }
        head.draw(&Text::new(name.clone(), (x + 36, 55), (FONT, 15).into_font().into_text_style(head).pos(centre)))?;
        x += 56 + 8 * name.chars().count() as i32;
    }
    Ok(())
}

/// The least and the greatest value with a little room; a decade's part on a logarithmic axis.
fn range(values: impl Iterator<Item = f64>, log: bool) -> (f64, f64) {
    let Some((low, high)) = extent(values, log) else { return (if log { 0.1 } else { 0.0 }, 1.0) };
    if log {
        return (low / 1.15, high * 1.15);
    }
    let room = if high > low { 0.05 * (high - low) } else { 0.05 * high.abs() + f64::MIN_POSITIVE };
    // An axis that begins near zero begins at zero.
    (if low >= 0.0 && low < 0.4 * high { 0.0 } else { low - room }, high + room)
}

fn draw_panel(area: &Canvas, title: &str, x: &str, row: &Row, every: impl Iterator<Item = (f64, f64)>, lines: &[Line]) -> Drawn {
    let (xs, ys): (Vec<f64>, Vec<f64>) = every.unzip();
    let (_, right) = range(xs.into_iter(), false);
    // A logarithmic axis is for ranges of more than a decade and a half; within less it has no ticks to read.
    let (low, high) = range(ys.iter().copied(), true);
    let log = row.log && high > 30.0 * low;
    let (low, high) = range(ys.into_iter(), log);
    let mut builder = ChartBuilder::on(area);
    builder.caption(title, (FONT, 14)).margin(8).margin_right(16).x_label_area_size(36).y_label_area_size(56);
    // One is generic over its axes: the two kinds are two types.
    macro_rules! plot {
        ($range:expr) => {{
            let mut chart = builder.build_cartesian_2d(0.0..right.min(1.02), $range)?;
            chart
                .configure_mesh()
                .x_desc(x)
                .y_desc(row.axis)
                .x_labels(6)
                .y_labels(7)
                .y_label_formatter(&|v| number(*v))
                .light_line_style(TRANSPARENT)
                .label_style((FONT, 12))
                .draw()?;
            for line in lines {
                let style = COLOURS[line.colour % COLOURS.len()].stroke_width(2);
                let points = line.points.iter().copied().filter(|(_, y)| !log || *y > 0.0);
                if line.dashed {
                    chart.draw_series(DashedLineSeries::new(points, 6, 4, style))?;
                } else {
                    chart.draw_series(LineSeries::new(points, style))?;
                }
            }
        }};
    }
    if log {
        plot!((low..high).log_scale());
    } else {
        plot!(low..high);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_hold_their_values() {
        assert_eq!(range([0.1, 2.0].into_iter(), false), (0.0, 2.0 + 0.05 * 1.9));
        let (low, high) = range([3.0, 4.0].into_iter(), false);
        assert!(low > 2.9 && low < 3.0 && high > 4.0);
        let (low, high) = range([0.0, 0.01, 10.0].into_iter(), true);
        assert!(low > 0.0 && low < 0.01 && high > 10.0);
        assert_eq!(range(std::iter::empty(), true), (0.1, 1.0));
        assert!({
            let (a, b) = range([5.0].into_iter(), false);
            a < 5.0 && b > 5.0
        });
    }
}
