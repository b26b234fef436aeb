//! Poses, lens models and field lines: the geometry that all other crates share. It is pure: no images, no time, no I/O.
//!
//! [`Isometry`] and [`Pose2`] are poses in space and in the plane. [`Lens`] maps rays to pixels and back; [`Projector`] is the same,
//! tabulated for many projections a frame. [`Field`] is the soccer field as painted strokes. [`PoseGrid`] counts images by pose.
//! [`Physical`] rejects numbers that no robot can have.
//!
//! Coordinate frames follow REP 103 and REP 105: `map` (field centre, x towards one goal, y left, z up), `base_footprint`,
//! `base_link` (torso), `camera_link` (x forward, z up) and `camera_optical_frame` (z forward, x right, y down). Units are metres and
//! radians.
//!
//! ```rust
//! use glam::DVec3;
//! use realitysim_geometry::{Euler, Isometry, Lens, LensError, LensModel, LensParameters, Pose2};
//!
//! let model = LensModel::KannalaBrandt { k: [-0.012, 0.003, -0.0008, 0.0] };
//! let size = LensParameters { width: 640, height: 480, fx: 205.0, fy: 205.0, cx: 322.0, cy: 236.0, model, fov_deg: Some(200.0) };
//! let lens = Lens::new(size)?;
//! // The camera is 0.5 m above a robot at (1, 0.5), and looks down by 0.3 rad.
//! let base_from_camera = Isometry::from_euler(Euler { pitch: 0.3, ..Euler::default() }, DVec3::new(0.0, 0.0, 0.5));
//! let map_from_optical = Pose2::new(1.0, 0.5, 0.2).to_isometry() * base_from_camera * Isometry::link_from_optical();
//! // A point on the ground is projected to its pixel, and the pixel's ray is followed back to the ground.
//! let point = DVec3::new(3.0, 1.0, 0.0);
//! let pixel = lens.project(map_from_optical.inverse().transform_point(point)).expect("the point is in view");
//! let ray = map_from_optical.transform_vector(lens.unproject(pixel).expect("the pixel has a ray"));
//! let camera = map_from_optical.translation;
//! assert!((camera - ray * (camera.z / ray.z)).distance(point) < 1e-6);
//! # Ok::<(), LensError>(())
//! ```

pub mod board;
pub mod field;
pub mod lens;
mod monotonic;
pub mod multiversion;
pub mod physical;
pub mod polynomial;
pub mod pose;
mod pose_grid;

pub use board::{Board, BoardDictionary, BoardError, BoardMarker};
pub use field::{Field, FieldDimensions, FieldError, FieldPoint};
pub use lens::{Lens, LensError, LensModel, LensParameters, Projector};
pub use physical::Physical;
pub use pose::{Euler, Isometry, Pose2, Twist};
pub use pose_grid::PoseGrid;

/// Wraps an angle in radians to (-pi, pi].
pub fn wrap_angle(angle: f64) -> f64 {
    use core::f64::consts::{PI, TAU};
    if angle > -PI && angle <= PI {
        return angle;
    }
    let wrapped = angle - TAU * libm::round(angle / TAU);
    if wrapped <= -PI { wrapped + TAU } else { wrapped }
}

/// Standard deviation along the longer axis of the covariance `[[xx, xy], [xy, yy]]` of x and y, in the unit of x and y.
///
/// The square root of the larger eigenvalue, in closed form; 0 if that eigenvalue is negative.
pub fn longest_axis(xx: f64, xy: f64, yy: f64) -> f64 {
    libm::sqrt((0.5 * (xx + yy) + libm::hypot(0.5 * (xx - yy), xy)).max(0.0))
}
