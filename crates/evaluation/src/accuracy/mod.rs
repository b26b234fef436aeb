//! How accurate the tags of one robot are on one field, without any alignment.
//!
//! [`mod@taped`] compares tags with crossings of the field that the robot stood on, [`mod@turned`] those of opposite headings with each
//! other: both need a tape measure and no other truth. [`mod@split_half`] fits the walk from two halves of its line evidence, and
//! [`mod@residual_maps`] shows where in the image and on the field lines lie off: both need nothing but the capture. [`verdict`] says
//! for which use the figures are good enough, and [`validation`] how well each measure predicts the true error of rendered walks.
//!
//! The point of the robot that stands on a crossing is the origin of `base_footprint`: the point between the feet. It follows from
//! a tag by [`footprint`].

pub mod crossings;
pub mod residual_maps;
pub mod split_half;
pub mod stands;
pub mod taped;
pub mod turned;
pub mod validation;
pub mod verdict;

use serde::Serialize;

use realitysim_geometry::{Isometry, Pose2};

pub use crossings::{Crossing, crossings};
pub use residual_maps::{ResidualMaps, residual_maps};
pub use split_half::{Halving, SplitHalf, split_half};
pub use stands::{Refused, SeenFrame, Stand, stands};
pub use taped::{Offset, StandError, Taped, taped};
pub use turned::{Turned, turned};
pub use verdict::{Limits, Use, verdicts};

/// A measure, or why the data do not allow it.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Measure<T> {
    /// What was measured.
    Known(T),
    /// The data do not allow it.
    Missing {
        /// What is missing, and what would mend it.
        missing: String,
    },
}

impl<T> Measure<T> {
    /// The measure that the data do not allow.
    pub fn missing(why: impl Into<String>) -> Self {
        Self::Missing { missing: why.into() }
    }

    /// What was measured, if it was.
    pub fn known(&self) -> Option<&T> {
        match self {
            Self::Known(known) => Some(known),
            Self::Missing { .. } => None,
        }
    }
}

/// The pose of `base_footprint` in `map` that a tag says.
///
/// Position and heading of the camera are those of the tag. From the mount, its joints and the IMU only the horizontal lever arm and the
/// heading of the camera on the robot are used: an error of the camera's tilt moves this point by the sine of the tilt times the lever
/// arm, not times the camera's height.
pub fn footprint(map_from_link: &Isometry, footprint_from_link: &Isometry) -> Pose2 {
    Pose2::from_isometry(map_from_link).compose(&Pose2::from_isometry(footprint_from_link).inverse())
}

#[cfg(test)]
mod tests;
