//! Names and numbers of the landmarks that have boxes.

use crate::LandmarkKind;

/// Names of the classes, and which of them each kind of landmark has.
#[derive(Clone, Copy, Debug)]
pub struct ClassList {
    /// Names, in the order of their numbers.
    pub names: &'static [&'static str],
    of: fn(LandmarkKind) -> Option<usize>,
}

impl ClassList {
    /// The number of a landmark's class; `None` if it has no box.
    pub fn class(&self, kind: LandmarkKind) -> Option<usize> {
        (self.of)(kind)
    }
}

/// A class for each kind of landmark that has boxes.
pub const LANDMARK_CLASSES: ClassList = ClassList {
    names: &["l_crossing", "t_crossing", "x_crossing", "penalty_mark", "centre", "goalpost"],
    of: |kind| match kind {
        LandmarkKind::LCrossing => Some(0),
        LandmarkKind::TCrossing => Some(1),
        LandmarkKind::XCrossing => Some(2),
        LandmarkKind::PenaltyMark => Some(3),
        LandmarkKind::Centre => Some(4),
        LandmarkKind::PostFoot => Some(5),
        LandmarkKind::PostTop => None,
    },
};

/// The classes of Booster's RoboCup demo (<https://github.com/BoosterRobotics/robocup_demo>). What has no place on a field, such as a
/// ball, has no labels.
pub const BOOSTER_CLASSES: ClassList = ClassList {
    names: &["Ball", "Goalpost", "Person", "LCross", "TCross", "XCross", "PenaltyPoint", "Opponent", "BRMarker"],
    of: |kind| match kind {
        LandmarkKind::LCrossing => Some(3),
        LandmarkKind::TCrossing => Some(4),
        LandmarkKind::XCrossing => Some(5),
        LandmarkKind::PenaltyMark => Some(6),
        LandmarkKind::PostFoot => Some(1),
        LandmarkKind::Centre | LandmarkKind::PostTop => None,
    },
};
