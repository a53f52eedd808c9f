//! Scores of tasks against published proficiency: those of the Fundamentals of Laparoscopic Surgery (FLS).
//!
//! The score of a task is its cutoff time less the time taken less penalties, never below zero (the MISTELS programme, from which FLS comes: Derossis et al.
//! 1998, doi 10.1016/S0002-9610(98)00080-4; Fraser et al. 2003, doi 10.1007/s00464-002-8828-4). The examination puts scores of different tasks on one
//! scale by a norm that is not published; here 100 % is the score of one who is proficient without an error. How much an error costs is not
//! published either: it is one second a unit of the error here, and stands as data beside the cutoffs.

use serde::{Deserialize, Serialize};

/// A task with published proficiency.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Standard {
    /// Name in scenes and files.
    pub id: &'static str,
    /// Name for reading.
    pub name: &'static str,
    /// Time after which the score is zero, s.
    pub cutoff_s: f64,
    /// Time of one who is proficient, s.
    pub proficient_s: f64,
    /// What counts as an error, with its unit.
    pub error: &'static str,
    /// What an error costs, s a unit.
    pub penalty_s: f64,
    /// Errors that one who is proficient may make, units.
    pub allowed: f64,
    /// What else one who is proficient must not have done.
    pub forbidden: &'static str,
    /// Where times and errors come from.
    pub source: &'static str,
}

const FLS: &str = "Proficiency: Ritter & Scott 2007, doi 10.1177/1553350607302329; cutoffs: FLS manual skills guidelines";

/// The tasks of FLS.
pub const STANDARDS: [Standard; 5] = [
    Standard {
        id: "peg_transfer",
        name: "Peg transfer",
        cutoff_s: 300.0,
        proficient_s: 48.0,
        error: "objects dropped out of view",
        penalty_s: 1.0,
        allowed: 0.0,
        forbidden: "none",
        source: FLS,
    },
    Standard {
        id: "pattern_cut",
        name: "Pattern cut",
        cutoff_s: 300.0,
        proficient_s: 98.0,
        error: "largest distance from the line, mm",
        penalty_s: 1.0,
        allowed: 2.0,
        forbidden: "none",
        source: FLS,
    },
    Standard {
        id: "ligating_loop",
        name: "Ligating loop",
        cutoff_s: 180.0,
        proficient_s: 53.0,
        error: "distance from the mark, mm",
        penalty_s: 1.0,
        allowed: 1.0,
        forbidden: "an insecure knot",
        source: FLS,
    },
    Standard {
        id: "extracorporeal_knot",
        name: "Suture with extracorporeal knot",
        cutoff_s: 420.0,
        proficient_s: 136.0,
        error: "distance from the marks and gap, mm",
        penalty_s: 1.0,
        allowed: 1.0,
        forbidden: "an insecure knot, an avulsed drain",
        source: FLS,
    },
    Standard {
        id: "intracorporeal_knot",
        name: "Suture with intracorporeal knot",
        cutoff_s: 600.0,
        proficient_s: 112.0,
        error: "distance from the marks and gap, mm",
        penalty_s: 1.0,
        allowed: 1.0,
        forbidden: "an insecure knot, an avulsed drain",
        source: FLS,
    },
];

/// How a task was done.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Attempt {
    /// Time taken, s.
    pub time_s: f64,
    /// Errors, in the unit of the task's [`Standard::error`].
    pub errors: f64,
    /// Whether the task was finished without what is forbidden.
    pub complete: bool,
}

/// What an attempt is worth.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// [`Standard::id`].
    pub task: String,
    /// What was done.
    pub attempt: Attempt,
    /// Cutoff less time less penalties, not below zero, s; zero for a task that was not finished.
    pub points: f64,
    /// The same as a part of the points of one who is proficient without an error, %.
    pub percent: f64,
    /// Whether it is as good as published proficiency.
    pub proficient: bool,
}

impl Standard {
    /// The standard of a task by its [`Standard::id`].
    #[must_use]
    pub fn of(id: &str) -> Option<&'static Self> {
        STANDARDS.iter().find(|s| s.id == id)
    }

    /// What an attempt is worth.
    #[must_use]
    pub fn score(&self, attempt: Attempt) -> Score {
        let left = self.cutoff_s - attempt.time_s - self.penalty_s * attempt.errors;
        let points = if attempt.complete { left.max(0.0) } else { 0.0 };
        Score {
            task: self.id.into(),
            attempt,
            points,
            percent: 100.0 * points / (self.cutoff_s - self.proficient_s),
            proficient: attempt.complete && attempt.time_s <= self.proficient_s && attempt.errors <= self.allowed,
        }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;

    /// A circle cut in 150 s, at most 3 mm off the line: 300 - 150 - 3 = 147 points of 300 - 98 = 202, which is 72.8 %.
    #[test]
    fn a_pattern_cut_by_hand() {
        let standard = Standard::of("pattern_cut").unwrap();
        let score = standard.score(Attempt { time_s: 150.0, errors: 3.0, complete: true });
        assert_eq!(score.points, 147.0);
        assert!((score.percent - 72.772).abs() < 1e-3 && !score.proficient);
        assert!(standard.score(Attempt { time_s: 98.0, errors: 2.0, complete: true }).proficient);
        assert!(!standard.score(Attempt { time_s: 98.0, errors: 2.1, complete: true }).proficient);
        assert_eq!(standard.score(Attempt { time_s: 301.0, errors: 0.0, complete: true }).points, 0.0);
        assert_eq!(standard.score(Attempt { time_s: 50.0, errors: 0.0, complete: false }).points, 0.0);
    }

    #[test]
    fn one_who_is_proficient_has_all_points() {
        for standard in &STANDARDS {
            let score = standard.score(Attempt { time_s: standard.proficient_s, errors: 0.0, complete: true });
            assert!(score.proficient && (score.percent - 100.0).abs() < 1e-9);
            assert_eq!(Standard::of(standard.id), Some(standard));
        }
        assert_eq!(Standard::of("appendectomy"), None);
    }
}
