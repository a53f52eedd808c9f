//! Tasks: goals that are looked for on the whiteboard, errors that cost time, and the score that comes of both.
//!
//! [`goal`] says what a goal may be, [`judge`] has the plain functions that tell whether it is met, [`drops`] counts what was let go of and fell, and
//! [`plugin`] looks ten times a second. What an attempt is worth is a matter of [`crate::score`].

pub mod drops;
pub mod goal;
pub mod judge;
pub mod plugin;

pub use goal::{Circle, Goal, GoalStatus, Penalty, Span, Task, TaskStatus, Want};
pub use plugin::TaskPlugin;
