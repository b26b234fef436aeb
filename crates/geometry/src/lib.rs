//! Frames and poses, lenses, field lines. Pure: no images, no time, no I/O.
//!
//! Frames follow REP 103 and REP 105: `map` (field centre, x towards one goal, y left, z up),
//! `base_footprint`, `base_link` (torso), `camera_link` (x forward, z up) and
//! `camera_optical_frame` (z forward, x right, y down). Metres and radians throughout.

pub mod field;
pub mod lens;
pub mod multiversion;
pub mod physical;
pub mod polynomial;
pub mod pose;
mod pose_grid;

pub use field::{Field, FieldDimensions, FieldError, FieldPoint};
pub use lens::{Lens, LensError, LensModel, LensParameters, Projector};
pub use physical::Physical;
pub use pose::{Euler, Isometry, Pose2, Twist};
pub use pose_grid::PoseGrid;

/// Wraps an angle to (-pi, pi].
pub fn wrap_angle(angle: f64) -> f64 {
    use core::f64::consts::{PI, TAU};
    if angle > -PI && angle <= PI {
        return angle;
    }
    let wrapped = angle - TAU * libm::round(angle / TAU);
    if wrapped <= -PI { wrapped + TAU } else { wrapped }
}

/// The larger standard deviation of a covariance of x and y.
pub fn longest_axis(xx: f64, xy: f64, yy: f64) -> f64 {
    libm::sqrt((0.5 * (xx + yy) + libm::hypot(0.5 * (xx - yy), xy)).max(0.0))
}
