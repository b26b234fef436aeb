//! Poses while no frames come: odometry carries on what the camera knew last, and they say that they are such.
//!
//! What is carried on here is a copy. A frame goes on from it only after a gap that is too long for one step.

use serde::{Deserialize, Serialize};

use super::tagger::Tagger;
use realitysim_geometry::Physical;
use realitysim_localization::{LocalizerState, Rejection};
use realitysim_log_input::history::KEEP_NS;
use realitysim_log_input::synchroniser::{Frame, StepOrigin, Synchroniser};
use realitysim_ros2::messages::FrameTag;

/// Without a frame for so long (since the last one, since the place was told, or since odometry was first heard), and for
/// so many times as long as from the frame before it to the last one, poses are foreseen.
const GAP_NS: i64 = 1_000_000_000;
const INTERVALS: i64 = 3;
/// And so often.
const EVERY_NS: i64 = 100_000_000;

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DeadReckoning {
    ahead: Option<Propagated>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Propagated {
    since: StepOrigin,
    stamp_ns: i64,
    localizer: LocalizerState,
}

impl Physical for DeadReckoning {
    fn is_possible(&self) -> bool {
        self.ahead.as_ref().is_none_or(|ahead| ahead.localizer.is_possible())
    }
}

impl DeadReckoning {
    /// A frame has come. After a gap longer than measurements are kept for, it counts from the last of the poses that were foreseen:
    /// step by step is known what one long step, of which nobody has the gyro's turns any more, is not.
    pub fn meet(&mut self, frame: &mut Frame, tagger: &mut Tagger, synchroniser: &Synchroniser) {
        let Some(ahead) = self.ahead.take() else { return };
        let is_kept = frame.stamp_ns.saturating_sub(ahead.since.stamp_ns) <= KEEP_NS;
        if Some(ahead.since) == frame.since && ahead.stamp_ns <= frame.stamp_ns && !is_kept {
            frame.robot = synchroniser.robot_between(ahead.stamp_ns, frame.stamp_ns);
            tagger.go_on_from(ahead.localizer);
        }
    }

    /// Where the robot is by now, if that has been foreseen.
    pub fn state(self) -> Option<LocalizerState> {
        self.ahead.map(|ahead| ahead.localizer)
    }

    /// When the next pose is due, if odometry has come that far: the latest of those that are, since who wakes up late
    /// has no use for the others.
    pub fn due(&self, synchroniser: &Synchroniser, log_time_ns: i64) -> Option<i64> {
        let since = synchroniser.since()?;
        // What was foreseen before somebody said where the robot is counts no more.
        let next_ns = match self.ahead.as_ref().filter(|ahead| ahead.since == since) {
            Some(ahead) => ahead.stamp_ns.saturating_add(EVERY_NS),
            None => since.stamp_ns.saturating_add(GAP_NS.max(since.interval_ns.saturating_mul(INTERVALS))),
        };
        // Odometry whose clock has jumped ahead says nothing of the present.
        let passed_ns = log_time_ns.saturating_sub(since.log_time_ns);
        let now_ns = synchroniser.walked_until_ns()?.min(since.stamp_ns.saturating_add(passed_ns));
        let late_ns = now_ns.checked_sub(next_ns)?;
        (late_ns >= 0).then(|| next_ns.saturating_add(late_ns / EVERY_NS * EVERY_NS))
    }

    /// Where odometry has the camera; `None` if it was not known where the robot was, or is not any more.
    pub fn look(&mut self, stamp_ns: i64, tagger: &mut Tagger, synchroniser: &Synchroniser) -> Option<FrameTag> {
        let since = synchroniser.since()?;
        self.ahead = self.ahead.take().filter(|ahead| ahead.since == since);
        let robot = match &self.ahead {
            Some(ahead) => synchroniser.robot_between(ahead.stamp_ns, stamp_ns),
            None => synchroniser.robot_next(stamp_ns),
        };
        // What happens until it is known again is one step.
        robot.place.as_ref().ok()?;
        let ahead = self.ahead.get_or_insert_with(|| Propagated { since, stamp_ns, localizer: tagger.state() });
        ahead.stamp_ns = stamp_ns;
        tagger.foresee(stamp_ns, &robot, &mut ahead.localizer, Rejection::NoFrame)
    }
}
