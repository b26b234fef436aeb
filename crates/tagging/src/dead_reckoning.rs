//! Dead reckoning: poses predicted from odometry while no frame comes.
//!
//! A copy of the localizer's state is propagated; the tagger itself waits for the next frame. A frame continues from the
//! copy only after a gap that is too long for one step.

use serde::{Deserialize, Serialize};

use super::tagger::Tagger;
use realitysim_geometry::Physical;
use realitysim_localization::{LocalizerState, Rejection};
use realitysim_log_input::history::KEEP_NS;
use realitysim_log_input::synchroniser::{Frame, StepOrigin, Synchroniser};
use realitysim_ros2::messages::FrameTag;

/// Shortest time without a frame before poses are predicted. It counts from the last frame, from the announcement of a
/// pose, or from the first odometry.
const GAP_NS: i64 = 1_000_000_000;
/// The time without a frame must also be this many intervals between the last two frames.
const INTERVALS: i64 = 3;
/// Time between two predicted poses.
const EVERY_NS: i64 = 100_000_000;

/// Predicts poses while no frame comes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DeadReckoning {
    ahead: Option<Propagated>,
}

/// A propagated copy of the localizer's state.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Propagated {
    /// Where the gap began; a different origin makes the copy obsolete.
    since: StepOrigin,
    /// Time that the copy has been propagated to.
    stamp_ns: i64,
    localizer: LocalizerState,
}

impl Physical for DeadReckoning {
    fn is_possible(&self) -> bool {
        self.ahead.as_ref().is_none_or(|ahead| ahead.localizer.is_possible())
    }
}

impl DeadReckoning {
    /// Ends the prediction because a frame has come.
    ///
    /// After a gap longer than measurements are kept for ([`KEEP_NS`]), the frame's step starts at the last predicted
    /// pose: the prediction used the gyro step by step, and the measurements for one long step are gone.
    pub fn end_with(&mut self, frame: &mut Frame, tagger: &mut Tagger, synchroniser: &Synchroniser) {
        let Some(ahead) = self.ahead.take() else { return };
        let is_kept = frame.stamp_ns.saturating_sub(ahead.since.stamp_ns) <= KEEP_NS;
        if Some(ahead.since) == frame.since && ahead.stamp_ns <= frame.stamp_ns && !is_kept {
            frame.robot = synchroniser.robot_between(ahead.stamp_ns, frame.stamp_ns);
            tagger.go_on_from(ahead.localizer);
        }
    }

    /// The propagated state of the localizer, if poses are being predicted.
    pub fn state(self) -> Option<LocalizerState> {
        self.ahead.map(|ahead| ahead.localizer)
    }

    /// The time of the next predicted pose, nanoseconds, if it is due and odometry reaches it. If several are due, it is
    /// the latest.
    pub fn next_due_ns(&self, synchroniser: &Synchroniser, log_time_ns: i64) -> Option<i64> {
        let since = synchroniser.since()?;
        // An announced pose makes earlier predictions obsolete.
        let next_ns = match self.ahead.as_ref().filter(|ahead| ahead.since == since) {
            Some(ahead) => ahead.stamp_ns.saturating_add(EVERY_NS),
            None => since.stamp_ns.saturating_add(GAP_NS.max(since.interval_ns.saturating_mul(INTERVALS))),
        };
        // Odometry whose clock has jumped ahead is not used beyond the present.
        let passed_ns = log_time_ns.saturating_sub(since.log_time_ns);
        let now_ns = synchroniser.walked_until_ns()?.min(since.stamp_ns.saturating_add(passed_ns));
        let late_ns = now_ns.checked_sub(next_ns)?;
        (late_ns >= 0).then(|| next_ns.saturating_add(late_ns / EVERY_NS * EVERY_NS))
    }

    /// Predicts the pose at `stamp_ns` as an invalid tag with reason [`Rejection::NoFrame`]. `None` if the robot's pose
    /// was not known, or is not known well enough any more.
    pub fn predict(&mut self, stamp_ns: i64, tagger: &mut Tagger, synchroniser: &Synchroniser) -> Option<FrameTag> {
        let since = synchroniser.since()?;
        self.ahead = self.ahead.take().filter(|ahead| ahead.since == since);
        let robot = match &self.ahead {
            Some(ahead) => synchroniser.robot_between(ahead.stamp_ns, stamp_ns),
            None => synchroniser.robot_next(stamp_ns),
        };
        // While the camera's place on the robot is unknown nothing is propagated: the time until it is known is one step.
        robot.place.as_ref().ok()?;
        let ahead = self.ahead.get_or_insert_with(|| Propagated { since, stamp_ns, localizer: tagger.state() });
        ahead.stamp_ns = stamp_ns;
        tagger.predict_ahead(stamp_ns, &robot, &mut ahead.localizer, Rejection::NoFrame)
    }
}
