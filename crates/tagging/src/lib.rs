//! The chain from sensor messages to camera poses: log or scene in, capture with a tag for every frame out.
//!
//! [`pipeline`] is the chain itself. It synchronises messages ([`realitysim_log_input`]), looks at images on several
//! threads, runs the localizer frame after frame ([`Tagger`]) and hands messages and tags to the recorder. [`replay()`]
//! feeds it from a log or a scene ([`open_input`]); the live recorder feeds it from devices. [`checkpoint`] stores the
//! filter's state so that each segment replays alone, and [`dead_reckoning`] predicts poses while no frame comes.
//! Other uses of the same parts: [`single_image`] locates one image, [`explanation`] shows what a tag follows from,
//! [`frame_cache`] tries settings on the same frames again, [`offline_refinement`] refines a whole capture afterwards.
//!
//! This example renders one second of a standing robot and tags each of its frames:
//!
//! ```rust
//! use realitysim_tagging::{ReplayOptions, replay};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # let scene = r#"
//! # scene = { title = "Standing", task = "Show the crate.", seed = 1, field = "kid-2020" }
//! # camera = { lens = "fisheye-640", rate_hz = 5.0, torso_height_m = 0.38, mount_xyz_m = [0.0, 0.0, 0.1], mount_pitch_deg = 17.0 }
//! # route = { kind = "still", poses = [[-2.0, 0.5, 0.0]], hold_s = 1.0 }
//! # odometry = { rate_hz = 50.0 }
//! # imu = { rate_hz = 100.0 }
//! # "#;
//! let folder = tempfile::tempdir()?;
//! let source = folder.path().join("scene.toml");
//! std::fs::write(&source, scene)?;
//! let options = ReplayOptions {
//!     source, // or an MCAP file
//!     captures: folder.path().join("captures"),
//!     settings: realitysim_config::Settings::default(),
//!     initial: None,
//!     threads: 2,
//!     realtime: false,
//!     warm_start: false,
//! };
//! let report = replay(&options, &mut |_done, _total| {})?;
//! assert!(report.frames > 0);
//! assert_eq!(report.tagged, report.frames);
//! assert!(report.session.join("session.json").is_file());
//! # Ok(())
//! # }
//! ```

pub mod board_calibration;
mod budget;
pub mod calibrated_lens;
pub mod calibration_check;
pub mod checkpoint;
pub mod cut;
pub mod dead_reckoning;
mod diagnosis;
pub mod durations;
pub mod error;
pub mod explanation;
mod filter_stats;
pub mod frame_cache;
pub mod image_location;
pub mod inter_session;
pub mod log_scan;
pub mod offline_refinement;
pub mod open_input;
mod parallel;
mod perception_pool;
pub mod pipeline;
pub mod replay;
mod report;
pub mod robot_track;
mod run_stats;
pub mod setup;
pub mod single_image;
mod tag_log;
pub mod tagger;
pub mod unknown_mount;
pub mod walk_calibration;
pub mod warm_start;
pub mod warnings;

pub use checkpoint::{Checkpoint, CheckpointError};
pub use error::{AgentError, ReplayError};
pub use frame_cache::{Claims, FrameCache, FrameCacheOptions, Trial};
pub use parallel::in_parallel;
pub use replay::{ReplayOptions, replay};
pub use report::ReplayReport;
pub use setup::SetupError;
pub use tag_log::{TagLogError, write_tag_log};
pub use tagger::Tagger;
