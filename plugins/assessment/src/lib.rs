//! Recording, replay, metrics and scores.
//!
//! [`recording`] takes down what comes from outside and plays it to the same bits. [`metrics`] are plain functions and sums over plain samples;
//! [`session`] has those of a session, [`task`] looks for a task's goals, [`score`] puts it against published proficiency, [`results`] are the files and pages
//! that come of it.
//! [`plugin`] and [`recording::plugin`] are the glue.

pub mod metrics;
pub mod plugin;
pub mod recording;
pub mod results;
pub mod score;
pub mod session;
pub mod task;

pub use metrics::{Metric, MetricId};
pub use plugin::{Assessment, AssessmentPlugin, AssessmentSettings, Clamped, Outcome, outcome};
pub use results::{GoalResult, Measured, PenaltyResult, Progress, Results, TaskResult};
pub use score::{Attempt, Scale, Score, Standard};
pub use task::{Circle, Goal, Penalty, Span, Task, TaskStatus, Want};
