//! The particle filter of the paper: samples of the robot's pose, moved by odometry, weighed by the field lines,
//! resampled. [`filter::Filter::step`] is the loop.
//!
//! Pure: time, measurements and the seed are arguments; no I/O, clock, thread or global randomness.

pub mod kernel;
pub mod motion;
pub mod particles;
pub mod random;
pub mod resampling;
pub mod weights;

pub use kernel::SimdPath;
pub use motion::MotionModel;
pub use particles::Particles;
