//! What accuracy costs in time: settings tried on the same frames, judged, and one of them recommended.
//!
//! [`plan`] says which settings, [`sweep`] tries and judges them, [`front`] tells which are worth their time,
//! [`advise`] which to take, [`chart`] draws it. Clocks and frames are the caller's.

mod budgeted;
mod chart;
mod pareto_front;
mod recommendation;
mod row;
mod sweep;
mod sweep_point;

pub use budgeted::{capped, is_exceeded};
pub use chart::chart;
pub use pareto_front::{Point, front};
pub use recommendation::{Advice, Requirements, advise, noise_cm};
pub use row::Row;
pub use sweep::{Measure, as_truth, sweep};
pub use sweep_point::{SweepPoint, plan, reference};
