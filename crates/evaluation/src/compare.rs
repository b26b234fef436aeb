//! Comparison of tags with the truth: errors of position and attitude, and consistency of the covariance.

use core::f64::consts::PI;

use glam::{DQuat, DVec3};
use nalgebra::{Matrix2, Vector2};
use serde::Serialize;

use super::statistics::Summary;
use realitysim_geometry::{Euler, Isometry, wrap_angle};

/// A pose of `camera_link` in `map` that is judged.
#[derive(Clone, Debug, PartialEq)]
pub struct Tagged {
    /// Time of the frame, nanoseconds.
    pub stamp_ns: i64,
    /// Whether the tag is valid. Only valid tags are judged.
    pub valid: bool,
    /// Pose of `camera_link` in `map`.
    pub pose: Isometry,
    /// Covariance of x and y, square metres: xx, xy, yy.
    pub covariance: [f64; 3],
    /// Whether the mirrored pose, in the other half of the field, fits as well.
    pub ambiguous: bool,
}

/// Errors of a set of tags; what `realitysim eval` prints.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Comparison {
    /// Number of tags, valid or not.
    pub frames: usize,
    /// Number of valid tags.
    pub valid: usize,
    /// Number of valid tags without a true pose near their time.
    pub without_truth: usize,
    /// Number of valid tags with a true pose. The errors below are over these, and 0 if there are none.
    pub judged: usize,
    /// Number of judged tags that are ambiguous.
    pub ambiguous: usize,
    /// Distance to the truth in x and y, centimetres.
    pub position_cm: Summary,
    /// Absolute error of yaw, degrees.
    pub yaw_deg: Summary,
    /// Angle between the estimated and the true up axis, degrees.
    pub tilt_deg: Summary,
    /// Absolute error of roll, degrees.
    pub roll_deg: Summary,
    /// Absolute error of pitch, degrees.
    pub pitch_deg: Summary,
    /// Share of the judged tags whose 95 % ellipse in x and y contains the truth.
    pub ellipse95_share: f64,
    /// Normalized estimation error squared of x and y, averaged over the judged tags: 2 if the covariance is right.
    pub nees: f64,
}

/// Largest distance in time between a tag and a true pose that judges it, nanoseconds.
const MAX_GAP_NS: i64 = 200_000_000;
/// 95 % quantile of the chi-square distribution with two degrees of freedom.
const CHI_SQUARE_95: f64 = 5.991_464_547_107_979;

/// Judges the valid tags against the truth.
///
/// `truth` holds times in nanoseconds and poses of `camera_link` in `map`, in order of time.
pub fn compare(tags: &[Tagged], truth: &[(i64, Isometry)]) -> Comparison {
    let (mut position, mut yaw, mut tilt, mut roll, mut pitch) = (vec![], vec![], vec![], vec![], vec![]);
    let (mut squared, mut held) = (Vec::new(), 0usize);
    let mut result = Comparison { frames: tags.len(), ..Comparison::default() };
    for tag in tags.iter().filter(|tag| tag.valid) {
        result.valid += 1;
        let Some(true_pose) = truth_at(truth, tag.stamp_ns) else {
            result.without_truth += 1;
            continue;
        };
        result.ambiguous += usize::from(tag.ambiguous);
        let off = (tag.pose.translation - true_pose.translation).truncate();
        position.push(100.0 * off.length());
        let (got, wanted) = (tag.pose.euler(), true_pose.euler());
        let degrees = |a: f64, b: f64| wrap_angle(a - b).abs().to_degrees();
        yaw.push(degrees(got.yaw, wanted.yaw));
        roll.push(degrees(got.roll, wanted.roll));
        pitch.push(degrees(got.pitch, wanted.pitch));
        tilt.push(angle_between_up(tag.pose.rotation, true_pose.rotation).to_degrees());
        let [xx, xy, yy] = tag.covariance;
        let error = Vector2::new(off.x, off.y);
        let distance = Matrix2::new(xx, xy, xy, yy)
            .try_inverse()
            .map_or(f64::INFINITY, |information| error.dot(&(information * error)));
        held += usize::from(distance <= CHI_SQUARE_95);
        squared.push(distance);
    }
    result.judged = position.len();
    result.position_cm = Summary::of(&position);
    result.yaw_deg = Summary::of(&yaw);
    result.tilt_deg = Summary::of(&tilt);
    result.roll_deg = Summary::of(&roll);
    result.pitch_deg = Summary::of(&pitch);
    result.ellipse95_share = held as f64 / squared.len().max(1) as f64;
    result.nees = squared.iter().sum::<f64>() / squared.len().max(1) as f64;
    result
}

/// Turns all tags by half a turn about the centre of the field, which looks the same from both halves.
pub fn mirrored(tags: &[Tagged]) -> Vec<Tagged> {
    let half_turn = Isometry::from_euler(Euler { yaw: PI, pitch: 0.0, roll: 0.0 }, DVec3::ZERO);
    tags.iter().map(|tag| Tagged { pose: half_turn * tag.pose, ..tag.clone() }).collect()
}

/// Replaces each ambiguous tag by its mirrored pose where that is nearer to the truth.
///
/// Other tags, and those without a true pose, are returned unchanged.
pub fn up_to_mirror(tags: &[Tagged], truth: &[(i64, Isometry)]) -> Vec<Tagged> {
    let off = |tag: &Tagged| Some((tag.pose.translation - truth_at(truth, tag.stamp_ns)?.translation).length());
    let nearer = |(tag, turned): (&Tagged, Tagged)| if off(&turned) < off(tag) { turned } else { tag.clone() };
    tags.iter()
        .zip(mirrored(tags))
        .map(|(tag, turned)| if tag.ambiguous { nearer((tag, turned)) } else { tag.clone() })
        .collect()
}

/// Returns the true pose at a time, interpolated between the true poses before and after it.
///
/// `truth` is in order of time. The result is `None` if no true pose is near enough in time.
pub fn truth_at(truth: &[(i64, Isometry)], stamp_ns: i64) -> Option<Isometry> {
    let after = truth.partition_point(|(stamp, _)| *stamp < stamp_ns);
    let near = |index: Option<usize>| {
        let (stamp, pose) = truth.get(index?)?;
        (stamp.abs_diff(stamp_ns) <= MAX_GAP_NS as u64).then_some((*stamp, *pose))
    };
    match (near(after.checked_sub(1)), near(Some(after))) {
        (Some((t0, a)), Some((t1, b))) => Some(a.interpolate(&b, (stamp_ns - t0) as f64 / (t1 - t0).max(1) as f64)),
        // Beside a gap only a true pose of the same time counts. Some tools round stamps to a microsecond.
        (a, b) => a.or(b).filter(|(stamp, _)| stamp.abs_diff(stamp_ns) < 1_000).map(|(_, pose)| pose),
    }
}

/// Returns the angle between the up axes of two attitudes, radians.
fn angle_between_up(a: DQuat, b: DQuat) -> f64 {
    // The up axis of the map in coordinates of the camera: yaw does not change it.
    let (a, b) = (a.conjugate() * DVec3::Z, b.conjugate() * DVec3::Z);
    libm::atan2(a.cross(b).length(), a.dot(b))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64, yaw: f64, pitch: f64) -> Isometry {
        Isometry::from_euler(Euler { yaw, pitch, roll: 0.0 }, DVec3::new(x, 0.0, 0.5))
    }

    #[test]
    fn errors_equal_those_that_were_put_in() {
        let truth = vec![(0, at(0.0, 0.0, 0.3)), (100, at(1.0, 0.0, 0.3))];
        let tag =
            |stamp_ns, pose| Tagged { stamp_ns, valid: true, pose, covariance: [0.01, 0.0, 0.01], ambiguous: false };
        let tags = [
            tag(0, at(0.03, 0.0, 0.3)),
            tag(50, at(0.5, 0.1, 0.3)),
            tag(100, at(1.3, 0.0, 0.4)),
            Tagged { valid: false, ..tag(100, at(9.0, 0.0, 0.0)) },
            tag(5_000_000_000, at(0.0, 0.0, 0.0)),
        ];
        let c = compare(&tags, &truth);
        assert_eq!((c.frames, c.valid, c.without_truth, c.judged), (5, 4, 1, 3));
        assert!((c.position_cm.max - 30.0).abs() < 1e-9 && (c.position_cm.mean - 11.0).abs() < 1e-9);
        assert!((c.yaw_deg.max - 0.1f64.to_degrees()).abs() < 1e-9);
        assert!((c.tilt_deg.max - 0.1f64.to_degrees()).abs() < 1e-9);
        assert!((c.pitch_deg.max - 0.1f64.to_degrees()).abs() < 1e-9);
        // An error of 0.3 m at a standard deviation of 0.1 m lies outside of the 95 % ellipse.
        assert!((c.ellipse95_share - 2.0 / 3.0).abs() < 1e-12);
        assert!((c.nees - (0.09 + 9.0) / 3.0).abs() < 1e-9);
    }

    #[test]
    fn tags_in_the_other_half_are_right_once_mirrored() {
        let truth = vec![(0, at(1.0, 0.0, 0.3)), (100, at(1.5, 0.0, 0.3))];
        let tag = |stamp_ns, x: f64, ambiguous| {
            let pose = at(x, PI, 0.3);
            Tagged { stamp_ns, valid: true, pose, covariance: [1.0; 3], ambiguous }
        };
        let tags = [tag(0, -1.0, true), tag(100, -1.5, false)];
        assert!(compare(&tags, &truth).position_cm.median > 200.0);
        // Only the ambiguous tag may be in the other half.
        let folded = compare(&up_to_mirror(&tags, &truth), &truth);
        assert!((folded.position_cm.max - 300.0).abs() < 1e-9 && (folded.position_cm.mean - 150.0).abs() < 1e-9);
        assert_eq!(folded.ambiguous, 1);
        let turned = compare(&mirrored(&tags), &truth);
        assert!(turned.position_cm.max < 1e-9 && turned.yaw_deg.max < 1e-9 && turned.tilt_deg.max < 1e-9);
    }
}
