//! Reasons for which a frame's pose is not to be used.

use core::fmt;

use serde::{Serialize, Serializer};

/// The reason that makes a tag invalid. docs/reference/formats.md has them in words.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Rejection {
    /// The robot has not been found, and nobody has said where it is.
    PoseUnknown,
    /// The pose was found, announced or restored, and too few frames have confirmed it.
    Unconfirmed,
    /// A measurement that is used is too old.
    SensorsStale,
    /// There is no odometry for this time.
    NoOdometry,
    /// No lines have agreed with the pose for too long.
    FewLines,
    /// Lines are missing, or lie elsewhere than the pose has them.
    LinesDisagree,
    /// Lines are seen that the field does not have where the pose puts them.
    LinesUnexplained,
    /// The torso leans as that of a robot that lies or falls.
    Fallen,
    /// The lines put the camera higher, lower or more tilted than that of a standing robot.
    NotStanding,
    /// The pose is too uncertain along one direction.
    Spread,
    /// The pose is beyond the carpet.
    OffField,
    /// No particle has a usable weight.
    DegenerateWeights,
    /// A number was not finite: the filter has begun anew.
    NumericalFault,
    /// The picture is black.
    TooDark,
    /// More than half of what is lit is white.
    Overexposed,
    /// The same picture came again although the robot moved.
    ImageFrozen,
    /// The image does not decode.
    ImageBroken,
    /// The image is not of the lens's size.
    ImageSize,
    /// There is no image: odometry alone says where the camera is.
    NoFrame,
    /// No chain of transforms leads from `base_footprint` to the camera.
    NoTransform,
}

impl Rejection {
    /// All reasons.
    pub const ALL: [Self; 20] = [
        Self::PoseUnknown,
        Self::Unconfirmed,
        Self::SensorsStale,
        Self::NoOdometry,
        Self::FewLines,
        Self::LinesDisagree,
        Self::LinesUnexplained,
        Self::Fallen,
        Self::NotStanding,
        Self::Spread,
        Self::OffField,
        Self::DegenerateWeights,
        Self::NumericalFault,
        Self::TooDark,
        Self::Overexposed,
        Self::ImageFrozen,
        Self::ImageBroken,
        Self::ImageSize,
        Self::NoFrame,
        Self::NoTransform,
    ];

    /// The word that stands for this rejection in `reason` of a tag.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::PoseUnknown => "pose_unknown",
            Self::Unconfirmed => "unconfirmed",
            Self::SensorsStale => "sensors_stale",
            Self::NoOdometry => "no_odometry",
            Self::FewLines => "few_lines",
            Self::LinesDisagree => "lines_disagree",
            Self::LinesUnexplained => "lines_unexplained",
            Self::Fallen => "fallen",
            Self::NotStanding => "not_standing",
            Self::Spread => "spread",
            Self::OffField => "off_field",
            Self::DegenerateWeights => "degenerate_weights",
            Self::NumericalFault => "numerical_fault",
            Self::TooDark => "too_dark",
            Self::Overexposed => "overexposed",
            Self::ImageFrozen => "image_frozen",
            Self::ImageBroken => "image_broken",
            Self::ImageSize => "image_size",
            Self::NoFrame => "no_frame",
            Self::NoTransform => "no_transform",
        }
    }

    /// The rejection that a tag's `reason` names. `None` for a valid tag, whose reason is empty, and for a word of another version.
    pub fn from_reason(reason: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|rejection| rejection.as_str() == reason)
    }
}

impl fmt::Display for Rejection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl Serialize for Rejection {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.as_str())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_reason_names_its_rejection() {
        for rejection in Rejection::ALL {
            assert_eq!(Rejection::from_reason(rejection.as_str()), Some(rejection));
        }
        assert_eq!(Rejection::from_reason(""), None);
    }
}
