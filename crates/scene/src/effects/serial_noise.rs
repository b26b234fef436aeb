//! A noisy serial line from the motor controller: odometry, IMU and joint messages are lost or have a flipped bit.

use serde::Deserialize;

use super::{EffectKind, NEEDS_ODOMETRY_OR_IMU, Role, require};
use crate::SceneError;
use crate::check::check_range;
use crate::file::SceneFile;
use crate::per_frame::Changing;
use crate::stream::{Purpose, Stream};
use realitysim_geometry::Field;

/// Losses on the serial line. The driver drops messages whose checksum is wrong, and lets some corrupt ones through.
///
/// A corrupt message is in the log with one bit flipped.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SerialNoise {
    /// Why the scene has this effect, for people.
    pub role: Option<Role>,
    /// Share of the messages that are lost.
    pub lost_share: f64,
    /// Share of the remaining messages that are corrupt.
    #[serde(default)]
    pub corrupt_share: f64,
}

/// The fate of one message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum DeliveryOutcome {
    Whole,
    Lost,
    /// One bit is flipped. The number selects the bit.
    Corrupt(u64),
}

impl EffectKind for SerialNoise {
    fn role(&self) -> Option<Role> {
        self.role
    }

    fn check(&self, key: &str, _: &Field) -> Result<(), SceneError> {
        check_range(format_args!("{key}.lost_share"), self.lost_share, 0.0..=0.95, "0 to 0.95 of the messages")?;
        check_range(format_args!("{key}.corrupt_share"), self.corrupt_share, 0.0..=0.5, "0 to 0.5 of the messages")
    }

    fn lacks(&self) -> Option<&'static str> {
        (self.lost_share == 0.0 && self.corrupt_share == 0.0).then_some("lost_share or corrupt_share above 0")
    }

    fn needs(&self, file: &SceneFile) -> Result<(), &'static str> {
        require(file.odometry.is_some() || file.imu.is_some(), NEEDS_ODOMETRY_OR_IMU)
    }

    fn set_in(&self, changing: &mut Changing, _: u64) {
        changing.serial_noise = Some(self.clone());
    }
}

impl SerialNoise {
    /// Draws what happens to message `index` of the sender `line`.
    pub(crate) fn delivery_outcome(&self, seed: u64, line: u64, index: u64) -> DeliveryOutcome {
        let mut stream = Stream::new(seed, Purpose::SerialNoise, line << 48 | index);
        if stream.uniform() < self.lost_share {
            DeliveryOutcome::Lost
        } else if stream.uniform() < self.corrupt_share {
            DeliveryOutcome::Corrupt(stream.next_u64())
        } else {
            DeliveryOutcome::Whole
        }
    }
}
