//! What a frame is localized by beside its image, and the answer.

use nalgebra::Matrix6;

use crate::estimate::Estimate;
use crate::filter::Effort;
use crate::line_distance_map::ExplainedLines;
use crate::observation::Support;
use crate::refinement::Agreement;
use crate::rejection::Rejection;
use realitysim_geometry::{Isometry, Physical, Pose2, Twist};

/// What sensors other than the camera say at the time of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameSensors {
    /// Time of the frame, nanoseconds.
    pub stamp_ns: i64,
    /// Pose of `base_footprint` by odometry, if known.
    pub odometry: Option<Pose2>,
    /// Turn of the robot since the last frame by gyro, radians.
    pub turned_rad: Option<f64>,
    /// Sum of the torso's roll and pitch, to and fro, since the last frame by gyro, radians.
    pub swayed_rad: Option<f64>,
    /// Motion of the camera, if something measures it.
    pub camera_twist: Option<Twist>,
    /// Whether a gyro has measured the rotation in `camera_twist`.
    pub turn_is_measured: bool,
    /// Pose of the camera in `base_footprint`, by IMU, joints and mount.
    pub footprint_from_optical: Option<Isometry>,
    /// Whether the torso's tilt is measured; otherwise a walking torso sways unseen.
    pub tilt_is_measured: bool,
    /// Angle between the torso's axis and the vertical, if measured, radians.
    pub lean_rad: Option<f64>,
    /// Whether a measurement is too old to describe a moving robot.
    pub stale: bool,
    /// Standard deviation of the times of odometry and gyro, seconds, beyond what the motion model allows for; 0 if they are stamped
    /// by the sensor. A robot that moves is elsewhere at another time.
    pub stamp_sigma_s: f64,
    /// Standard deviation of the torso's roll and pitch in this frame, radians, beyond what the motion model allows for; 0 if the
    /// sensor states and stamps its attitude.
    pub tilt_sigma_rad: f64,
}

/// The answer for one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Fix {
    /// Estimate of the particles: `base_footprint` in `map`.
    pub estimate: Estimate,
    /// How much of the line that the best particle predicts is seen.
    pub support: Support,
    /// Pose of the camera: refined, or predicted when nothing could be refined.
    pub map_from_optical: Isometry,
    /// Covariance of that pose: x, y, z (m) and rotation about x, y, z (rad) of `map`.
    pub covariance: Matrix6<f64>,
    /// Whether the pose was refined by lines of this frame.
    pub refined: bool,
    /// Whether lines put the camera farther from where odometry and IMU have it than their errors admit.
    pub contradicts_prediction: bool,
    /// Whether the pose is farther from where the robot was last known to be than it can have come.
    pub strays: bool,
    /// Whether nothing has measured how far the robot walked since the last frame.
    pub lacks_odometry: bool,
    /// Whether the lines of a candidate fit better through another lens, or from a camera where no mount puts it.
    pub misfits: bool,
    /// How well the expected lines are where the pose has them.
    pub agreement: Agreement,
    /// How much of the seen line near the robot the pose explains.
    pub explained: ExplainedLines,
    /// Share of the lines in the picture, at any distance, that are painted where a candidate has them, 0 to 1; 1 if not computed.
    pub explained_in_view: f64,
    /// What the frame has cost.
    pub effort: Effort,
    /// Whether the mirror pose is as likely.
    pub ambiguous: bool,
    /// Why the pose is not to be used; `None` when it is.
    pub rejection: Option<Rejection>,
}

impl Physical for Fix {
    fn is_possible(&self) -> bool {
        let Estimate { best, covariance, spread_m, spread_yaw_rad, effective_sample_size, evidence, .. } =
            &self.estimate;
        self.map_from_optical.is_possible()
            && self.covariance.iter().chain(covariance).all(|value| value.is_finite())
            && best.is_possible()
            && [spread_m, spread_yaw_rad, effective_sample_size, evidence].iter().all(|value| value.is_finite())
            && [self.agreement.rms_px, self.explained.share, self.support.share].iter().all(|value| value.is_finite())
    }
}
