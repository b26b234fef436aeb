//! Choice of the observation model that the filter weighs poses with.

use serde::{Deserialize, Serialize};

/// What a line point is judged by. See [`observation`](crate::observation).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Model {
    /// Line contrast (corrected) or blurred gray (as printed): Eq. 2 of the paper.
    #[default]
    Gauss,
    /// Distance to the nearest white place: Eq. 1 of the paper.
    Distance,
}

/// Which form of the model's sum is used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Formula {
    /// The corrected sum, to which points that nobody could see add nothing.
    #[default]
    Corrected,
    /// The sum as the paper prints it.
    Paper,
}
