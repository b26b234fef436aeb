//! A noisy line from the motor controller: odometry, IMU and joint messages are lost, or arrive with a wrong bit.

use serde::Deserialize;

use super::Role;
use crate::SceneError;
use crate::check::within;
use crate::stream::{Purpose, Stream};

/// A driver drops what its checksum refuses; what slips through is in the log as a message with one bit flipped.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SerialNoise {
    pub role: Option<Role>,
    /// Of the messages.
    pub lost_share: f64,
    /// Of those that are left.
    #[serde(default)]
    pub corrupt_share: f64,
}

/// What becomes of one message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum DeliveryOutcome {
    Whole,
    Lost,
    /// With a number that says which bit.
    Corrupt(u64),
}

impl SerialNoise {
    pub(super) fn check(&self, key: &str) -> Result<(), SceneError> {
        within(format_args!("{key}.lost_share"), self.lost_share, 0.0..=0.95, "0 to 0.95 of the messages")?;
        within(format_args!("{key}.corrupt_share"), self.corrupt_share, 0.0..=0.5, "0 to 0.5 of the messages")
    }

    /// `line` tells the senders apart.
    pub(crate) fn fate(&self, seed: u64, line: u64, index: u64) -> DeliveryOutcome {
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
