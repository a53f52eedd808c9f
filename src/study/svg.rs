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
