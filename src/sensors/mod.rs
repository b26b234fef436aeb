//! The rim towards the hardware and what stands in for it: logs and scenes.
//!
//! Whatever the source, the agent gets [`LogMessage`](crate::ros2::mcap_read::LogMessage)s: a scene and a recorded
//! log take the same way.

mod body_mask;
pub mod camera;
mod camera_twist;
pub mod clock;
pub mod decode;
pub mod encode;
pub mod file_kind;
pub mod history;
pub mod host_clock;
pub mod intake;
pub mod log;
pub mod mavlink;
mod permission;
pub mod scene;
pub mod serial;
pub mod stale_socket;
pub mod synchroniser;
pub mod topic_resolution;
pub mod transforms;
#[cfg(feature = "v4l2")]
pub mod v4l2;
pub mod video_out;

pub use body_mask::{body_mask, mask};
