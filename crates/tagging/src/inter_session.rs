//! Follows odometry between two sessions of one agent, while nothing is recorded.

use super::dead_reckoning::DeadReckoning;
use super::tagger::Tagger;
use super::warm_start::WarmState;
use realitysim_config::{HeadSettings, Topics};
use realitysim_log_input::measurement;
use realitysim_log_input::synchroniser::Synchroniser;
use realitysim_ros2::mcap_read::LogMessage;

/// The parts of a paused pipeline that keep track of the robot by odometry alone.
pub struct IdleOdometry {
    pub(super) topics: Topics,
    pub(super) head: HeadSettings,
    pub(super) synchroniser: Synchroniser,
    pub(super) tagger: Tagger,
    pub(super) dead_reckoning: DeadReckoning,
}

impl IdleOdometry {
    /// Takes a message in the order of arrival. Frames and messages that do not decode are ignored.
    pub fn take(&mut self, message: &LogMessage) {
        if measurement::is_frame(&message.channel, &self.topics) {
            return;
        }
        let Ok(input) = measurement::read(message, &self.topics, &self.head) else { return };
        self.synchroniser.push(message, input);
        if let Some(stamp_ns) = self.dead_reckoning.next_due_ns(&self.synchroniser, message.log_time_ns) {
            self.dead_reckoning.predict(stamp_ns, &mut self.tagger, &self.synchroniser);
        }
    }

    /// The state that the next session starts from.
    pub fn kept(self) -> WarmState {
        WarmState::new(self.dead_reckoning, self.tagger.state(), self.synchroniser.state())
    }
}
