//! Captures on disk: a session's folder, its segments, its manifest. Layout and order of writes: docs/formats.md.

mod acknowledgement;
pub mod catalogue;
mod coverage;
mod folder;
mod identity;
mod manifest;
mod segment;
mod session;
mod thinning;

pub use acknowledgement::{ACK_ENDING, ACK_FOLDER, Acknowledged, Acknowledgement, is_receiver, receivers_of};
pub use catalogue::{Session, SetAside};
pub use coverage::{read_coverage, write_coverage};
pub use folder::{Loss, missing_parts, read_info, session_holding};
pub use identity::{Head, SessionId, robot_id};
pub use manifest::{Counts, FORMAT_VERSION, LiveInfo, MANIFEST_FILE, ManifestLine, PoseBox, SESSION_FILE, SessionInfo};
pub use segment::sync_folder;
pub use session::{RecordingError, SessionWriter, write_atomically};
pub use thinning::Thinning;

/// Which cells of the pose grid have images, as a session leaves it.
pub const COVERAGE_FILE: &str = "coverage.json";

/// Topics that a capture adds to what was recorded.
pub mod topic {
    /// `geometry_msgs/PoseWithCovarianceStamped`, valid tags only.
    pub const POSE: &str = "/camera/pose";
    /// `realitysim_msgs/FrameTag`, one per frame.
    pub const FRAME_TAG: &str = "/frame_tag";
    /// `diagnostic_msgs/DiagnosticArray`, one per second.
    pub const DIAGNOSTICS: &str = "/diagnostics";
}
