//! Films of the silicone beam: 100 x 30 x 30 mm, clamped at one face and released from straight, followed by motion capture at 100 Hz (Dubied et al. 2022,
//! arXiv:2201.12560; converted to tables of seconds and metres).

use bevy_math::DVec3;
use keyhole_tissue::reference::ReferenceError;
use std::path::{Path, PathBuf};

/// The loads at the end edge beside gravity, N, and their files.
pub const LOADS: [(f64, [&str; 2]); 3] = [
    (0.0, ["gravity_a.csv", "gravity_b.csv"]),
    (0.510, ["load_0.510N_a.csv", "load_0.510N_b.csv"]),
    (1.001, ["load_1.001N_a.csv", "load_1.001N_b.csv"]),
];

/// Why the films cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum FilmError {
    /// A file that is not there or is not a table.
    #[error("{}: {reason}; expected the columns time_s and m0_x_m to m5_z_m with a row for each 0.01 s", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// The reference.
    #[error("the filmed beam: {0}")]
    Reference(#[from] ReferenceError),
}

/// What one film shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Take {
    /// Mean over the three markers of the way from release to the mean of the last second, mm.
    pub sag_mm: f64,
    /// Period of the first mode, s.
    pub period_s: f64,
    /// Its damping ratio.
    pub damping: f64,
}

/// Both takes of one load.
#[derive(Clone, Debug, PartialEq)]
pub struct Shown {
    /// The load beside gravity, N.
    pub load_n: f64,
    /// The takes.
    pub takes: Vec<Take>,
}

impl Shown {
    /// Mean of a figure over the takes.
    #[must_use]
    pub fn mean(&self, of: impl Fn(&Take) -> f64) -> f64 {
        self.takes.iter().map(of).sum::<f64>() / self.takes.len().max(1) as f64
    }
}

/// Reads all films of a folder.
///
/// # Errors
/// As [`read`].
pub fn read_all(folder: &Path) -> Result<Vec<Shown>, FilmError> {
    let both = |(load_n, files): (f64, [&str; 2])| {
        Ok(Shown { load_n, takes: files.iter().map(|f| read(&folder.join(f))).collect::<Result<_, _>>()? })
    };
    LOADS.into_iter().map(both).collect()
}

/// Reads a film.
///
/// # Errors
/// When it is not there, or is not a table of numbers.
pub fn read(path: &Path) -> Result<Take, FilmError> {
    let fails = |reason: String| FilmError::File { path: path.into(), reason };
    let mut reader = csv::Reader::from_path(path).map_err(|e| fails(e.to_string()))?;
    let mut rows: Vec<Vec<f64>> = Vec::new();
    for record in reader.records() {
        let record = record.map_err(|e| fails(e.to_string()))?;
        let row: Result<Vec<f64>, _> = record.iter().map(str::parse).collect();
        let row = row.map_err(|e| fails(format!("row {}: {e}", rows.len() + 2)))?;
        if row.len() != 19 || row.iter().any(|x| !x.is_finite()) {
            return Err(fails(format!("row {} has {} numbers, not 19", rows.len() + 2, row.len())));
        }
        rows.push(row);
    }
    if rows.len() < 200 {
        return Err(fails(format!("{} rows are less than two seconds", rows.len())));
    }
    let marker = |row: &[f64], m: usize| DVec3::new(row[1 + 3 * m], row[2 + 3 * m], row[3 + 3 * m]);
    let last = &rows[rows.len() - 100..];
    let rest = |m: usize| last.iter().map(|r| marker(r, m)).sum::<DVec3>() / last.len() as f64;
    let sag_mm = (0..3).map(|m| rest(m).distance(marker(&rows[0], m))).sum::<f64>() / 3.0 * 1e3;
    // The motion along the way to rest, of the first marker.
    let along = (rest(0) - marker(&rows[0], 0)).normalize_or_zero();
    let motion: Vec<f64> = rows.iter().map(|r| (marker(r, 0) - rest(0)).dot(along)).collect();
    let (period_s, damping) = ringing(&motion, 0.01).ok_or_else(|| fails("no free swing is seen in it".into()))?;
    Ok(Take { sag_mm, period_s, damping })
}

/// Period and damping ratio of a motion about zero, from its extremes after it first crossed zero: half periods between them, the logarithm of their decrease. Only those above a twentieth of
/// the first count: the rest is noise.
#[must_use]
pub fn ringing(motion: &[f64], dt: f64) -> Option<(f64, f64)> {
    // Before the first crossing of zero it may have been held for any time.
    let motion = &motion[motion.windows(2).position(|w| w[0] * w[1] < 0.0)?..];
    let floor = motion.iter().fold(0.0_f64, |a, x| a.max(x.abs())) / 20.0;
    let mut extremes: Vec<(f64, f64)> = Vec::new();
    for i in 1..motion.len().checked_sub(1)? {
        let (a, b, c) = (motion[i - 1], motion[i], motion[i + 1]);
        let is_peak = (b > a && b >= c && b > floor) || (b < a && b <= c && b < -floor);
        // One extreme between two crossings of zero: the largest.
        if is_peak {
            let shift = (a - c) / (2.0 * (a - 2.0 * b + c));
            let peak = ((i as f64 + shift) * dt, b);
            match extremes.last_mut() {
                Some(last) if last.1.signum() == b.signum() => {
                    if b.abs() > last.1.abs() {
                        *last = peak;
                    }
                }
                _ => extremes.push(peak),
            }
        }
    }
    let ([first, ..], [.., last]) = (extremes.as_slice(), extremes.as_slice()) else { return None };
    let halves = extremes.len() as f64 - 1.0;
    if halves < 2.0 {
        return None;
    }
    let period = 2.0 * (last.0 - first.0) / halves;
    let decrement = (first.1.abs() / last.1.abs()).ln() / halves;
    Some((period, decrement / (std::f64::consts::PI.powi(2) + decrement * decrement).sqrt()))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;

    #[test]
    fn ringing_of_a_damped_oscillation() {
        let (period, ratio) = (0.23, 0.06);
        let omega = std::f64::consts::TAU / period;
        let decay = ratio / (1.0_f64 - ratio * ratio).sqrt() * omega;
        let motion: Vec<f64> = (0..300).map(|i| f64::from(i) * 0.01).map(|t| (-decay * t).exp() * (omega * t).cos()).collect();
        let (p, d) = ringing(&motion, 0.01).unwrap();
        assert!((p / period - 1.0).abs() < 0.01 && (d / ratio - 1.0).abs() < 0.05, "{p} {d}");
        assert_eq!(ringing(&[0.0; 50], 0.01), None);
    }

    #[test]
    fn a_film_that_is_none_is_refused_with_its_row() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("film.csv");
        std::fs::write(&path, "time_s,m0_x_m\n0.0,x\n").unwrap();
        let message = read(&path).unwrap_err().to_string();
        assert!(message.contains("film.csv") && message.contains("row 2"), "{message}");
    }
}
