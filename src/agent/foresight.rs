//! Poses while no frames come: odometry carries on what the camera knew last, and they say that they are such.
//!
//! Frames know nothing of it: what is carried on here is a copy, thrown away when the next frame comes.

use serde::{Deserialize, Serialize};

use super::tagger::Tagger;
use crate::localization::LocalizerState;
use crate::ros2::messages::FrameTag;
use crate::sensors::synchroniser::Synchroniser;

/// In `reason` of a tag that belongs to no frame.
pub const NO_FRAME: &str = "no_frame";
/// Without a frame for so long, poses are foreseen: a camera that stalls is given up then, too.
const GAP_NS: i64 = 1_000_000_000;
/// And so often.
const EVERY_NS: i64 = 100_000_000;

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Foresight {
    ahead: Option<Ahead>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Ahead {
    stamp_ns: i64,
    localizer: LocalizerState,
}

impl Foresight {
    /// A frame has come: it knows better.
    pub fn forget(&mut self) {
        self.ahead = None;
    }

    /// When the next pose is due, if odometry has come that far: the latest of those that are, since who wakes up late
    /// has no use for the others.
    pub fn due(&self, synchroniser: &Synchroniser) -> Option<i64> {
        let next_ns = match &self.ahead {
            Some(ahead) => ahead.stamp_ns.saturating_add(EVERY_NS),
            None => synchroniser.last_frame_ns()?.saturating_add(GAP_NS),
        };
        let late_ns = synchroniser.odometry_settled_ns()?.checked_sub(next_ns)?;
        (late_ns >= 0).then(|| next_ns.saturating_add(late_ns / EVERY_NS * EVERY_NS))
    }

    /// Where odometry has the camera; `None` if it was not known where the robot was, or is not any more.
    pub fn look(&mut self, stamp_ns: i64, tagger: &mut Tagger, synchroniser: &Synchroniser) -> Option<FrameTag> {
        let last_frame_ns = synchroniser.last_frame_ns()?;
        let ahead = self.ahead.get_or_insert_with(|| Ahead { stamp_ns: last_frame_ns, localizer: tagger.state() });
        let since_ns = core::mem::replace(&mut ahead.stamp_ns, stamp_ns);
        let robot = synchroniser.robot_between(since_ns, stamp_ns);
        tagger.foresee(stamp_ns, &robot, &mut ahead.localizer, NO_FRAME)
    }
}
