//! Reads logs and rendered scenes as a robot's measurements, and brings these together in time.
//!
//! A source is an iterator of [`LogMessage`](realitysim_ros2::mcap_read::LogMessage)s: [`log::LogSource`] reads MCAP files,
//! [`scene_source::SceneSource`] renders a scene into the messages that a robot would have logged. What follows is the
//! same for both. [`topic_resolution`] finds out which topic carries which measurement, [`measurement::read`] decodes one
//! message, and a [`FrameAssembler`] gives out each frame with the robot's state at its exposure.
//! [`decode`] and [`encode`] convert between a frame's bytes and its pixels.
//!
//! ```rust
//! use realitysim_config::{FrameNames, HeadSettings, Topics};
//! use realitysim_log_input::scene_source::{self, SceneSource};
//! use realitysim_log_input::{FrameAssembler, synchroniser::Synchroniser};
//!
//! let scene = scene_source::load("../../replay/scenes/demo.toml")?;
//! let synchroniser = Synchroniser::new(FrameNames::default(), Default::default());
//! let mut assembler = FrameAssembler::new(Topics::default(), HeadSettings::default(), synchroniser, false);
//! let frame = assembler.frames_of(SceneSource::new(&scene)).next().expect("a scene has frames")?;
//! let robot = &frame.robot;
//! assert!(robot.odometry.is_some(), "where the robot's own odometry had it");
//! let camera = robot.place.clone()?;
//! assert!(camera.footprint_from_optical.translation.z > 0.3, "metres above the ground");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod attitude_filter;
mod body_mask;
mod camera_twist;
mod conversion;
pub mod decode;
pub mod encode;
pub mod file_kind;
pub mod foxglove;
mod frames;
pub mod history;
mod input_source;
pub mod log;
pub mod measurement;
pub mod planar_velocity;
pub mod scene_source;
pub mod synchroniser;
pub mod tables;
pub mod topic_resolution;
pub mod transforms;

pub use body_mask::{body_mask, mask};
pub use frames::{FrameAssembler, Frames};
pub use input_source::InputSource;
