//! Captures on disk: a session's folder, its segments, its manifest. Layout and order of writes: docs/formats.md; what is
//! promised of them, and how it is tested: docs/recording.md.

mod acknowledged;
mod entry;
mod error;
mod folder;
mod gap;
mod manifest;
mod recorder;
mod repair;
mod retention;
mod segment;
mod session;
mod shared;
#[cfg(test)]
mod simulation;
mod status;
pub mod storage;
mod verify;
mod worst_stall;
mod writer;

use std::path::Path;

pub use acknowledged::{ACKNOWLEDGEMENTS, Acknowledgement};
pub use error::RecordingError;
pub use folder::{Loss, missing_parts, read_info, session_holding};
pub use manifest::{Counts, FORMAT_VERSION, LiveInfo, ManifestLine, PINNED_FILE, PoseBox, SessionInfo};
pub use repair::{Repaired, repair, repair_all, sessions_of};
pub use retention::Evicted;
pub use session::{SegmentState, SessionWriter, Writing};
pub use status::{Fault, RecorderStatus, Stopped};
pub use verify::{Verified, verify};
pub use worst_stall::DiskMeasured;

/// The old content or the new, never a part.
pub fn write_atomically(path: &Path, content: &[u8]) -> Result<(), RecordingError> {
    storage::write_atomically(&storage::Disk, path, content)
}

/// Topics that a capture adds to what was recorded.
pub mod topic {
    /// `geometry_msgs/PoseWithCovarianceStamped`, valid tags only.
    pub const POSE: &str = "/camera/pose";
    /// `realitysim_msgs/FrameTag`, one per frame.
    pub const FRAME_TAG: &str = "/frame_tag";
    /// `diagnostic_msgs/DiagnosticArray`, one per second, and one for each gap.
    pub const DIAGNOSTICS: &str = "/diagnostics";
}
