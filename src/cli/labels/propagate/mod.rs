//! Command `realitysim labels propagate`: one click makes the boxes of an object that stands still in all frames that see it.

mod click;
mod files;
mod sightings;
mod standing;

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use serde::Serialize;

use super::super::export::frames::fill_own_folder;
use super::super::opened_database::OpenedDatabase;
use super::super::paths::check_output;
use super::super::settings::UsageError;
use super::super::values::any_number;
use super::super::{Outcome, output};
use super::posed_images::PosedImages;
use crate::labels::NoBox;
use crate::recording::Loss;
use click::{Click, Frame};
use sightings::{Finding, Sighting};
use standing::Standing;

/// Make boxes of a ball or robot that stands still, in all frames that see it, out of one click
///
/// Point at the middle of the object in one frame: its radius and the pose of that frame say where on the carpet it stands, and each other
/// pose says where in its frame that is. The object counts as a sphere that rests on the carpet; of a robot, take half its height as
/// radius. Frames are left out in which something else is seen there than in yours, so it may be taken away or hidden.
///
/// coco: images/ and annotations.json. yolo: images/, labels/ and data.yaml. Each has preview.jpg to look at: boxes green, or red where
/// something else is seen.
#[derive(Args)]
#[command(after_long_help = concat!(
    "Example:",
    "\n  realitysim labels propagate images/ --at 42,311,207,0.07 --format coco -o ball/",
))]
pub struct PropagateArguments {
    /// A capture's folder, or the folder of a database of one capture
    #[arg(value_name = "CAPTURE|DB")]
    input: PathBuf,
    /// Number of a frame, counted from 0 as in `explain --frame`; pixel of the object's middle, counted from 0 at the left upper one; its
    /// radius in metres, 0.01 to 1
    #[arg(long, value_name = "FRAME,u,v,radius", value_parser = click::parse)]
    at: Click,
    /// Form of the labels
    #[arg(long)]
    format: BoxFormat,
    /// Folder to write, outside of any capture
    #[arg(short, long)]
    output: PathBuf,
    /// Name of the object's class
    #[arg(long, value_name = "NAME", default_value = "ball", value_parser = class_name)]
    class: String,
    /// Since when it has stood there, in seconds after the first frame
    #[arg(long, value_name = "S", allow_negative_numbers = true, value_parser = any_number)]
    from: Option<f64>,
    /// Until when, in seconds after the first frame
    #[arg(long, value_name = "S", allow_negative_numbers = true, value_parser = any_number)]
    to: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum BoxFormat {
    Coco,
    Yolo,
}

#[derive(Serialize)]
struct Report {
    output: PathBuf,
    /// Where the object stands in `map`, metres.
    x: f64,
    y: f64,
    radius_m: f64,
    /// Frames with a valid pose within the time.
    frames: usize,
    /// Frames that should see it, by their poses.
    in_view: usize,
    /// Frames with a box.
    labelled: usize,
    /// Frames that should see it, and show something else.
    something_else: usize,
    /// Frames of whose box twice the standard deviation is more than a third of its side.
    uncertain: usize,
    /// Frames in which it is too small.
    small: usize,
    /// From when on it is gone, seconds after the first frame.
    gone_from_s: Option<f64>,
    /// Before when it was not there yet.
    absent_until_s: Option<f64>,
    /// Median standard deviation of the boxes' places, pixels.
    sigma_px: Option<f64>,
    /// Frames that should see it.
    seen: Vec<SeenRow>,
    lost: Vec<Loss>,
}

/// A frame that should see the object.
#[derive(Serialize)]
struct SeenRow {
    frame: u64,
    time_s: f64,
    /// How like the picture that was pointed at it is, 1 if it is the same.
    similarity: f64,
    labelled: bool,
}

/// Accepts a name that every reader of the formats takes as it is.
fn class_name(text: &str) -> Result<String, String> {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | ' ');
    let is_name = text.starts_with(|c: char| c.is_ascii_alphabetic()) && text.chars().all(is_plain) && text.len() <= 40;
    if is_name {
        return Ok(text.to_owned());
    }
    Err("a letter and up to 39 further letters, digits, blanks, _ or - are needed".to_owned())
}

pub fn run(arguments: &PropagateArguments, json: bool) -> anyhow::Result<Outcome> {
    let PropagateArguments { input, output, from, to, .. } = arguments;
    check_output(output, &[input])?;
    let (from_s, to_s) = (from.unwrap_or(0.0), to.unwrap_or(f64::INFINITY));
    // Written so that a NaN is refused, too.
    if !(from_s >= 0.0 && to_s > from_s) {
        return Err(UsageError(format!(
            "--from {from_s} --to {to_s}: the time begins at 0 or later and ends after that"
        ))
        .into());
    }
    let report = fill_own_folder(output, || propagate(arguments, from_s..=to_s))?;
    output::losses(&report.lost);
    if json {
        output::json(&report)?;
    } else {
        output::lines(&text(&report, &arguments.class))?;
    }
    Ok(Outcome::of(&report.lost))
}

/// Largest standard deviation of a pose, metres: each box states its own error.
const MAX_SIGMA_M: f64 = 1.0;

fn propagate(arguments: &PropagateArguments, time_s: core::ops::RangeInclusive<f64>) -> anyhow::Result<Report> {
    let opened = OpenedDatabase::of(&arguments.input, MAX_SIGMA_M)?;
    let images = PosedImages::new(&opened.database)?;
    let clicked = click::find(&images, &arguments.input, arguments.at)?;
    let sightings = sightings::look(&images, &clicked, time_s)?;
    let in_view = sightings.iter().filter(|sighting| sighting.seen().is_some()).count();
    anyhow::ensure!(
        sightings.iter().any(|sighting| sighting.labelled().is_some()),
        "nothing was written: of {in_view} frames within --from and --to that should see the {} none does",
        arguments.class
    );
    let files = files::Files { folder: &arguments.output, format: arguments.format, class: &arguments.class };
    let unreadable = files.write(&images, &sightings)?;
    let mut report = report(arguments, &clicked, &sightings);
    report.lost = opened.lost.iter().cloned().chain(unreadable).collect();
    Ok(report)
}

fn report(arguments: &PropagateArguments, clicked: &click::Clicked, sightings: &[Sighting]) -> Report {
    let count = |is: fn(&Finding) -> bool| sightings.iter().filter(|sighting| is(&sighting.finding)).count();
    let standing = Standing::of(sightings.iter().filter_map(Sighting::seen));
    let mut sigmas: Vec<f64> = sightings.iter().filter_map(|s| Some(s.labelled()?.sigma_px)).collect();
    sigmas.sort_by(f64::total_cmp);
    let (labelled, something_else) = (sigmas.len(), count(|finding| matches!(finding, Finding::SomethingElse(..))));
    Report {
        output: arguments.output.clone(),
        x: clicked.sphere.centre.x,
        y: clicked.sphere.centre.y,
        radius_m: clicked.sphere.radius_m,
        frames: sightings.len(),
        in_view: labelled + something_else,
        labelled,
        something_else,
        uncertain: count(|finding| matches!(finding, Finding::NoBox(NoBox::Uncertain))),
        small: count(|finding| matches!(finding, Finding::NoBox(NoBox::Small))),
        gone_from_s: standing.gone_from_s,
        absent_until_s: standing.absent_until_s,
        sigma_px: sigmas.get(sigmas.len() / 2).copied(),
        seen: sightings.iter().filter_map(seen_row).collect(),
        lost: Vec::new(),
    }
}

fn seen_row(sighting: &Sighting) -> Option<SeenRow> {
    let (similarity, labelled) = match sighting.finding {
        Finding::Object(_, similarity) => (similarity, true),
        Finding::SomethingElse(_, similarity) => (similarity, false),
        Finding::NoBox(_) | Finding::Unreadable(_) => return None,
    };
    let Frame { sequence: frame, time_s, .. } = sighting.frame;
    Some(SeenRow { frame, time_s, similarity, labelled })
}

fn text(report: &Report, class: &str) -> String {
    let Report { output, x, y, in_view, labelled, uncertain, small, sigma_px, .. } = report;
    let mut text =
        format!("the {class} stands at {x:.2}, {y:.2} m; of {in_view} frames that should see it {labelled} do");
    if let Some(until) = report.absent_until_s {
        text += &format!("; before {until:.1} s it is not there");
    }
    if let Some(from) = report.gone_from_s {
        text += &format!("; from {from:.1} s on it is gone");
    }
    if let Some(sigma) = sigma_px {
        text += &format!("\nboxes are known to {sigma:.2} px (median)");
    }
    if uncertain + small > 0 {
        text += &format!(
            "\nleft out besides: {uncertain} frames whose poses do not say well enough where it is, {small} in which it is too small"
        );
    }
    text + &format!("\n{}", output.join("preview.jpg").display())
}
