//! The particle filter of the paper: samples of the robot's pose, moved by odometry, weighed by the field lines,
//! resampled. [`Filter::step`] is the loop.
//!
//! Pure: time, measurements and the seed are arguments; no I/O, clock, thread or global randomness.

pub mod estimate;
mod fall_detection;
pub mod filter;
mod frozen_image;
pub mod global_search;
pub mod kernel;
mod last_known_pose;
pub mod line_distance_map;
pub mod localizer;
pub mod motion;
pub mod observation;
mod observation_model;
pub mod particles;
pub mod random;
pub mod refinement;
mod rejection;
mod relocalization_trigger;
pub mod resampling;
pub mod sampling;
pub mod slow_states;
pub mod smoothing;
pub mod validation;
pub mod weights;

pub use estimate::Estimate;
pub use filter::{Effort, Filter, FilterSettings, FilterState, MayGoOn};
pub use kernel::SimdPath;
pub use localizer::{Evidence, Fix, FrameSensors, LensOff, Localizer, LocalizerSettings, LocalizerState, TriedPose};
pub use motion::MotionModel;
pub use observation::{Observation, Support};
pub use observation_model::{Formula, Model};
pub use particles::{Particles, Spread};
pub use rejection::Rejection;
pub use sampling::Sampling;
pub use slow_states::{SlowStateFilter, SlowStateModel};
pub use validation::{TrackingState, Validity};
