//! The times at which the robot stood on a crossing, from the marks of a capture and its tags.

use serde::Serialize;

use super::crossings::{Crossing, parse_mark};
use glam::DVec2;
use realitysim_geometry::{Pose2, wrap_angle};

/// One frame as the taped places need it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenFrame {
    /// Time of the exposure, nanoseconds.
    pub stamp_ns: i64,
    /// Pose of `base_footprint` in `map` by its tag: see [`footprint`](super::footprint). `None` without a valid tag.
    pub tagged: Option<Pose2>,
    /// Pose of `base_footprint` in `odom`, if there is odometry.
    pub odometry: Option<Pose2>,
}

/// The robot on a crossing.
#[derive(Clone, Debug, PartialEq)]
pub struct Stand {
    /// Name of the crossing.
    pub crossing: String,
    /// Its position in `map`, metres.
    pub at_m: DVec2,
    /// Heading of the robot in `map`, radians.
    pub heading_rad: f64,
    /// Poses of `base_footprint` in `map` by the tags of the time.
    pub tagged: Vec<Pose2>,
}

/// A mark that cannot be used.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Refused {
    /// Time of the mark, nanoseconds.
    pub stamp_ns: i64,
    /// Its text.
    pub mark: String,
    /// Why, and what would mend it.
    pub why: String,
}

/// Time before and after a mark in which the robot has to stand, nanoseconds.
pub const STILL_NS: i64 = 1_000_000_000;
/// Distance within that time with which a robot counts as standing, metres: one that marks time moves its footprint by less.
const MAX_MOVED_M: f64 = 0.02;
/// The same for its heading, radians.
const MAX_TURNED_RAD: f64 = 0.05;
/// The same without odometry, by the tags, which scatter.
const MAX_TAG_MOVED_M: f64 = 0.06;
const MAX_TAG_TURNED_RAD: f64 = 0.09;
/// Fewest valid tags of a stand.
const MIN_TAGS: usize = 3;

/// The stands that the marks name, and the marks that cannot be used. `marks` are times in nanoseconds with texts, `frames` are in
/// order of time. Marks about something else are left out; of marks with the same crossing and heading the last one counts.
pub fn stands(marks: &[(i64, String)], frames: &[SeenFrame], crossings: &[Crossing]) -> (Vec<Stand>, Vec<Refused>) {
    let (mut stands, mut refused): (Vec<Stand>, Vec<Refused>) = Default::default();
    for (stamp_ns, text) in marks {
        let Some(parsed) = parse_mark(text, crossings) else { continue };
        match parsed.and_then(|(crossing, heading_rad)| stand(*stamp_ns, crossing, heading_rad, frames)) {
            Ok(stand) => {
                let same = |other: &Stand| {
                    other.crossing == stand.crossing && wrap_angle(other.heading_rad - stand.heading_rad).abs() < 1e-3
                };
                stands.retain(|other| !same(other));
                stands.push(stand);
            }
            Err(why) => refused.push(Refused { stamp_ns: *stamp_ns, mark: text.clone(), why }),
        }
    }
    (stands, refused)
}

fn stand(stamp_ns: i64, crossing: &Crossing, heading_rad: f64, frames: &[SeenFrame]) -> Result<Stand, String> {
    let from = frames.partition_point(|frame| frame.stamp_ns < stamp_ns.saturating_sub(STILL_NS));
    let until = frames.partition_point(|frame| frame.stamp_ns <= stamp_ns.saturating_add(STILL_NS));
    let frames = &frames[from..until.max(from)];
    let tagged: Vec<Pose2> = frames.iter().filter_map(|frame| frame.tagged).collect();
    if tagged.len() < MIN_TAGS {
        return Err(format!(
            "{} valid tags within a second of it, and {MIN_TAGS} are needed: turn to where lines are in view, and mark again",
            tagged.len()
        ));
    }
    let odometry: Vec<Pose2> = frames.iter().filter_map(|frame| frame.odometry).collect();
    let (moved_m, turned_rad, is_standing) = if odometry.len() < 2 {
        let third = tagged.len().div_ceil(3);
        let (m, rad) = apart(&[mean(&tagged[..third]), mean(&tagged[tagged.len() - third..])]);
        (m, rad, m <= MAX_TAG_MOVED_M && rad <= MAX_TAG_TURNED_RAD)
    } else {
        let (m, rad) = apart(&odometry);
        (m, rad, m <= MAX_MOVED_M && rad <= MAX_TURNED_RAD)
    };
    if !is_standing {
        return Err(format!(
            "the robot moved by {:.0} cm and {:.0} degrees within a second of it: let it stand still for a second before and after, and \
             mark again",
            100.0 * moved_m,
            turned_rad.to_degrees()
        ));
    }
    Ok(Stand { crossing: crossing.name.clone(), at_m: crossing.at_m, heading_rad, tagged })
}

/// Largest distance and angle from the first pose.
fn apart(poses: &[Pose2]) -> (f64, f64) {
    let Some(first) = poses.first() else { return (0.0, 0.0) };
    let farther = |(m, rad): (f64, f64), pose: &Pose2| {
        (m.max(first.distance(pose)), rad.max(wrap_angle(pose.yaw - first.yaw).abs()))
    };
    poses.iter().fold((0.0, 0.0), farther)
}

/// Mean of poses that lie close together; the default pose of none.
pub(super) fn mean(poses: &[Pose2]) -> Pose2 {
    let Some(first) = poses.first() else { return Pose2::default() };
    let share = 1.0 / poses.len() as f64;
    let off = poses.iter().fold(Pose2::default(), |sum, pose| {
        Pose2::new(
            sum.x + (pose.x - first.x) * share,
            sum.y + (pose.y - first.y) * share,
            sum.yaw + wrap_angle(pose.yaw - first.yaw) * share,
        )
    });
    Pose2::new(first.x + off.x, first.y + off.y, wrap_angle(first.yaw + off.yaw))
}
