//! `realitysim eval`

use std::path::PathBuf;

use clap::Args;

use super::{Outcome, output};
use crate::config::Topics;
use crate::evaluation::capture::{read_tags, read_truth, tagged};
use crate::evaluation::{Comparison, Tagged, compare};

/// Judge the tags of a capture against the truth
///
/// Valid tags are compared with the true poses of camera_link at the same time: distance in x and y, yaw, tilt (the
/// angle between the up axes), roll and pitch; how often the 95 % ellipse holds the truth, and the normalised error
/// squared (NEES, 2 when the covariance is right).
#[derive(Args)]
pub struct EvalArguments {
    /// A capture's folder, or one of its segments
    capture: PathBuf,
    /// The log with the true poses
    #[arg(long, value_name = "LOG")]
    truth: PathBuf,
    /// Topic of the true poses
    #[arg(long, value_name = "TOPIC", default_value_t = Topics::default().ground_truth)]
    truth_topic: String,
}

pub fn run(arguments: &EvalArguments, json: bool) -> anyhow::Result<Outcome> {
    let tags: Vec<Tagged> = read_tags(&arguments.capture)?.iter().map(tagged).collect();
    let truth = read_truth(&arguments.truth, &arguments.truth_topic)?;
    let comparison = compare(&tags, &truth);
    if json {
        output::json(&comparison)?
    } else {
        output::lines(&table(&comparison))?
    }
    Ok(Outcome::Whole)
}

pub fn table(c: &Comparison) -> String {
    let share = 100.0 * c.valid as f64 / c.frames.max(1) as f64;
    let mut text = format!("{} frames, {} valid ({share:.1} %)", c.frames, c.valid);
    if c.without_truth > 0 {
        text.push_str(&format!(", {} of them without a truth near their time", c.without_truth));
    }
    text.push_str("\n\n  error          mean   median      p95      max\n");
    for (name, unit, summary) in [
        ("position", "cm", &c.position_cm),
        ("yaw", "deg", &c.yaw_deg),
        ("tilt", "deg", &c.tilt_deg),
        ("roll", "deg", &c.roll_deg),
        ("pitch", "deg", &c.pitch_deg),
    ] {
        text.push_str(&output::row(name, unit, summary));
        text.push('\n');
    }
    text.push_str(&format!(
        "\n  the 95 % ellipse holds the truth in {:.1} % of the frames; NEES {:.2} (2 is right)",
        100.0 * c.ellipse95_share,
        c.nees
    ));
    text
}
