//! Command `realitysim eval`: compares the tags of a capture with the true poses.

use std::path::PathBuf;

use anyhow::bail;
use clap::Args;
use serde::Serialize;

use super::{Outcome, output};
use crate::config::Topics;
use crate::evaluation::capture::{read_poses, read_truth, tagged};
use crate::evaluation::{Comparison, Tagged, compare, mirrored, up_to_mirror};
use crate::geometry::Isometry;
use crate::recording::{Loss, Readout, read_tags};

/// Judge the tags of a capture against the truth
///
/// Valid tags are compared with the true poses of camera_link at the same time: distance in x and y, yaw, tilt (the
/// angle between the up axes), roll and pitch; how often the 95 % ellipse holds the truth, and the normalised error
/// squared (NEES, 2 when the covariance is right).
///
/// An ambiguous tag holds two poses, its own and the mirror pose, and cannot know which: the one nearer to the truth is
/// judged, and how many there are is told.
///
/// A truth that has no time in common with the tags is an error; errors of metres come with a warning that it may be the
/// truth of another walk. What a damaged or incomplete capture no longer holds is named (exit code 3).
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim eval captures/2026-11-21T10-00-00Z-robot --truth mocap.mcap")]
pub struct EvalArguments {
    /// A capture's folder, or one of its segments; with --poses any log
    capture: PathBuf,
    /// Judge the poses of this topic in place of tags: whatever program made them (PoseStamped,
    /// PoseWithCovarianceStamped or Odometry; of camera_link in map)
    #[arg(long, value_name = "TOPIC")]
    poses: Option<String>,
    /// The log with the true poses
    #[arg(long, value_name = "LOG")]
    truth: PathBuf,
    /// Topic of the true poses
    #[arg(long, value_name = "TOPIC", default_value_t = Topics::default().ground_truth)]
    truth_topic: String,
}

/// A larger median error does not come from tagging: the truth is that of another walk, or the tags are in the other half
/// of the field.
const IMPLAUSIBLE_MEDIAN_CM: f64 = 100.0;

#[derive(Serialize)]
struct Report<'a> {
    #[serde(flatten)]
    comparison: &'a Comparison,
    /// Ambiguous tags whose mirror pose is the true one.
    in_the_other_half: usize,
    /// Reason why these errors may not be those of the tags.
    warning: Option<String>,
    lost: Vec<Loss>,
}

pub fn run(arguments: &EvalArguments, json: bool) -> anyhow::Result<Outcome> {
    let Readout { found: tags, losses: mut lost, warnings } = judged_poses(arguments)?;
    let truth = read_truth(&arguments.truth, &arguments.truth_topic)?;
    lost.extend(truth.losses);
    let truth = truth.found;
    let nearer = up_to_mirror(&tags, &truth);
    let turned = |(tag, nearer): &(&Tagged, &Tagged)| tag.valid && tag.pose != nearer.pose;
    let in_the_other_half = tags.iter().zip(&nearer).filter(turned).count();
    let comparison = compare(&nearer, &truth);
    if comparison.valid > 0 && comparison.judged == 0 {
        bail!(
            "{}: none of its true poses is near the time of a valid tag: the tags are of {}, the truth is of {}: \
             is it the truth of another walk?",
            arguments.truth.display(),
            span(tags.iter().filter(|tag| tag.valid).map(|tag| tag.stamp_ns)),
            span(truth.iter().map(|(stamp_ns, _)| *stamp_ns))
        );
    }
    let doubt = doubt_reason(&comparison, &tags, &truth).map(|doubt| format!("{}: {doubt}", arguments.truth.display()));
    let warnings: Vec<String> = warnings.into_iter().chain(doubt).collect();
    output::losses(&lost);
    warnings.iter().for_each(|warning| eprintln!("realitysim: warning: {warning}"));
    let warning = (!warnings.is_empty()).then(|| warnings.join("; "));
    if json {
        output::json(&Report { comparison: &comparison, in_the_other_half, warning, lost: lost.clone() })?
    } else {
        output::lines(&table(&comparison, in_the_other_half))?
    }
    Ok(Outcome::of(&lost))
}

fn judged_poses(arguments: &EvalArguments) -> anyhow::Result<Readout<Tagged>> {
    if let Some(topic) = &arguments.poses {
        return Ok(read_poses(&arguments.capture, topic)?);
    }
    let Readout { found, losses, warnings } = read_tags(&arguments.capture)?;
    Ok(Readout { found: found.iter().map(tagged).collect(), losses, warnings })
}

fn doubt_reason(comparison: &Comparison, tags: &[Tagged], truth: &[(i64, Isometry)]) -> Option<String> {
    let median = comparison.position_cm.median;
    if median < IMPLAUSIBLE_MEDIAN_CM {
        return None;
    }
    if compare(&mirrored(tags), truth).position_cm.median < IMPLAUSIBLE_MEDIAN_CM.min(median / 2.0) {
        return Some(
            "the tags are in the other half of the field, which looks the same: say where the robot starts, \
             with --initial or on /initialpose"
                .to_owned(),
        );
    }
    Some(format!(
        "errors of metres (median {:.1} m): is it the truth of another walk, or not of camera_link in map?",
        median / 100.0
    ))
}

/// First to last time, in UTC.
fn span(times: impl Iterator<Item = i64> + Clone) -> String {
    let utc = |ns: Option<i64>| {
        let time = jiff::Timestamp::from_nanosecond(i128::from(ns.unwrap_or(0))).unwrap_or_default();
        time.strftime("%Y-%m-%d %H:%M:%S").to_string()
    };
    format!("{} to {} UTC", utc(times.clone().min()), utc(times.max()))
}

pub fn table(c: &Comparison, in_the_other_half: usize) -> String {
    let share = 100.0 * c.valid as f64 / c.frames.max(1) as f64;
    let mut text = format!("{} frames, {} valid ({share:.1} %)", c.frames, c.valid);
    if c.without_truth > 0 {
        text.push_str(&format!(", {} of them without a truth near their time", c.without_truth));
    }
    if c.judged == 0 {
        text.push_str(": nothing to judge");
        return text;
    }
    if c.ambiguous > 0 {
        text.push_str(&format!(
            "\n{} of them may as well be in the other half of the field: judged by the nearer of both poses, {} of them by \
             the mirror pose",
            c.ambiguous, in_the_other_half
        ));
    }
    text.push_str("\n\n  error          mean   median      p95      max\n");
    for (name, unit, summary) in [
        ("position", "cm", &c.position_cm),
        ("yaw", "deg", &c.yaw_deg),
        ("tilt", "deg", &c.tilt_deg),
        ("roll", "deg", &c.roll_deg),
        ("pitch", "deg", &c.pitch_deg),
    ] {
        text.push_str(&output::row(name, unit, Some(summary)));
        text.push('\n');
    }
    if c.nees.is_infinite() {
        text.push_str("\n  the poses state no covariance");
        return text;
    }
    text.push_str(&format!(
        "\n  the 95 % ellipse holds the truth in {:.1} % of the frames; NEES {:.2} (2 is right)",
        100.0 * c.ellipse95_share,
        c.nees
    ));
    text
}
