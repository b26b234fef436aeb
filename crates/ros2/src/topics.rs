//! Names of the topics that this program writes, and of its entries on topics that it shares with others.
//!
//! The topics that it reads are settings, because every robot has names of its own.

/// Topic of the valid tags as `geometry_msgs/PoseWithCovarianceStamped`: the pose of `camera_link` in `map`.
pub const POSE: &str = "/camera/pose";

/// Topic of the valid tags as `tf2_msgs/TFMessage`, for viewers: from `map` to [`TAGGED_CAMERA`], and on to [`TAGGED_OPTICAL`].
///
/// The robot's own transforms stay on `/tf`: these have coordinate frames of their own, so that no frame has two parents.
pub const CAMERA_TF: &str = "/camera/tf";

/// Coordinate frame of the camera where its tag puts it: x forward, y left, z up (REP 103).
pub const TAGGED_CAMERA: &str = "tagged_camera";

/// The same for its optical axes: z forward, x right, y down.
pub const TAGGED_OPTICAL: &str = "tagged_camera_optical";

/// Topic of all tags as `realitysim_msgs/FrameTag`: one for each frame, valid or not.
pub const FRAME_TAG: &str = "/frame_tag";

/// Topic of dead reckoning as `realitysim_msgs/FrameTag`: poses by odometry alone while no frame comes, marked as not valid.
pub const PREDICTED_TAG: &str = "/predicted_tag";

/// Topic of diagnostics as `diagnostic_msgs/DiagnosticArray`: one each second, and one for each gap.
///
/// Robots use this topic as well; names of entries of this program begin with [`DIAGNOSTICS_PREFIX`].
pub const DIAGNOSTICS: &str = "/diagnostics";

/// Start of the name of each `DiagnosticStatus` that this program writes.
pub const DIAGNOSTICS_PREFIX: &str = "realitysim: ";

/// Topic of what a rendered scene drew at random, for the whole scene and for each frame: `diagnostic_msgs/DiagnosticArray`.
pub const SCENE_DRAWN: &str = "/scene/drawn";

/// Topics that only an earlier run of this program can have written; a replay leaves them out of its input.
pub const OUTPUTS: [&str; 4] = [POSE, CAMERA_TF, FRAME_TAG, PREDICTED_TAG];

/// Name of the attachment of a segment that holds the checkpoint: the state of the filter.
pub const CHECKPOINT_ATTACHMENT: &str = "filter_state";
