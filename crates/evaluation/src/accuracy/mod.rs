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

use realitysim_geometry::{Isometry, Pose2, wrap_angle};

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
    let yaw = wrap_angle(map_from_link.euler().yaw - footprint_from_link.euler().yaw);
    let arm = footprint_from_link.translation;
    let camera = map_from_link.translation;
    let turned = Pose2::new(0.0, 0.0, yaw).compose(&Pose2::new(arm.x, arm.y, 0.0));
    Pose2::new(camera.x - turned.x, camera.y - turned.y, yaw)
}

/// Root mean square; 0 of nothing.
fn rms(values: impl IntoIterator<Item = f64>) -> f64 {
    let (sum, count) = values.into_iter().fold((0.0, 0usize), |(sum, count), value| (sum + value * value, count + 1));
    libm::sqrt(sum / count.max(1) as f64)
}

#[cfg(test)]
mod tests;
