//! What a session came to: as figures, as files, as a page, and a trainee's progress over many.

mod document;
pub mod page;
pub mod plots;
pub mod progress;
pub mod record;
pub mod tasks;

pub use document::number;
pub use page::page;
pub use progress::{Progress, ProgressError};
pub use record::{MarginSummary, Measured, Results};
pub use tasks::{GoalResult, PenaltyResult, TaskResult};
