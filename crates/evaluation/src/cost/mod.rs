//! The cost of accuracy: settings of the filter tried on the same frames, judged, and one of them recommended.
//!
//! [`plan`] lists the settings, [`sweep`](fn@sweep) tries and judges them, [`front`] finds the Pareto-optimal ones,
//! [`advise`] recommends one, [`chart`](fn@chart) draws all. The caller has the clock and the frames.

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
