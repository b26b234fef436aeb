//! Command `realitysim postgame`: judges a robot's own pose after a game by refined tags.

mod page;

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::Args;
use serde::Serialize;

use super::paths::{cannot_read, check_output, write};
use super::{Outcome, output};
use crate::config::plain_file;
use crate::database::best_tags;
use crate::evaluation::capture::{parse_tum, read_own_poses};
use crate::evaluation::postgame::{Cause, Episode, GameFrame, Motion, Postgame, own_at};
use crate::geometry::{Isometry, Pose2};
use crate::recording::{Loss, Readout, SessionInfo, read_info};
use crate::ros2::messages::FrameTag;
use crate::tagging::robot_track::{TrackedFrame, robot_track};

/// Judge a robot's own pose after a game: when it was wrong, and after what
///
/// Compares the poses that the robot's own localization sent with the tags of its frames, refined ones if there are better ones
/// (`realitysim refine`). A pose more than 0.3 m or 15 degrees off is wrong. For each time in which it was wrong the page shows what
/// happened before: a fall, a robot that was carried, the mirrored half of the field, a jump, no lines in view, slow drift. The scale
/// of the odometry in each direction is measured by the way.
#[derive(Args)]
#[command(after_long_help = concat!(
    "Example:",
    "\n  realitysim postgame captures/2026-11-21T10-00-00Z-robot --poses /localization/pose -o game.html",
))]
pub struct PostgameArguments {
    /// A capture's folder
    capture: PathBuf,
    /// The robot's own poses of base_footprint in map: a topic of the capture (PoseStamped, PoseWithCovarianceStamped or Odometry), or a
    /// file with lines `stamp tx ty tz qx qy qz qw`
    #[arg(long, value_name = "TOPIC|FILE")]
    poses: String,
    /// The page to write, with pictures and all that belongs to it
    #[arg(short, long, value_name = "HTML")]
    output: Option<PathBuf>,
}

#[derive(Serialize)]
struct Report<'a> {
    #[serde(flatten)]
    game: &'a Postgame,
    lost: &'a [Loss],
}

/// Largest file with poses, bytes: a day of them at 100 a second.
const MAX_POSES_BYTES: u64 = 1 << 30;

pub fn run(arguments: &PostgameArguments, json: bool) -> anyhow::Result<Outcome> {
    let PostgameArguments { capture, poses, output } = arguments;
    if let Some(output) = output {
        check_output(output, &[capture, Path::new(poses)])?;
    }
    let info = read_info(capture).with_context(|| capture.display().to_string())?;
    let (_, Readout { found: tags, losses: mut lost, .. }) = best_tags(capture)?;
    let Readout { found: own, losses, .. } = own_poses(capture, poses)?;
    lost.extend(losses.into_iter().filter(|loss| !lost.contains(loss)).collect::<Vec<_>>());
    let mut progress = output::Progress::new("reading");
    let (track, losses) = robot_track(capture, &info.settings, &mut |done, all| progress.set(done, Some(all)))?;
    progress.finish();
    lost.extend(losses.into_iter().filter(|loss| !lost.contains(loss)).collect::<Vec<_>>());
    let frames = frames(&tags, &track, &own);
    let game = Postgame::of(&frames);
    if game.judged == 0 {
        bail!("{}", why_nothing(capture, poses, &tags, &own));
    }
    output::losses(&lost);
    if let Some(output) = output {
        let page = page::page(&Walk { capture, info: &info, frames: &frames, tags: &tags }, &game)?;
        write(output, &page)?;
    }
    if json {
        output::json(&Report { game: &game, lost: &lost })?;
    } else {
        output::lines(&summary(&game))?;
    }
    Ok(Outcome::of(&lost))
}

/// What a page is made of.
struct Walk<'a> {
    capture: &'a Path,
    info: &'a SessionInfo,
    frames: &'a [GameFrame],
    tags: &'a [FrameTag],
}

/// Reads the robot's own poses from a topic of the capture, or from a file.
fn own_poses(capture: &Path, poses: &str) -> anyhow::Result<Readout<(i64, Isometry)>> {
    let path = Path::new(poses);
    if !path.is_file() {
        return Ok(read_own_poses(capture, poses)?);
    }
    let text = plain_file::read_text(path, MAX_POSES_BYTES).map_err(|error| cannot_read(path, error))?;
    Ok(Readout { found: parse_tum(path, &text)?, losses: Vec::new(), warnings: Vec::new() })
}

/// Puts together what is known of each frame.
fn frames(tags: &[FrameTag], track: &[TrackedFrame], own: &[(i64, Isometry)]) -> Vec<GameFrame> {
    let by_stamp: HashMap<i64, &TrackedFrame> = track.iter().map(|frame| (frame.stamp_ns, frame)).collect();
    let frame = |tag: &FrameTag| {
        let stamp_ns = tag.header.stamp.to_nanoseconds();
        let tracked = by_stamp.get(&stamp_ns);
        let footprint_from_link = tracked.and_then(|tracked| tracked.footprint_from_link);
        let map_from_footprint = |footprint_from_link: Isometry| {
            Pose2::from_isometry(&(Isometry::from(tag.pose.pose) * footprint_from_link.inverse()))
        };
        GameFrame {
            stamp_ns,
            tagged: footprint_from_link.filter(|_| tag.valid).map(map_from_footprint),
            odometry: tracked.and_then(|tracked| tracked.odometry),
            lean_rad: tracked.and_then(|tracked| tracked.lean_rad),
            own: own_at(own, stamp_ns),
        }
    };
    let mut frames: Vec<GameFrame> = tags.iter().map(frame).collect();
    frames.sort_by_key(|frame| frame.stamp_ns);
    frames
}

/// Why no frame could be judged.
fn why_nothing(capture: &Path, poses: &str, tags: &[FrameTag], own: &[(i64, Isometry)]) -> String {
    let valid: Vec<i64> = tags.iter().filter(|tag| tag.valid).map(|tag| tag.header.stamp.to_nanoseconds()).collect();
    let capture = capture.display();
    match (valid.first().zip(valid.last()), own.first().zip(own.last())) {
        (None, _) => format!("{capture}: none of its {} tags is valid: nothing can be judged", tags.len()),
        (_, None) => format!("{poses}: it has no pose"),
        (Some((first, last)), Some(((own_first, _), (own_last, _)))) => format!(
            "{poses}: no pose is near the time of a valid tag: tags are from {:.3} to {:.3} s, poses from {:.3} to {:.3} s: is it the same \
             walk, and the same clock?",
            *first as f64 * 1e-9,
            *last as f64 * 1e-9,
            *own_first as f64 * 1e-9,
            *own_last as f64 * 1e-9
        ),
    }
}

/// The result for people.
fn summary(game: &Postgame) -> String {
    let Postgame { frames, judged, median_m, p95_m, median_yaw_deg, wrong_s, wrong_share, episodes, odometry } = game;
    let mut lines = vec![
        format!(
            "{judged} of {frames} frames judged: own pose {:.1} cm and {median_yaw_deg:.1} deg off (median), 95 % within {:.1} cm",
            100.0 * median_m,
            100.0 * p95_m
        ),
        format!("wrong for {wrong_s:.1} s ({:.0} % of the time), {} times", 100.0 * wrong_share, episodes.len()),
    ];
    for Episode { from_s, until_s, worst_m, worst_deg, cause, .. } in episodes {
        lines.push(format!(
            "  {from_s:7.1} to {until_s:7.1} s: up to {worst_m:.2} m and {worst_deg:.0} deg: {}",
            cause_text(*cause)
        ));
    }
    for direction in &odometry.directions {
        let (name, unit) = motion_text(direction.motion);
        lines.push(match direction.scale.zip(direction.sigma) {
            Some((scale, sigma)) => format!(
                "odometry {name}: the robot moves {scale:.3} +- {sigma:.3} of it ({:.1} {unit})",
                direction.moved
            ),
            None => format!("odometry {name}: too little motion to tell ({:.1} {unit})", direction.moved),
        });
    }
    lines.join("\n")
}

fn cause_text(cause: Cause) -> &'static str {
    match cause {
        Cause::Start => "from the first frame on",
        Cause::Fall => "after a fall",
        Cause::Kidnapping => "after the robot was carried",
        Cause::Mirror => "in the mirrored half of the field",
        Cause::Jump => "the own pose jumped, the robot did not",
        Cause::NoLines => "drifted while no lines were seen",
        Cause::Drift => "drifted",
    }
}

fn motion_text(motion: Motion) -> (&'static str, &'static str) {
    match motion {
        Motion::Forward => ("forward", "m"),
        Motion::Backward => ("backward", "m"),
        Motion::Left => ("to the left", "m"),
        Motion::Right => ("to the right", "m"),
        Motion::TurnLeft => ("turning left", "deg"),
        Motion::TurnRight => ("turning right", "deg"),
    }
}
