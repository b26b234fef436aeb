//! Follows odometry between two sessions of one agent, while nothing is recorded.

use super::dead_reckoning::DeadReckoning;
use super::tagger::Tagger;
use super::warm_start::WarmState;
use realitysim_config::Topics;
use realitysim_log_input::{FrameAssembler, measurement};
use realitysim_ros2::mcap_read::LogMessage;

/// The parts of a paused pipeline that keep track of the robot by odometry alone.
pub struct IdleOdometry {
    pub(super) topics: Topics,
    pub(super) assembler: FrameAssembler,
    pub(super) tagger: Tagger,
    pub(super) dead_reckoning: DeadReckoning,
}

impl IdleOdometry {
    /// Takes a message in the order of arrival. Frames and messages that do not decode are ignored.
    pub fn take(&mut self, message: &LogMessage) {
        if measurement::is_frame(&message.channel, &self.topics) {
            return;
        }
        self.assembler.take(message);
        let synchroniser = &self.assembler.synchroniser;
        if let Some(stamp_ns) = self.dead_reckoning.next_due_ns(synchroniser, message.log_time_ns) {
            self.dead_reckoning.predict(stamp_ns, &mut self.tagger, synchroniser);
        }
    }

    /// The state that the next session starts from.
    pub fn kept(self) -> WarmState {
        WarmState::new(self.dead_reckoning, self.tagger.state(), self.assembler.synchroniser.state())
    }
}
