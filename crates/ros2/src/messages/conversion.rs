//! Converts the types of geometry to messages and back.
//!
//! The software of a robot may have written any number into a message. Each number is read with [`settled`], so that no
//! denormal number and no signed zero reaches a product. A number that is not finite stays as it is: the caller refuses it with
//! [`Physical::is_possible`].

use glam::{DQuat, DVec3};

use super::{CameraInfo, Header, Point, Pose, Quaternion, Stamp, Transform, Vector3};
use realitysim_geometry::physical::settled;
use realitysim_geometry::{Isometry, LensParameters, Physical};

impl Header {
    /// Makes a header; `stamp_ns` is nanoseconds since the epoch of the clock that stamps the log.
    pub fn at(stamp_ns: i64, frame_id: &str) -> Self {
        Self { stamp: Stamp::from_nanoseconds(stamp_ns), frame_id: frame_id.to_owned() }
    }
}

impl From<DVec3> for Vector3 {
    fn from(DVec3 { x, y, z }: DVec3) -> Self {
        Self { x, y, z }
    }
}

impl From<DVec3> for Point {
    fn from(DVec3 { x, y, z }: DVec3) -> Self {
        Self { x, y, z }
    }
}

impl From<DQuat> for Quaternion {
    fn from(DQuat { x, y, z, w }: DQuat) -> Self {
        Self { x, y, z, w }
    }
}

impl From<Isometry> for Pose {
    fn from(isometry: Isometry) -> Self {
        Self { position: isometry.translation.into(), orientation: isometry.rotation.into() }
    }
}

impl From<Isometry> for Transform {
    fn from(isometry: Isometry) -> Self {
        Self { translation: isometry.translation.into(), rotation: isometry.rotation.into() }
    }
}

impl From<Vector3> for DVec3 {
    fn from(v: Vector3) -> Self {
        Self::from_array([v.x, v.y, v.z].map(settled))
    }
}

impl From<Point> for DVec3 {
    fn from(p: Point) -> Self {
        Self::from_array([p.x, p.y, p.z].map(settled))
    }
}

impl From<Quaternion> for DQuat {
    /// The result is not normalized.
    fn from(q: Quaternion) -> Self {
        Self::from_array([q.x, q.y, q.z, q.w].map(settled))
    }
}

impl From<Pose> for Isometry {
    fn from(pose: Pose) -> Self {
        make_isometry(pose.orientation.into(), pose.position.into())
    }
}

impl From<Transform> for Isometry {
    fn from(transform: Transform) -> Self {
        make_isometry(transform.rotation.into(), transform.translation.into())
    }
}

/// Makes a rigid transformation.
///
/// A quaternion of zeros means no rotation: many drivers send it so. A quaternion that is not [`Physical`] stays as it is, so
/// that the caller can refuse the whole pose.
fn make_isometry(rotation: DQuat, translation: DVec3) -> Isometry {
    if rotation.is_possible() || rotation == DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0) {
        Isometry::new(rotation, translation)
    } else {
        Isometry { rotation, translation }
    }
}

impl CameraInfo {
    /// Makes the calibration message of a lens.
    ///
    /// ROS has no name for an equisolid, double sphere, enhanced unified or Scaramuzza lens. The message calls them `equisolid`,
    /// `double_sphere` (xi, alpha), `eucm` (alpha, beta) and `scaramuzza` (c2 to c6, skew), which only this program reads. Thin prism terms follow those of
    /// `rational_polynomial`, as OpenCV orders them.
    pub fn of_lens(lens: &LensParameters, header: Header) -> Self {
        let (distortion_model, d) = lens.model.ros_distortion();
        let LensParameters { width, height, fx, fy, cx, cy, .. } = *lens;
        Self {
            header,
            height,
            width,
            distortion_model: distortion_model.to_owned(),
            d,
            k: [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
            r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            p: [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
            ..Default::default()
        }
    }
}
