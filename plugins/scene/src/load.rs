//! Reading scenes.

use crate::error::SceneError;
use crate::format::{Scene, VERSION};
use ron::error::{Error as RonError, SpannedError};
use ron::extensions::Extensions;
use std::path::Path;

/// Reads a scene. The paths in it come back joined to the folder of the file, ready to be opened.
///
/// Only the form is checked here; [`crate::check()`] looks at the values and the assets.
///
/// # Errors
/// [`SceneError::Read`], or [`SceneError::Syntax`] with line and column.
pub fn load(path: &Path) -> Result<Scene, SceneError> {
    let text = std::fs::read_to_string(path).map_err(|source| SceneError::Read { path: path.into(), source })?;
    let mut scene = parse(&text).map_err(|e| SceneError::Syntax {
        path: path.into(),
        line: e.span.start.line,
        column: e.span.start.col,
        what: explain(&e.code),
    })?;
    if scene.version != VERSION {
        let what = version_problem(scene.version);
        return Err(SceneError::Syntax { path: path.into(), line: 1, column: 1, what });
    }
    let folder = path.parent().unwrap_or(Path::new(""));
    let join = |p: &mut String| *p = folder.join(p.as_str()).to_string_lossy().into_owned();
    scene.organs.iter_mut().filter_map(|o| o.mesh.as_mut()).for_each(join);
    scene.anatomy.iter_mut().filter_map(|a| a.path.as_mut()).for_each(join);
    Ok(scene)
}

/// Parses the text of a scene; paths stay as written.
///
/// # Errors
/// The first thing that RON or the format refuses, with its place.
pub fn parse(text: &str) -> Result<Scene, SpannedError> {
    ron::Options::default().with_default_extension(Extensions::IMPLICIT_SOME).from_str(text)
}

pub(crate) fn version_problem(found: u32) -> String {
    format!("version {found} of the format: this program reads version {VERSION}; write `version: {VERSION}` and go through the check")
}

/// A parse error in the words of this program, with the nearest name that is known.
pub(crate) fn explain(error: &RonError) -> String {
    match error {
        RonError::NoSuchStructField { expected, found, outer } => {
            let place = outer.as_deref().map(|o| format!(" in {o}")).unwrap_or_default();
            format!("unknown field `{found}`{place}: {}", instead(found, expected, "fields"))
        }
        RonError::NoSuchEnumVariant { expected, found, .. } => {
            format!("unknown value `{found}`: {}", instead(found, expected, "values"))
        }
        RonError::MissingStructField { field, outer } => {
            let place = outer.as_deref().map(|o| format!(" of {o}")).unwrap_or_default();
            format!("the field `{field}`{place} is missing: add it before this closing bracket")
        }
        RonError::DuplicateStructField { field, .. } => format!("the field `{field}` is given twice: keep one"),
        other => format!("{other}: correct the text here"),
    }
}

fn instead(found: &str, known: &[&str], what: &str) -> String {
    let nearest = known.iter().map(|k| (distance(found, k), *k)).min();
    match nearest {
        Some((d, name)) if 2 * d <= found.len().max(name.len()) => format!("did you mean `{name}`?"),
        _ => format!("known {what} are {}", known.join(", ")),
    }
}

/// Edit distance (Levenshtein 1966) over characters.
fn distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, cb) in b.iter().enumerate() {
            let next = (diagonal + usize::from(ca != *cb)).min(row[j] + 1).min(row[j + 1] + 1);
            diagonal = row[j + 1];
            row[j + 1] = next;
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edit_distances() {
        for (a, b, d) in [("", "", 0), ("kitten", "sitting", 3), ("mesh", "", 4), ("young_modulus", "young_modulus_pa", 3), ("ab", "ba", 2)]
        {
            assert_eq!((distance(a, b), distance(b, a)), (d, d), "{a} {b}");
        }
    }
}
