//! Logs and rendered scenes as a robot's measurements, brought together in time.
//!
//! Whatever the source, a consumer gets [`LogMessage`](realitysim_ros2::mcap_read::LogMessage)s: a scene and a recorded log take the
//! same way.

mod body_mask;
mod camera_twist;
pub mod decode;
pub mod encode;
pub mod file_kind;
pub mod history;
pub mod log;
pub mod measurement;
pub mod scene_source;
pub mod synchroniser;
pub mod topic_resolution;
pub mod transforms;

pub use body_mask::{body_mask, mask};
