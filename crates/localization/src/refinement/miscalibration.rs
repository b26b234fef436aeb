//! Errors of a lens calibration, and the readout time of a rolling shutter.

use glam::DVec2;
use serde::{Deserialize, Serialize};

use realitysim_geometry::{Lens, Twist};

/// Errors of a calibration that a walk reveals.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Miscalibration {
    /// Relative error of the focal lengths: positive if they are longer than calibrated.
    pub stretch: f64,
    /// Shift of the principal point from its calibrated place, widths of the image.
    pub shift: DVec2,
    /// Time from the exposure of the first row to that of the last, seconds.
    pub readout_s: f64,
}

/// Standard deviation of the speed at which a walking torso sways, which neither feet nor gyro measure.
pub const UNSEEN_M_PER_S: f64 = 0.15;
/// Standard deviation of the rate at which the torso rocks, which only a gyro measures: a constant part ...
pub(super) const UNMEASURED_RAD_PER_S: f64 = 0.4;
/// ... and a share of the rate that the feet tell.
const UNMEASURED_SHARE: f64 = 0.3;

impl Miscalibration {
    /// A perfect calibration of a global shutter.
    pub const NONE: Self = Self { stretch: 0.0, shift: DVec2::ZERO, readout_s: 0.0 };

    /// The pixel at which the lens really draws what the calibration puts at `pixel`.
    pub fn drawn(&self, lens: &Lens, pixel: DVec2) -> DVec2 {
        pixel + self.stretch * from_centre(lens, pixel) + f64::from(lens.width()) * self.shift
    }

    /// Derivatives of [`Self::drawn`] by stretch and shift, pixels.
    pub(super) fn gradient(lens: &Lens, pixel: DVec2) -> [DVec2; 3] {
        let width = f64::from(lens.width());
        [from_centre(lens, pixel), width * DVec2::X, width * DVec2::Y]
    }
}

/// Standard deviation, about each axis, of the rotation that is not measured without a gyro, for a camera of this twist, rad/s.
pub fn unmeasured_rad_per_s(twist: &Twist) -> f64 {
    libm::hypot(UNMEASURED_RAD_PER_S, UNMEASURED_SHARE * twist.angular.length())
}

/// Time at which the row of a pixel is exposed, relative to the middle row, as a share of the readout time.
pub fn row(lens: &Lens, pixel: DVec2) -> f64 {
    (pixel.y + 0.5) / f64::from(lens.height()) - 0.5
}

fn from_centre(lens: &Lens, pixel: DVec2) -> DVec2 {
    pixel - DVec2::new(lens.parameters().cx, lens.parameters().cy)
}
