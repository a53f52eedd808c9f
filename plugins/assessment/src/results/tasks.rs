//! How a task was done, as it stands in the files and on the page.

use crate::metrics::MetricId;
use crate::results::document::number;
use crate::results::record::Measured;
use crate::score::{Attempt, Score, Standard};
use crate::task::{Task, TaskStatus};
use maud::{Markup, html};
use serde::{Deserialize, Serialize};

/// How a task was done.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TaskResult {
    /// Its goals.
    pub goals: Vec<GoalResult>,
    /// Its errors, with what they cost.
    pub penalties: Vec<PenaltyResult>,
    /// Since when every goal is met, s since the scene began; `None`: one is not.
    pub finished_s: Option<f64>,
    /// What it is worth; `None` where the scene gives no times to score by.
    pub score: Option<Score>,
}

/// A goal.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GoalResult {
    /// Its name.
    pub name: String,
    /// Whether it is met.
    pub met: bool,
    /// Since when, s since the scene began.
    pub since_s: Option<f64>,
}

/// An error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PenaltyResult {
    /// What it is.
    pub error: MetricId,
    /// How much of it, in the metric's unit; both hands together.
    pub amount: f64,
    /// What it costs, s.
    pub seconds: f64,
}

impl TaskResult {
    /// How a task stands, given the figures of the session; `None` where there is no task.
    #[must_use]
    pub fn of(task: &Task, status: &TaskStatus, figures: &[Measured]) -> Option<Self> {
        if task.goals.is_empty() {
            return None;
        }
        let of_goal = |at: usize| status.goals.get(at).copied().unwrap_or_default();
        let goals = task.goals.iter().enumerate().map(|(at, goal)| {
            let status = of_goal(at);
            GoalResult { name: goal.name.clone(), met: status.met, since_s: status.since_s.filter(|_| status.met) }
        });
        let penalties: Vec<PenaltyResult> = task
            .penalties
            .iter()
            .map(|penalty| {
                let amount = figures.iter().filter(|m| m.metric == penalty.metric).map(|m| m.value).sum();
                PenaltyResult { error: penalty.metric, amount, seconds: amount * penalty.seconds }
            })
            .collect();
        let now_s = figures.iter().find(|m| m.metric == MetricId::Time).map_or(0.0, |m| m.value);
        let score = task.scale.as_ref().map(|scale| {
            let penalty_s = penalties.iter().map(|p| p.seconds).sum();
            scale.score(Attempt { time_s: status.finished_s.unwrap_or(now_s), penalty_s, complete: status.finished_s.is_some() })
        });
        Some(Self { goals: goals.collect(), penalties, finished_s: status.finished_s, score })
    }

    /// How many goals are met, of how many.
    #[must_use]
    pub fn met(&self) -> (usize, usize) {
        (self.goals.iter().filter(|g| g.met).count(), self.goals.len())
    }

    /// How it went, in a sentence.
    #[must_use]
    pub fn sentence(&self) -> String {
        let (met, all) = self.met();
        let open: Vec<&str> = self.goals.iter().filter(|g| !g.met).map(|g| g.name.as_str()).collect();
        let finished = self.finished_s.map_or_else(|| format!("; not met: {}", open.join(", ")), |s| format!(", since {s:.1} s"));
        let score = self.score.as_ref().map_or_else(String::new, |s| format!("; score {} of 100", number(s.score)));
        format!("Task: {met} of {all} goals met{finished}{score}.")
    }

    /// Its part of the page.
    pub(crate) fn markup(&self) -> Markup {
        let at = |since_s: Option<f64>| since_s.map_or_else(|| "\u{2013}".to_owned(), |s| format!("at {s:.1} s"));
        html! {
            h2 { "Task" }
            @if let Some(score) = &self.score { (line(score)) }
            table {
                tr { th { "goal" } th { "" } th { "" } }
                @for goal in &self.goals {
                    tr {
                        td { (goal.name) }
                        td.text { @if goal.met { span.yes { "met" } } @else { span.no { "not met" } } }
                        td { (at(goal.since_s)) }
                    }
                }
            }
            @if !self.penalties.is_empty() {
                table {
                    tr { th { "error" } th { "" } th { "unit" } th { "cost / s" } }
                    @for p in &self.penalties {
                        tr { td { (p.error.metric().name) } td { (number(p.amount)) } td.text { (p.error.metric().unit) } td { (number(p.seconds)) } }
                    }
                }
            }
        }
    }
}

/// A score with all that it was made of.
fn line(score: &Score) -> Markup {
    let (scale, attempt) = (&score.scale, &score.attempt);
    html! {
        p {
            strong { (number(score.score)) " of 100" }
            @if attempt.complete {
                " = 100 (" (number(scale.cutoff_s)) " s \u{2212} " (number(attempt.time_s)) " s \u{2212} " (number(attempt.penalty_s)) " s of penalties) / ("
                (number(scale.cutoff_s)) " s \u{2212} " (number(scale.proficient_s)) " s), from 0 to 100. "
            } @else {
                ": a goal is not met. "
            }
            @if score.proficient { span.yes { "Proficient" } } @else { span.no { "Not yet proficient" } }
            ": within " (number(scale.proficient_s)) " s, with penalties of at most " (number(scale.allowed_s)) " s. "
            @if let Some(standard) = Standard::of(&scale.task) {
                (standard.name)
                @if scale.share < 1.0 { ", of which the scene has " (number(100.0 * scale.share)) " %: the published times are taken by this" }
                ". " (standard.source) "."
            } @else {
                "The times are those of the scene\u{2019}s author: none are published for this task."
            }
        }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;
    use crate::score::Scale;
    use crate::task::{Goal, Penalty, Want};
    use keyhole_whiteboard::Hand;

    /// Finished at 40 s with two collisions at 3 s and 1.5 N s of overload of both hands at 2 s a unit: 100 (100 - 40 - 6 - 3) / (100 - 20) = 63.75.
    #[test]
    fn a_score_by_hand() {
        let goal = |name: &str| Goal { name: name.into(), want: Want::BloodBelow { ml: 1.0 }, once: false, step: None };
        let price = |metric, seconds| Penalty { metric, seconds };
        let task = Task {
            goals: vec![goal("a"), goal("b")],
            penalties: vec![price(MetricId::ToolCollisions, 3.0), price(MetricId::Overload, 2.0), price(MetricId::BloodLoss, 9.0)],
            scale: Some(Scale::own(100.0, 20.0)),
        };
        let measured = |metric, hand, value| Measured { metric, hand, value };
        let figures = [
            measured(MetricId::Time, None, 45.0),
            measured(MetricId::ToolCollisions, None, 2.0),
            measured(MetricId::Overload, Some(Hand::Left), 0.5),
            measured(MetricId::Overload, Some(Hand::Right), 1.0),
        ];
        let mut status = TaskStatus::default();
        status.take(&task, &[true, false], 30.0);
        let open = TaskResult::of(&task, &status, &figures).unwrap();
        assert_eq!((open.met(), open.finished_s, open.score.as_ref().unwrap().score), ((1, 2), None, 0.0));
        assert!(open.markup().into_string().contains("not met"));
        status.take(&task, &[true, true], 40.0);
        let done = TaskResult::of(&task, &status, &figures).unwrap();
        assert_eq!(done.penalties.iter().map(|p| p.seconds).collect::<Vec<_>>(), [6.0, 3.0, 0.0]);
        assert_eq!((done.met(), done.finished_s), ((2, 2), Some(40.0)));
        assert!((done.score.unwrap().score - 63.75).abs() < 1e-9);
        assert_eq!(TaskResult::of(&Task::default(), &status, &figures), None);
    }
}
