//! Drawings as the text of SVG files.

use crate::study::StudyError;
use plotters::coord::Shift;
use plotters::prelude::*;

/// What is drawn on.
pub type Canvas<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// What the drawing library may say.
pub type Drawn = Result<(), Box<dyn std::error::Error>>;

/// A file of the study that is looked at.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Drawing {
    /// Its name in the folder.
    pub name: String,
    /// What stands below it.
    pub caption: String,
    /// Its text.
    pub svg: String,
}

/// Okabe and Ito's colours, which all readers can tell apart; black last.
pub const COLOURS: [RGBColor; 7] = [
    RGBColor(213, 94, 0),
    RGBColor(0, 114, 178),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(0, 0, 0),
];

/// Three digits, no more than are needed.
#[must_use]
pub fn number(v: f64) -> String {
    if v == 0.0 {
        return "0".into();
    }
    let digits = (2 - v.abs().log10().floor() as i32).clamp(0, 6) as usize;
    let text = format!("{v:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').into() } else { text }
}

/// The least and the greatest of the values that an axis can show: finite, and above zero on a logarithmic one.
#[must_use]
pub fn extent(values: impl Iterator<Item = f64>, log: bool) -> Option<(f64, f64)> {
    let fit = values.filter(|v| v.is_finite() && (!log || *v > 0.0));
    fit.fold(None, |range: Option<(f64, f64)>, v| Some(range.map_or((v, v), |(a, b)| (a.min(v), b.max(v)))))
}

/// Font of all text; the reader's own sans-serif is used.
pub const FONT: &str = "sans-serif";

/// Draws on white and gives the file's text.
///
/// # Errors
/// What the drawing library says.
pub fn svg(name: &str, size: (u32, u32), draw: impl FnOnce(&Canvas) -> Drawn) -> Result<String, StudyError> {
    let mut text = String::new();
    let result = (|| {
        let canvas = SVGBackend::with_string(&mut text, size).into_drawing_area();
        canvas.fill(&WHITE)?;
        draw(&canvas)?;
        canvas.present()?;
        Ok(())
    })();
    result.map_err(|e: Box<dyn std::error::Error>| StudyError::Draw { name: name.into(), reason: e.to_string() })?;
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short() {
        assert_eq!([0.0, 1.0, 0.25, 1234.5, 0.001234, -2.5].map(number), ["0", "1", "0.25", "1234", "0.00123", "-2.5"]);
    }

    #[test]
    fn an_extent_is_of_what_can_be_shown() {
        assert_eq!(extent([3.0, f64::NAN, -1.0, f64::INFINITY].into_iter(), false), Some((-1.0, 3.0)));
        assert_eq!(extent([3.0, 0.0, -1.0].into_iter(), true), Some((3.0, 3.0)));
        assert_eq!(extent([0.0].into_iter(), true), None);
    }
}
