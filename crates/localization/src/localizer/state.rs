//! Everything that the next frame depends on.

use serde::{Deserialize, Serialize};

use super::CandidateRefinement;
use crate::fall_detection::FallDetector;
use crate::filter::FilterState;
use crate::frozen_image::FrozenImageDetector;
use crate::global_search::SearchState;
use crate::last_known_pose::LastKnownPose;
use crate::slow_states::SlowStateFilter;
use crate::validation::PoseValidator;
use realitysim_geometry::{Physical, Pose2};

/// Everything that the next frame depends on; a checkpoint keeps it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LocalizerState {
    /// State of the particle filter.
    pub filter: FilterState,
    /// Pose and slow states that refinement follows, called the track; `None` before the first pose.
    pub track: Option<SlowStateFilter>,
    /// Time (ns) and odometry that the next step is measured from: those of the last frame, or later ones.
    pub last: Option<(i64, Option<Pose2>)>,
    /// What the frames so far say about the pose.
    pub validator: PoseValidator,
    /// Follows the robot through falls.
    pub posture: FallDetector,
    /// Recognises a camera that repeats its picture.
    pub frozen: FrozenImageDetector,
    /// Time for which nothing has measured how far the robot walked, seconds.
    pub odometry_gap_s: f64,
    /// The last pose that was known, carried on since then.
    pub known: Option<LastKnownPose>,
    /// Search of the field under way.
    pub search: SearchState,
    /// Candidates of the last search that are being refined.
    pub fitting: CandidateRefinement,
    /// Whether the mirror pose is as likely: the pose was found without knowing which half of the field the robot is in.
    pub ambiguous: bool,
}

impl Physical for LocalizerState {
    fn is_possible(&self) -> bool {
        let Self {
            filter,
            track,
            last,
            validator,
            posture: _,
            frozen,
            odometry_gap_s,
            known,
            search,
            fitting,
            ambiguous: _,
        } = self;
        let odometry = last.and_then(|(_, odometry)| odometry);
        (filter.particles.is_possible() && track.is_possible() && odometry.is_possible())
            && (validator.is_possible() && frozen.is_possible() && odometry_gap_s.is_possible())
            && (known.is_possible() && search.is_possible() && fitting.is_possible())
    }
}
