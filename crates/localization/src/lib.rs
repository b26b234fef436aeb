//! Finds a camera's pose on a soccer field, frame by frame, and says how far that pose can be trusted.
//!
//! [`Localizer::look`] takes what one frame shows (`realitysim_vision::Observations`) and what the sensors say ([`FrameSensors`]), and answers with a
//! [`Fix`]. Inside, [`Filter::step`] is the particle filter of the paper: particles are moved by odometry, weighed by the field lines and resampled.
//! [`refinement`] then fits the camera's pose to the lines by least squares, [`slow_states`] carries tilt, height, lens and gyro bias from frame
//! to frame, [`global_search`] tries the whole field when the robot is lost, and [`validation`] decides whether the pose is believed or
//! for which [`Rejection`] it is not. [`smoothing`] fits a whole recorded walk at once.
//!
//! The crate is pure: time, measurements and the seed are arguments. It uses no files, clocks, threads or global randomness.
//!
//! ```rust
//! use realitysim_geometry::{Field, Pose2};
//! use realitysim_localization::{filter::always, observation::default_alpha, *};
//! use realitysim_vision::{GroundTable, ground::SIDE};
//!
//! let field = Field::new(realitysim_config::load_field("kid-2020").unwrap()).unwrap();
//! let observation = Observation::new(&field, 350, Formula::Corrected, default_alpha(Formula::Corrected), SimdPath::Auto);
//! let sampling = Sampling { particles: 800, iterations: 5, adaptive: true, fewest: 100 };
//! let jitter = Spread { xy_m: 0.04, yaw_rad: 0.026 };
//! let settings = FilterSettings { sampling, motion: MotionModel::default(), jitter, jitter_shrink: 0.6, seed: 1 };
//! let mut filter = Filter::new(settings, observation, FilterState::default());
//! filter.restart(Pose2::new(-2.1, 0.6, 0.35), Spread { xy_m: 0.15, yaw_rad: 0.09 });
//! // The floor around a robot at `truth` in cells of 2 cm: 255 where a line is seen. Usually `Vision::look` makes the table from a picture.
//! let truth = Pose2::new(-2.0, 0.5, 0.3);
//! let cell_m = |index: usize| (index as f64 - (SIDE as f64 / 2.0 - 0.5)) * 0.02;
//! let map_from_cell = |cell: usize| truth.to_affine().transform_point2([cell_m(cell % SIDE), cell_m(cell / SIDE)].into());
//! let levels: Vec<u8> =
//!     (0..SIDE * SIDE).map(|cell| if field.distance_to_centre_line(map_from_cell(cell)) < 0.03 { 255 } else { 0 }).collect();
//! let table = GroundTable::from_levels(&levels, 0.02);
//! let estimate = filter.step(Some(Pose2::default()), 0.1, &table, &mut Effort::default(), &mut always);
//! assert!(estimate.best.distance(&truth) < 0.1);
//! ```

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
pub use filter::{Effort, Filter, FilterSettings, FilterState, TimeCheck};
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
