//! Captures on disk: a session's folder, its segments, its manifest. Layout and order of writes: docs/formats.md.

mod folder;
mod manifest;
mod segment;
mod session;

pub use folder::{Loss, missing_parts, read_info, session_holding};
pub use manifest::{Counts, FORMAT_VERSION, LiveInfo, ManifestLine, PoseBox, SessionInfo};
pub use session::{RecordingError, SessionWriter, write_atomically};

/// Topics that a capture adds to what was recorded.
pub mod topic {
    /// `geometry_msgs/PoseWithCovarianceStamped`, valid tags only.
    pub const POSE: &str = "/camera/pose";
    /// `realitysim_msgs/FrameTag`, one per frame.
    pub const FRAME_TAG: &str = "/frame_tag";
    /// `diagnostic_msgs/DiagnosticArray`, one per second.
    pub const DIAGNOSTICS: &str = "/diagnostics";
}
