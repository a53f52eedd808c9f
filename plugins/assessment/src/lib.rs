//! Recording, replay, metrics and scores.
//!
//! [`recording`] takes down what comes from outside and plays it to the same bits. [`metrics`] are plain functions and sums over plain samples;
//! [`session`] has those of a session, [`score`] puts a task against published proficiency, [`results`] are the files and pages that come of it.
//! [`plugin`] and [`recording::plugin`] are the glue.

pub mod metrics;
pub mod plugin;
pub mod recording;
pub mod results;
pub mod score;
pub mod session;

pub use metrics::{Metric, MetricId};
pub use plugin::{Assessment, AssessmentPlugin, AssessmentSettings, Circulation, Outcome, outcome};
pub use results::{Measured, Progress, Results};
pub use score::{Attempt, Score, Standard};
