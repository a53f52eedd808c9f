//! The checker: every problem of a scene with its line, and what to do about it.

use crate::load::{explain, parse};
use crate::locate::Places;
use crate::rules;
use ron::error::Error as RonError;
use std::fmt;
use std::path::{Path, PathBuf};

/// A problem of a scene.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// The scene's file.
    pub file: PathBuf,
    /// Line, from 1.
    pub line: usize,
    /// Column, from 1, in characters.
    pub column: usize,
    /// What is wrong, what was expected, what to do.
    pub message: String,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}:{}: {}", self.file.display(), self.line, self.column, self.message)
    }
}

/// Every problem of the scene at `path`, in order of place; none for a scene that plays. The meshes it names are read.
#[must_use]
pub fn check(path: &Path) -> Vec<Problem> {
    match std::fs::read_to_string(path) {
        Ok(text) => check_text(path, &text),
        Err(e) => {
            let message = format!("cannot be read: {e}: give the path of a scene (.scene.ron)");
            vec![Problem { file: path.into(), line: 1, column: 1, message }]
        }
    }
}

/// As [`check`], for a text that would be at `path`.
#[must_use]
pub fn check_text(path: &Path, text: &str) -> Vec<Problem> {
    let problem = |(line, column), message| Problem { file: path.into(), line, column, message };
    let mut problems = Vec::new();
    // An unknown field ends RON's reading. It is blanked out, which moves nothing else, and the text is read again for the next one.
    let mut rest = text.to_owned();
    let scene = loop {
        let error = match parse(&rest) {
            Ok(scene) => break Some(scene),
            Err(error) => error,
        };
        let place = (error.span.start.line, error.span.start.col);
        let unknown = match &error.code {
            RonError::NoSuchStructField { found, .. } => {
                let places = Places::of(&rest);
                places.field_near(found, place.0, place.1).map(|f| (places.line_column(f.span.start), f.span.clone()))
            }
            _ => None,
        };
        problems.push(problem(unknown.as_ref().map_or(place, |u| u.0), explain(&error.code)));
        let Some((_, span)) = unknown else { break None };
        let blank: String = rest[span.clone()].chars().map(|c| if c == '\n' { "\n".into() } else { " ".repeat(c.len_utf8()) }).collect();
        rest.replace_range(span, &blank);
    };
    if let Some(scene) = scene {
        let places = Places::of(text);
        let found = rules::problems(&scene, path.parent().unwrap_or(Path::new("")));
        problems.extend(found.into_iter().map(|(at, message)| problem(places.value(&at), message)));
    }
    problems.sort_by_key(|p| (p.line, p.column));
    problems
}
