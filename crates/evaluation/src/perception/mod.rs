//! How a detector of landmarks does on pictures whose camera poses are known, and a model of its errors.
//!
//! [`observe`] compares what the detector found in one picture with what the field's landmarks are known to be there. [`Statistics`]
//! summarizes observations: how many landmarks were to be seen and were found, false detections, bias and spread. An [`ErrorModel`]
//! has them by class, distance, angle off the optical axis and angular speed of the camera, to be sampled from by others.

mod bands;
mod error_model;
mod intervals;
mod moments;
mod observation;
mod report;
mod statistics;

pub use bands::{Band, DISTANCES_M, Light, OFF_AXIS_DEG, SPEEDS_DEG_S};
pub use error_model::{Delay, ErrorModel, ModelCell};
pub use intervals::Interval;
pub use moments::{GroundError, PixelError};
pub use observation::{JudgedPicture, Observation, Observations, Offset, Outcome, angular_speeds, observe};
pub use report::{DetectorReport, ReportCell};
pub use statistics::Statistics;
