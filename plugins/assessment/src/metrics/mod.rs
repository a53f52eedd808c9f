//! What is measured: plain functions and sums over plain samples, one a tick, in f64.
//!
//! What each figure means, its unit and where it comes from stands in one table, [`table`], which the results page prints. Nothing here grows with the
//! length of a session: sums are kept, samples are not.

pub mod camera;
pub mod force;
pub mod margin;
pub mod motion;
pub mod resection;
pub mod smooth;
pub mod table;
pub mod touch;

pub use camera::{CameraWatch, ViewCone};
pub use force::ForceWatch;
pub use margin::{Margin, MarginVertex};
pub use motion::{HandMotion, IdleSettings};
pub use resection::{Piece, Resection, Volumes};
pub use table::{Metric, MetricId, Scope};
pub use touch::{TouchCounter, shafts_touch};
