//! The path of a blade in a file: CSV with the header `t_s,tip_x,tip_y,tip_z,heel_x,heel_y,heel_z,active`, metres.

use keyhole_tetmesh::DVec3;
use std::path::{Path, PathBuf};

/// The header of a blade file.
pub const HEADER: [&str; 8] = ["t_s", "tip_x", "tip_y", "tip_z", "heel_x", "heel_y", "heel_z", "active"];

/// Where the blade is at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BladeSample {
    /// Time, s.
    pub t_s: f64,
    /// End of the cutting line towards the tissue, m.
    pub tip: DVec3,
    /// The other end, m.
    pub heel: DVec3,
    /// Whether it cuts.
    pub active: bool,
}

/// What is wrong with a blade file, and where.
#[derive(Debug, thiserror::Error)]
pub enum BladeError {
    /// It cannot be read.
    #[error("{path}: {source}; give a CSV file with the header {}", HEADER.join(","))]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: csv::Error,
    },
    /// The header is another.
    #[error("{path}: line 1: the header is `{found}`, expected `{}`", HEADER.join(","))]
    Header {
        /// The file.
        path: PathBuf,
        /// What is there.
        found: String,
    },
    /// A field is not a number, or not finite.
    #[error("{path}: line {line}: {column} is `{found}`, expected {expected}")]
    Field {
        /// The file.
        path: PathBuf,
        /// Line number, from 1.
        line: u64,
        /// Column name.
        column: &'static str,
        /// What is there.
        found: String,
        /// What should be.
        expected: &'static str,
    },
    /// Times that do not increase.
    #[error("{path}: line {line}: t_s does not increase; sort the samples by time")]
    Order {
        /// The file.
        path: PathBuf,
        /// Line number, from 1.
        line: u64,
    },
    /// Fewer than two samples.
    #[error("{path}: {found} samples, expected two at least: a blade cuts by moving")]
    TooShort {
        /// The file.
        path: PathBuf,
        /// How many.
        found: usize,
    },
}

/// Reads a blade file.
///
/// # Errors
/// The first thing that is wrong with it.
pub fn read_blade(path: &Path) -> Result<Vec<BladeSample>, BladeError> {
    let own = || path.to_path_buf();
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .comment(Some(b'#'))
        .from_path(path)
        .map_err(|source| BladeError::Read { path: own(), source })?;
    let header = reader.headers().map_err(|source| BladeError::Read { path: own(), source })?.clone();
    if header.iter().ne(HEADER) {
        return Err(BladeError::Header { path: own(), found: header.iter().collect::<Vec<_>>().join(",") });
    }
    let mut samples: Vec<BladeSample> = Vec::new();
    for record in reader.records() {
        let record = record.map_err(|source| BladeError::Read { path: own(), source })?;
        let line = record.position().map_or(0, csv::Position::line);
        let mut numbers = [0.0; 7];
        for (i, number) in numbers.iter_mut().enumerate() {
            let found = record.get(i).unwrap_or_default();
            *number = found.parse().ok().filter(|x: &f64| x.is_finite()).ok_or_else(|| BladeError::Field {
                path: own(),
                line,
                column: HEADER[i],
                found: found.into(),
                expected: "a finite number",
            })?;
        }
        let found = record.get(7).unwrap_or_default();
        let active = match found {
            "1" | "true" => true,
            "0" | "false" => false,
            _ => {
                let (path, found) = (own(), found.into());
                return Err(BladeError::Field { path, line, column: HEADER[7], found, expected: "1 or 0" });
            }
        };
        let [t_s, tx, ty, tz, hx, hy, hz] = numbers;
        if samples.last().is_some_and(|s| s.t_s >= t_s) {
            return Err(BladeError::Order { path: own(), line });
        }
        samples.push(BladeSample { t_s, tip: DVec3::new(tx, ty, tz), heel: DVec3::new(hx, hy, hz), active });
    }
    if samples.len() < 2 {
        return Err(BladeError::TooShort { path: own(), found: samples.len() });
    }
    Ok(samples)
}
