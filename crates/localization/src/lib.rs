//! The particle filter of the paper: samples of the robot's pose, moved by odometry, weighed by the field lines,
//! resampled. [`Filter::step`] is the loop.
//!
//! Pure: time, measurements and the seed are arguments; no I/O, clock, thread or global randomness.

pub mod estimate;
pub mod filter;
mod frozen;
pub mod global;
pub mod kernel;
mod known;
pub mod localizer;
pub mod motion;
pub mod observation;
mod observation_model;
pub mod painted;
pub mod particles;
mod posture;
pub mod random;
pub mod refinement;
pub mod resampling;
pub mod sampling;
mod second_look;
pub mod smoothing;
pub mod track;
pub mod verdict;
pub mod weights;

pub use estimate::Estimate;
pub use filter::{Effort, Filter, FilterSettings, FilterState, MayGoOn};
pub use kernel::SimdPath;
pub use localizer::{Evidence, Fix, LensOff, Localizer, LocalizerSettings, LocalizerState, Moment, Tried};
pub use motion::MotionModel;
pub use observation::{Observation, Support};
pub use observation_model::{Formula, Model};
pub use particles::{Particles, Spread};
pub use sampling::Sampling;
pub use track::{Track, TrackModel};
pub use verdict::{Confidence, Validity};
