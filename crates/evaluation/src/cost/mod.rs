//! What accuracy costs in time: settings tried on the same frames, judged, and one of them recommended.
//!
//! [`plan`] says which settings, [`sweep`] tries and judges them, [`front`] tells which are worth their time,
//! [`advise`] which to take, [`chart`] draws it. Clocks and frames are the caller's.

mod advice;
mod capped;
mod chart;
mod front;
mod knobs;
mod row;
mod sweep;

pub use advice::{Advice, Wish, advise, noise_cm};
pub use capped::{capped, is_exceeded};
pub use chart::chart;
pub use front::{Point, front};
pub use knobs::{Knobs, plan, reference};
pub use row::Row;
pub use sweep::{Measure, as_truth, sweep};
