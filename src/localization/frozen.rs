//! A camera that repeats its last picture, with new stamps, while the robot moves.

use serde::{Deserialize, Serialize};

use super::localizer::Moment;
use crate::geometry::{Pose2, wrap_angle};

/// The last picture that was another one than that before it, and what has happened since.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Frozen {
    fingerprint: Option<u64>,
    odometry: Option<Pose2>,
    turned_rad: f64,
    swayed_rad: f64,
}

/// Less moves no line by as much as the camera's own noise changes the picture. A torso that stands sways by a tenth of a degree.
const MOVED_M: f64 = 0.01;
const TURNED_RAD: f64 = 0.01;
const SWAYED_RAD: f64 = 0.02;

impl Frozen {
    /// Whether this picture cannot be of this moment.
    pub fn judge(&mut self, moment: &Moment, fingerprint: u64) -> bool {
        if self.fingerprint != Some(fingerprint) {
            let odometry = moment.odometry;
            *self = Self { fingerprint: Some(fingerprint), odometry, ..Self::default() };
            return false;
        }
        self.turned_rad += moment.turned_rad.unwrap_or(0.0);
        self.swayed_rad += moment.swayed_rad.unwrap_or(0.0);
        let walked = self.odometry.zip(moment.odometry).is_some_and(|(then, now)| {
            then.distance(&now) > MOVED_M || wrap_angle(then.yaw - now.yaw).abs() > TURNED_RAD
        });
        walked || self.turned_rad.abs() > TURNED_RAD || self.swayed_rad > SWAYED_RAD
    }
}
