//! Between two sessions of one agent: nothing is recorded, and odometry goes on saying where the robot is.

use super::dead_reckoning::DeadReckoning;
use super::tagger::Tagger;
use super::warm_start::WarmState;
use realitysim_config::{HeadSettings, Topics};
use realitysim_log_input::measurement;
use realitysim_log_input::synchroniser::Synchroniser;
use realitysim_ros2::mcap_read::LogMessage;

/// Steps as they come, no frames.
pub struct IdleOdometry {
    pub(super) topics: Topics,
    pub(super) head: HeadSettings,
    pub(super) synchroniser: Synchroniser,
    pub(super) tagger: Tagger,
    pub(super) foresight: DeadReckoning,
}

impl IdleOdometry {
    pub fn take(&mut self, message: &LogMessage) {
        if measurement::is_frame(&message.channel, &self.topics) {
            return;
        }
        let Ok(input) = measurement::read(message, &self.topics, &self.head) else { return };
        self.synchroniser.push(message, input);
        if let Some(stamp_ns) = self.foresight.due(&self.synchroniser, message.log_time_ns) {
            self.foresight.look(stamp_ns, &mut self.tagger, &self.synchroniser);
        }
    }

    /// Where the next session goes on.
    pub fn kept(self) -> WarmState {
        WarmState::new(self.foresight, self.tagger.state(), self.synchroniser.state())
    }
}
