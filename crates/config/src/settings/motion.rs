//! `[motion]`: the errors of odometry.

use super::check_range;
use realitysim_localization::MotionModel;

/// Checks the ranges of the motion model.
pub(super) fn check(motion: &MotionModel) -> Result<(), String> {
    for (key, value) in [
        ("motion.distance_share", motion.distance_share),
        ("motion.turn_share", motion.turn_share),
        ("motion.turn_rad_per_m", motion.turn_rad_per_m),
        ("motion.drift_m_per_sqrt_s", motion.drift_m_per_sqrt_s),
        ("motion.drift_rad_per_sqrt_s", motion.drift_rad_per_sqrt_s),
        ("motion.walk_m_per_s", motion.walk_m_per_s),
        ("motion.turn_rad_per_s", motion.turn_rad_per_s),
    ] {
        check_range(key, value, 0.0, 100.0)?;
    }
    Ok(())
}
