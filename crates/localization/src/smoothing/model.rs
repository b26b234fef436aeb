//! What is believed before a walk is fitted.

use super::CONSTANTS;

/// Standard deviations of everything that is fitted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Model {
    /// A line place of the best width, including the error that neighbours share, pixels. Widened if lines lie off by more.
    pub line_px: f64,
    /// One patch of ground in two neighbouring images, including what all patches of a pair have in common, pixels.
    pub match_px: f64,
    /// Position of a tag, metres. It is loose: what nothing else determines stays where it was.
    pub tag_m: f64,
    /// Orientation of a tag, radians.
    pub tag_rad: f64,
    /// Tilt of one frame by IMU and mount beyond the constants, radians.
    pub tilt_rad: f64,
    /// Height of one frame beyond the constants, metres.
    pub height_m: f64,
    /// Sway of the camera over the feet between two frames, metres.
    pub sway_m: f64,
    /// Step between frames by odometry, as a share of the distance.
    pub step_share: f64,
    /// Rotation between frames by odometry, as a share of the rotation.
    pub turn_share: f64,
    /// Rotation between frames by gyro, as a share of the rotation.
    pub gyro_share: f64,
    /// Drift of the distance between frames.
    pub drift_m_per_s: f64,
    /// Drift of the rotation between frames.
    pub drift_rad_per_s: f64,
    /// The constants, in the order of [`Constants::values`](super::Constants::values); those with 0 are held.
    pub constants: [f64; CONSTANTS],
}

impl Model {
    /// A camera of which little is known, on a field that was not measured: everything that a walk can show is free.
    ///
    /// Standard deviations are what users get wrong: a lens by its angle of view alone (10 % of focal length, the centre in the
    /// middle of the image), a mount set by eye (3 degrees, 5 cm), a field laid out by hand (20 cm), odometry of a new gait.
    pub fn calibration() -> Self {
        let (lens, mount, times) = ([0.1, 20.0, 20.0, 0.05], [0.06, 0.06, 0.05], [0.02, 0.02]);
        let [focal, u, v, k1] = lens;
        let [tilt_x, tilt_z, height] = mount;
        let [readout, delay] = times;
        let constants = [focal, u, v, k1, tilt_x, tilt_z, height, readout, 0.03, 0.02, 0.01, delay, 0.1, 0.2, 0.2];
        Self { tag_m: 0.3, tag_rad: 0.1, constants, ..Self::default() }
    }
}

/// Standard deviations of the constants that a refinement of tags finds: those of a camera that has been calibrated.
const REFINED: [f64; 8] = [0.01, 3.0, 3.0, 0.01, 0.012, 0.012, 0.015, 0.015];
/// Standard deviation of a constant that is held: small beside any that is not.
pub(super) const HELD: f64 = 1e-9;

impl Default for Model {
    fn default() -> Self {
        Self {
            line_px: 0.16,
            match_px: 0.4,
            tag_m: 0.1,
            tag_rad: 0.04,
            tilt_rad: 0.4f64.to_radians(),
            height_m: 0.006,
            sway_m: 0.02,
            step_share: 0.15,
            turn_share: 0.15,
            gyro_share: 0.02,
            drift_m_per_s: 0.01,
            drift_rad_per_s: 0.02,
            constants: core::array::from_fn(|i| *REFINED.get(i).unwrap_or(&0.0)),
        }
    }
}
