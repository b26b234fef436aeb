//! `[views]`: how the images of a database are chosen for a view.

use serde::{Deserialize, Serialize};

use super::check_range;

/// How images of a database are chosen for a view, and when a stored image is the view itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ViewsSettings {
    /// Largest number of images that make a view.
    pub sources: usize,
    /// Greatest distance at which a stored image of the lens and size asked for is itself the view, metres. Its angle must be within
    /// 0.25 degrees.
    pub stored_within_m: f64,
    /// Whether the goals of the field file were on the field when the images were taken.
    pub goals: bool,
    /// Whether robots, people and balls on the carpet of a recorded image are left out of views.
    pub mask_moving: bool,
    /// Memory for decoded images, MiB.
    pub cache_mb: u64,
}

impl ViewsSettings {
    pub(super) fn check(&self) -> Result<(), String> {
        check_range("views.sources", self.sources as f64, 1.0, 16.0)?;
        check_range("views.stored_within_m", self.stored_within_m, 0.0, 1.0)?;
        check_range("views.cache_mb", self.cache_mb as f64, 1.0, 65_536.0)
    }
}

impl Default for ViewsSettings {
    fn default() -> Self {
        Self { sources: 4, stored_within_m: 0.005, goals: true, mask_moving: true, cache_mb: 512 }
    }
}
