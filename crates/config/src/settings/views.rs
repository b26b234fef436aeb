//! `[views]`: which images of a database make a view.

use serde::{Deserialize, Serialize};

use super::within;

/// How images of a database are chosen for a view, and when one is the answer itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ViewsSettings {
    /// At most so many images make a view.
    pub sources: usize,
    /// A stored image this near is given out as it is, if lens and size are those asked for ...
    pub stored_within_m: f64,
    /// ... and it looks the same way up to this angle.
    pub stored_within_deg: f64,
    /// What a metre counts when the nearest images are looked for ...
    pub metre_counts: f64,
    /// ... a radian between viewing directions ...
    pub direction_counts: f64,
    /// ... and a radian of roll.
    pub roll_counts: f64,
    /// Whether the goals of the field file stood there when the images were taken.
    pub goals: bool,
    /// Whether robots, people and balls on the carpet of a recorded image are left out of views.
    pub mask_moving: bool,
    /// Memory for decoded images.
    pub cache_mb: u64,
}

impl ViewsSettings {
    pub(super) fn check(&self) -> Result<(), String> {
        within("views.sources", self.sources as f64, 1.0, 16.0)?;
        within("views.stored_within_m", self.stored_within_m, 0.0, 1.0)?;
        within("views.stored_within_deg", self.stored_within_deg, 0.0, 10.0)?;
        within("views.metre_counts", self.metre_counts, 0.001, 1000.0)?;
        within("views.direction_counts", self.direction_counts, 0.0, 1000.0)?;
        within("views.roll_counts", self.roll_counts, 0.0, 1000.0)?;
        within("views.cache_mb", self.cache_mb as f64, 1.0, 65_536.0)
    }
}

impl Default for ViewsSettings {
    fn default() -> Self {
        Self {
            sources: 4,
            stored_within_m: 0.005,
            stored_within_deg: 0.25,
            metre_counts: 1.0,
            direction_counts: 0.5,
            roll_counts: 0.3,
            goals: true,
            mask_moving: true,
            cache_mb: 512,
        }
    }
}
