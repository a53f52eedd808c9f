//! Scores of tasks against published proficiency: those of the Fundamentals of Laparoscopic Surgery (FLS).
//!
//! The score of a task is its cutoff time less the time taken less penalties, never below zero (the MISTELS programme, from which FLS comes: Derossis et al.
//! 1998, doi 10.1016/S0002-9610(98)00080-4; Fraser et al. 2003, doi 10.1007/s00464-002-8828-4). The examination puts scores of different tasks on one
//! scale by a norm that is not published; here 100 is the score of one who is proficient without an error, and who is faster has no more:
//!
//! `score = 100 (cutoff - time - penalties) / (cutoff - proficient)`, from 0 to 100; 0 where a goal is not met.
//!
//! How much an error costs is not published either: a scene says it, in seconds a unit. A scene that has a part of a published task alone, two of its
//! twelve transfers for one, takes its times by that part; one that is like no published task brings times of its own, and its page says so.

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

/// Between which times a score lies.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scale {
    /// [`Standard::id`] of the published task; empty where the times are the scene's own.
    pub task: String,
    /// The part of the published task that the scene has, above 0 and at most 1.
    pub share: f64,
    /// Time after which the score is zero, s.
    pub cutoff_s: f64,
    /// Time of one who is proficient, s.
    pub proficient_s: f64,
    /// Penalties that one who is proficient may have, s.
    pub allowed_s: f64,
}

/// How a task was done.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Attempt {
    /// Time taken, s.
    pub time_s: f64,
    /// What errors cost, s.
    pub penalty_s: f64,
    /// Whether the task was finished without what is forbidden.
    pub complete: bool,
}

/// What an attempt is worth.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// Against what.
    pub scale: Scale,
    /// What was done.
    pub attempt: Attempt,
    /// From 0 to 100: see [`Scale::score`].
    pub score: f64,
    /// Whether it is as good as published proficiency.
    pub proficient: bool,
}

impl Standard {
    /// The standard of a task by its [`Standard::id`].
    #[must_use]
    pub fn of(id: &str) -> Option<&'static Self> {
        STANDARDS.iter().find(|s| s.id == id)
    }

    /// The scale of a scene that has this part of the task.
    #[must_use]
    pub fn scale(&self, share: f64) -> Scale {
        let [cutoff_s, proficient_s] = [self.cutoff_s, self.proficient_s].map(|s| s * share);
        Scale { task: self.id.into(), share, cutoff_s, proficient_s, allowed_s: self.penalty_s * self.allowed }
    }
}

impl Scale {
    /// A scene's own times: no more than its author's word for them.
    #[must_use]
    pub fn own(cutoff_s: f64, proficient_s: f64) -> Self {
        Self { task: String::new(), share: 1.0, cutoff_s, proficient_s, allowed_s: 0.0 }
    }

    /// What an attempt is worth: 100 times what is left of the cutoff after time and penalties, as a part of what is left to one who is proficient without an error; from 0 to
    /// 100, and 0 for a task that was not finished.
    #[must_use]
    pub fn score(&self, attempt: Attempt) -> Score {
        let left = (self.cutoff_s - attempt.time_s - attempt.penalty_s) / (self.cutoff_s - self.proficient_s);
        Score {
            score: if attempt.complete { 100.0 * left.clamp(0.0, 1.0) } else { 0.0 },
            proficient: attempt.complete && attempt.time_s <= self.proficient_s && attempt.penalty_s <= self.allowed_s,
            scale: self.clone(),
            attempt,
        }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;

    /// A circle cut in 150 s, at most 3 mm off the line: 300 - 150 - 3 = 147 s are left of 300 - 98 = 202 s, which is 72.8 %.
    #[test]
    fn a_pattern_cut_by_hand() {
        let scale = Standard::of("pattern_cut").unwrap().scale(1.0);
        let of = |time_s, penalty_s, complete| scale.score(Attempt { time_s, penalty_s, complete });
        let score = of(150.0, 3.0, true);
        assert!((score.score - 72.772).abs() < 1e-3 && !score.proficient);
        assert!(of(98.0, 2.0, true).proficient && !of(98.0, 2.1, true).proficient);
        assert_eq!(of(301.0, 0.0, true).score, 0.0);
        assert_eq!(of(50.0, 0.0, false).score, 0.0);
        assert_eq!(of(50.0, 0.0, true).score, 100.0, "no more for being faster");
    }

    /// Two of the twelve transfers: 50 s less 19.5 s less one drop at 5 s is 25.5 s of 50 - 8 = 42 s, which is 60.7 %.
    #[test]
    fn a_part_of_a_task_by_hand() {
        let scale = Standard::of("peg_transfer").unwrap().scale(2.0 / 12.0);
        let score = scale.score(Attempt { time_s: 19.5, penalty_s: 5.0, complete: true });
        assert!((score.score - 60.714).abs() < 1e-3 && !score.proficient, "{score:?}");
    }

    #[test]
    fn one_who_is_proficient_has_all_points() {
        for standard in &STANDARDS {
            let scale = standard.scale(1.0);
            let score = scale.score(Attempt { time_s: standard.proficient_s, penalty_s: 0.0, complete: true });
            assert!(score.proficient && (score.score - 100.0).abs() < 1e-9);
            assert_eq!(Standard::of(standard.id), Some(standard));
        }
        assert_eq!(Standard::of("appendectomy"), None);
        assert_eq!(Scale::own(60.0, 20.0).score(Attempt { time_s: 30.0, penalty_s: 10.0, complete: true }).score, 50.0);
    }
}
