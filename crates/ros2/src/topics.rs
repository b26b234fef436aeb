//! Topics that this program writes, and the names that mark what it writes on a topic of others.
//!
//! Topics that it reads are settings: every robot names its own.

/// `geometry_msgs/PoseWithCovarianceStamped`: the pose of `camera_link` in `map`, of valid tags only.
pub const POSE: &str = "/camera/pose";

/// `realitysim_msgs/FrameTag`: one for each frame, valid or not.
pub const FRAME_TAG: &str = "/frame_tag";

/// `realitysim_msgs/FrameTag` of no frame, and marked so: what odometry alone says while no frame comes.
pub const PREDICTED_TAG: &str = "/predicted_tag";

/// `diagnostic_msgs/DiagnosticArray`: one each second, and one for each gap. Robots use this topic as well; entries of this program
/// have names that begin with [`DIAGNOSTICS_PREFIX`].
pub const DIAGNOSTICS: &str = "/diagnostics";

/// The start of the name of each `DiagnosticStatus` that this program writes.
pub const DIAGNOSTICS_PREFIX: &str = "realitysim: ";

/// `diagnostic_msgs/DiagnosticArray`: what a rendered scene drew at random, for the whole scene and for each frame.
pub const SCENE_DRAWN: &str = "/scene/drawn";

/// Topics that only an earlier run of this program can have written: a replay leaves them out of its input.
pub const OUTPUTS: [&str; 3] = [POSE, FRAME_TAG, PREDICTED_TAG];

/// The name of the filter's state among the attachments of a segment.
pub const CHECKPOINT_ATTACHMENT: &str = "filter_state";
