//! Tracking state: how far lines have confirmed the pose, as a state machine that makes one step per frame.

use serde::{Deserialize, Serialize};

/// How far lines have confirmed the pose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum TrackingState {
    /// It is not known where the robot is: the whole field is searched.
    #[default]
    Lost,
    /// There is a pose, which must be confirmed before it is used.
    Candidate {
        /// Number of frames that must still confirm the pose.
        missing: u32,
    },
    /// The pose is confirmed. It is not used while there are contradictions.
    Tracking {
        /// Number of frames whose lines contradicted the pose, less those that have agreed since.
        contradictions: u32,
    },
}

/// What one frame says about the pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameVerdict {
    /// The pose has become too uncertain to be of use.
    Uncertain,
    /// The frame's lines, or the camera's height and tilt, speak against the pose.
    Contradicts,
    /// The frame is rejected for a reason that says nothing for or against the pose.
    Silent,
    /// The frame is accepted, but what it shows does not confirm a candidate.
    Unconvincing {
        /// Whether the frame had enough lines to confirm the pose, so that it counts against it.
        against: bool,
    },
    /// The frame is accepted, but lines and odometry show different motions.
    Surprises {
        /// Number of frames that a candidate needs from now on.
        needed: u32,
    },
    /// The frame is accepted, and confirms a candidate.
    Agrees {
        /// Number of frames that it counts for.
        frames: u32,
    },
}

impl TrackingState {
    /// The state after a frame.
    ///
    /// | | `Lost` | `Candidate { missing }` | `Tracking { contradictions }` |
    /// | --- | --- | --- | --- |
    /// | `Uncertain` | `Lost` | `Lost` | `Lost` |
    /// | `Contradicts` | `Lost` | `Lost` | one contradiction more |
    /// | `Silent` | `Lost` | unchanged | unchanged |
    /// | `Unconvincing` | `Lost` | one more is missing, if it speaks against the pose | one contradiction less |
    /// | `Surprises` | `Lost` | as many as `needed` are missing | one contradiction less |
    /// | `Agrees` | `Lost` | fewer are missing; with none, `Tracking` | one contradiction less |
    pub fn after(self, verdict: FrameVerdict) -> Self {
        match (self, verdict) {
            (_, FrameVerdict::Uncertain) | (Self::Lost, _) => Self::Lost,
            (Self::Candidate { .. }, FrameVerdict::Contradicts) => Self::Lost,
            (Self::Candidate { missing }, FrameVerdict::Unconvincing { against }) => {
                Self::Candidate { missing: missing.saturating_add(u32::from(against)) }
            }
            (Self::Candidate { .. }, FrameVerdict::Surprises { needed }) => Self::Candidate { missing: needed },
            (Self::Candidate { missing }, FrameVerdict::Agrees { frames }) => match missing.saturating_sub(frames) {
                0 => Self::Tracking { contradictions: 0 },
                missing => Self::Candidate { missing },
            },
            (Self::Tracking { contradictions }, FrameVerdict::Contradicts) => {
                Self::Tracking { contradictions: contradictions.saturating_add(1) }
            }
            (same, FrameVerdict::Silent) => same,
            (Self::Tracking { contradictions }, _) => {
                Self::Tracking { contradictions: contradictions.saturating_sub(1) }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::FrameVerdict::{Agrees, Contradicts, Silent, Surprises, Uncertain, Unconvincing};
    use super::TrackingState::{Candidate, Lost, Tracking};

    #[test]
    fn every_transition_is_that_of_the_table() {
        let (candidate, tracking, doubted) =
            (Candidate { missing: 3 }, Tracking { contradictions: 0 }, Tracking { contradictions: 2 });
        let (against, neutral) = (Unconvincing { against: true }, Unconvincing { against: false });
        let (less, more) = (Tracking { contradictions: 1 }, Tracking { contradictions: 3 });
        let table = [
            (Lost, [Uncertain, Contradicts, Silent, against, Surprises { needed: 5 }, Agrees { frames: 9 }], [Lost; 6]),
            (
                candidate,
                [Uncertain, Contradicts, Silent, against, Surprises { needed: 5 }, Agrees { frames: 1 }],
                [Lost, Lost, candidate, Candidate { missing: 4 }, Candidate { missing: 5 }, Candidate { missing: 2 }],
            ),
            (
                candidate,
                [
                    neutral,
                    Agrees { frames: 0 },
                    Agrees { frames: 2 },
                    Agrees { frames: 3 },
                    Agrees { frames: 9 },
                    Silent,
                ],
                [candidate, candidate, Candidate { missing: 1 }, tracking, tracking, candidate],
            ),
            (
                doubted,
                [Uncertain, Contradicts, Silent, against, Surprises { needed: 5 }, Agrees { frames: 1 }],
                [Lost, more, doubted, less, less, less],
            ),
            (
                tracking,
                [Uncertain, Contradicts, Silent, against, Surprises { needed: 5 }, Agrees { frames: 1 }],
                [Lost, less, tracking, tracking, tracking, tracking],
            ),
        ];
        for (state, verdicts, after) in table {
            for (verdict, expected) in verdicts.into_iter().zip(after) {
                assert_eq!(state.after(verdict), expected, "{state:?} {verdict:?}");
            }
        }
    }

    #[test]
    fn counters_stay_within_their_range() {
        let most = Tracking { contradictions: u32::MAX };
        assert_eq!(most.after(Contradicts), most);
        assert_eq!(
            Candidate { missing: u32::MAX }.after(Unconvincing { against: true }),
            Candidate { missing: u32::MAX }
        );
    }
}
