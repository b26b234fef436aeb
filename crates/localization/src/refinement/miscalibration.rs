//! How a lens differs from what its calibration says, and how its sensor is read.

use glam::DVec2;
use serde::{Deserialize, Serialize};

use realitysim_geometry::{Lens, Twist};

/// What of a calibration is wrong, as far as a walk shows it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Miscalibration {
    /// Share by which the focal lengths are longer.
    pub stretch: f64,
    /// Where the axis meets the image, relative to where it is said to, widths of the image.
    pub shift: DVec2,
    /// From the exposure of the first row to that of the last, seconds.
    pub readout_s: f64,
}

/// How fast a walking torso sways, which neither feet nor gyro tell.
pub const UNSEEN_M_PER_S: f64 = 0.15;
/// How fast it rocks, which only a gyro tells, and by which share it turns otherwise than its feet say.
pub(super) const UNFELT_RAD_PER_S: f64 = 0.4;
const UNFELT_SHARE: f64 = 0.3;

impl Miscalibration {
    pub const NONE: Self = Self { stretch: 0.0, shift: DVec2::ZERO, readout_s: 0.0 };

    /// Where the lens really draws what it is said to draw at `pixel`.
    pub fn drawn(&self, lens: &Lens, pixel: DVec2) -> DVec2 {
        pixel + self.stretch * from_centre(lens, pixel) + f64::from(lens.width()) * self.shift
    }

    /// How that changes with stretch and shift: pixels for each unit.
    pub(super) fn gradient(lens: &Lens, pixel: DVec2) -> [DVec2; 3] {
        let width = f64::from(lens.width());
        [from_centre(lens, pixel), width * DVec2::X, width * DVec2::Y]
    }
}

/// How much faster a camera of this twist may turn about each axis without a gyro, radians per second.
pub fn unfelt_rad_per_s(twist: &Twist) -> f64 {
    libm::hypot(UNFELT_RAD_PER_S, UNFELT_SHARE * twist.angular.length())
}

/// When the row of a pixel is exposed, as share of the readout from the middle row.
pub fn row(lens: &Lens, pixel: DVec2) -> f64 {
    (pixel.y + 0.5) / f64::from(lens.height()) - 0.5
}

fn from_centre(lens: &Lens, pixel: DVec2) -> DVec2 {
    pixel - DVec2::new(lens.parameters().cx, lens.parameters().cy)
}
