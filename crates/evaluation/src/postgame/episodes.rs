//! The times in which a robot's own pose was wrong, and what happened before.

use serde::Serialize;

use super::odometry::motion;
use super::{GameFrame, WRONG_M, WRONG_RAD, distance_m};
use realitysim_geometry::{Pose2, wrap_angle};

/// What most probably made an own pose wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Cause {
    /// It was wrong from the first frame on.
    Start,
    /// The robot lay or fell.
    Fall,
    /// The robot was carried: its tags moved otherwise than its odometry.
    Kidnapping,
    /// The own pose is right once it is turned by half a turn about the field's centre.
    Mirror,
    /// The own pose jumped, while the robot did not.
    Jump,
    /// The own pose went off little by little, while no lines were to be seen.
    NoLines,
    /// The own pose went off little by little.
    Drift,
}

/// A time in which the own pose was wrong.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Episode {
    /// When it began, seconds after the first frame.
    pub from_s: f64,
    /// When it ended, seconds after the first frame.
    pub until_s: f64,
    /// Greatest distance of the own pose, metres.
    pub worst_m: f64,
    /// Greatest turn of the own pose, degrees.
    pub worst_deg: f64,
    /// Stamp of the frame with the greatest distance, nanoseconds.
    pub worst_stamp_ns: i64,
    /// What most probably made it wrong.
    pub cause: Cause,
}

/// Wrong times with a shorter pause between them, in nanoseconds, are one.
const PAUSE_NS: i64 = 1_000_000_000;
/// Shorter times, in nanoseconds, are not counted.
const SHORTEST_NS: i64 = 300_000_000;
/// What happened this long before an episode may have caused it, nanoseconds.
const BEFORE_NS: i64 = 4_000_000_000;
/// A torso that leans by more lies or falls, radians.
const FALLEN_RAD: f64 = 0.8;
/// Two motions within [`WITHIN_NS`] that differ by more are of another kind, metres.
const JUMP_M: f64 = 0.35;
/// The same of turns, radians.
const JUMP_RAD: f64 = 0.6;
/// Time within which motions are compared, nanoseconds.
const WITHIN_NS: i64 = 1_500_000_000;
/// Share of the mirrored errors that must be small for a mirrored pose.
const MOSTLY: f64 = 0.7;

/// The times in which the own pose was wrong, in their order.
pub(super) fn episodes(frames: &[GameFrame]) -> Vec<Episode> {
    let Some(first_ns) = frames.first().map(|frame| frame.stamp_ns) else { return Vec::new() };
    let judged: Vec<(usize, bool)> = (frames.iter().enumerate())
        .filter_map(|(at, frame)| frame.error().map(|(metres, radians)| (at, metres > WRONG_M || radians > WRONG_RAD)))
        .collect();
    let mut spans: Vec<[usize; 2]> = Vec::new();
    for (at, _) in judged.iter().filter(|(_, wrong)| *wrong) {
        match spans.last_mut() {
            Some(span) if frames[*at].stamp_ns - frames[span[1]].stamp_ns <= PAUSE_NS => span[1] = *at,
            _ => spans.push([*at, *at]),
        }
    }
    let long = |span: &[usize; 2]| frames[span[1]].stamp_ns - frames[span[0]].stamp_ns >= SHORTEST_NS;
    let first_judged = judged.first().map_or(0, |(at, _)| *at);
    spans.into_iter().filter(long).map(|span| episode(frames, span, first_ns, first_judged)).collect()
}

fn episode(frames: &[GameFrame], [from, until]: [usize; 2], first_ns: i64, first_judged: usize) -> Episode {
    let seconds = |at: usize| (frames[at].stamp_ns - first_ns) as f64 * 1e-9;
    let errors = || frames[from..=until].iter().filter_map(|frame| Some((frame.stamp_ns, frame.error()?)));
    let worst = errors().max_by(|a, b| a.1.0.total_cmp(&b.1.0));
    let (worst_stamp_ns, (worst_m, _)) = worst.unwrap_or((frames[from].stamp_ns, (0.0, 0.0)));
    Episode {
        from_s: seconds(from),
        until_s: seconds(until),
        worst_m,
        worst_deg: errors().map(|(_, error)| error.1).fold(0.0, f64::max).to_degrees(),
        worst_stamp_ns,
        cause: cause(frames, [from, until], first_judged),
    }
}

/// What most probably made the own pose wrong, the surest signs first.
fn cause(frames: &[GameFrame], [from, until]: [usize; 2], first_judged: usize) -> Cause {
    let start_ns = frames[from].stamp_ns;
    let before: Vec<&GameFrame> =
        frames[..=from].iter().filter(|frame| start_ns - frame.stamp_ns <= BEFORE_NS).collect();
    let fell = before.iter().any(|frame| frame.lean_rad.is_some_and(|lean| lean > FALLEN_RAD));
    if is_mirrored(&frames[from..=until]) {
        return Cause::Mirror;
    }
    if fell {
        return Cause::Fall;
    }
    if from <= first_judged {
        return Cause::Start;
    }
    // Whether the robot was carried shows around the first wrong frame.
    let around: Vec<&GameFrame> =
        frames.iter().filter(|frame| (frame.stamp_ns - start_ns).abs() <= WITHIN_NS).collect();
    let differs = |one: fn(&GameFrame) -> Option<Pose2>, other: fn(&GameFrame) -> Option<Pose2>| {
        let known: Vec<(i64, Pose2, Pose2)> =
            around.iter().filter_map(|frame| Some((frame.stamp_ns, one(frame)?, other(frame)?))).collect();
        known.iter().enumerate().any(|(at, (stamp_ns, one, other))| {
            let later = known[at + 1..].iter().take_while(|(later, ..)| later - stamp_ns <= WITHIN_NS);
            later.into_iter().any(|(_, later_one, later_other)| {
                let [a, b] = [motion(*one, *later_one), motion(*other, *later_other)];
                libm::hypot(a[0] - b[0], a[1] - b[1]) > JUMP_M || wrap_angle(a[2] - b[2]).abs() > JUMP_RAD
            })
        })
    };
    if differs(|frame| frame.tagged, |frame| frame.odometry) {
        return Cause::Kidnapping;
    }
    if differs(|frame| frame.own, |frame| frame.odometry.or(frame.tagged)) {
        return Cause::Jump;
    }
    let unseen = before.iter().filter(|frame| frame.tagged.is_none()).count();
    if 2 * unseen > before.len() { Cause::NoLines } else { Cause::Drift }
}

/// Whether the own poses are mostly right once they are turned by half a turn about the field's centre.
fn is_mirrored(frames: &[GameFrame]) -> bool {
    let turned = |own: Pose2| Pose2 { x: -own.x, y: -own.y, yaw: own.yaw + core::f64::consts::PI };
    let pairs: Vec<(Pose2, Pose2)> =
        frames.iter().filter_map(|frame| Some((turned(frame.own?), frame.tagged?))).collect();
    let right = pairs.iter().filter(|(own, tagged)| {
        distance_m(*own, *tagged) <= WRONG_M && wrap_angle(own.yaw - tagged.yaw).abs() <= WRONG_RAD
    });
    !pairs.is_empty() && right.count() as f64 >= MOSTLY * pairs.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A robot that walks along x for `count` frames of 0.1 s, and believes `own` of each.
    fn walk(count: usize, own: impl Fn(usize, Pose2) -> Pose2) -> Vec<GameFrame> {
        let frame = |at: usize| {
            let pose = Pose2 { x: -2.0 + 0.02 * at as f64, y: 0.7, yaw: 0.1 };
            GameFrame {
                stamp_ns: 100_000_000 * at as i64,
                tagged: Some(pose),
                odometry: Some(Pose2 { x: 5.0 + 0.02 * at as f64, y: 1.0, yaw: 0.1 }),
                lean_rad: Some(0.1),
                own: Some(own(at, pose)),
            }
        };
        (0..count).map(frame).collect()
    }

    fn only(frames: &[GameFrame]) -> Episode {
        let found = episodes(frames);
        assert_eq!(found.len(), 1, "{found:?}");
        found[0].clone()
    }

    #[test]
    fn each_cause_is_told_by_its_signs() {
        assert!(episodes(&walk(200, |_, pose| pose)).is_empty());
        let drift = walk(200, |at, pose| Pose2 { y: pose.y + 0.004 * at as f64, ..pose });
        let found = only(&drift);
        assert_eq!(found.cause, Cause::Drift);
        assert!((found.from_s - 7.6).abs() < 0.2 && (found.worst_m - 0.796).abs() < 1e-9, "{found:?}");
        let jump = walk(200, |at, pose| if at < 100 { pose } else { Pose2 { y: pose.y + 0.9, ..pose } });
        assert_eq!(only(&jump).cause, Cause::Jump);
        let mirror = |pose: Pose2| Pose2 { x: -pose.x, y: -pose.y, yaw: pose.yaw + core::f64::consts::PI };
        assert_eq!(only(&walk(200, |at, pose| if at < 100 { pose } else { mirror(pose) })).cause, Cause::Mirror);
        assert_eq!(only(&walk(50, |_, pose| Pose2 { x: pose.x + 1.0, ..pose })).cause, Cause::Start);
        let mut fallen = jump.clone();
        fallen[80].lean_rad = Some(1.4);
        assert_eq!(only(&fallen).cause, Cause::Fall);
        let mut carried = walk(200, |_, pose| pose);
        for frame in &mut carried[100..] {
            frame.tagged = frame.tagged.map(|pose| Pose2 { y: pose.y - 1.5, ..pose });
        }
        assert_eq!(only(&carried).cause, Cause::Kidnapping);
        let mut blind = drift;
        blind[30..75].iter_mut().for_each(|frame| frame.tagged = None);
        assert_eq!(only(&blind).cause, Cause::NoLines);
    }
}
