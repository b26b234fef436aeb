//! Command `realitysim tag`: finds the pose of a single image.

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::Args;
use serde::Serialize;

use super::paths::{check_output, save};
use super::photo::{self, OtherInputs, PhotoArguments};
use super::settings::{check_initial, field_size, planar_pose};
use super::values::any_whole;
use super::{Outcome, output};
use crate::config::{field_names, load_field_of_size};
use crate::evaluation::drawing;
use crate::geometry::{Field, Pose2};
use crate::tagging::single_image::{FitQuality, ImageLocation, Look, PoseHypothesis};

/// Find the pose of a single image
///
/// Lens and height are known, and the tilt to about two degrees; where the camera stood, which way it looked and how it
/// was tilted is found from the field lines: over the whole field, or near --initial. A field looks the same from both
/// goals: the mirror pose (-x, -y, yaw + 180) explains the image as well. Without --field all shipped fields are tried.
///
/// The fit is good, doubtful (it leaves much unexplained, or a pose elsewhere explains the image nearly as well) or none: no pose
/// found, exit code 1.
#[derive(Args)]
#[command(after_long_help = concat!(
    "Example:",
    "\n  realitysim tag photo.jpg --lens camera.yaml --attitude 0,25 --height 0.55 --overlay out.png",
))]
pub struct TagArguments {
    /// A JPEG or PNG
    image: PathBuf,
    /// Lens file (of ROS, OpenCV, Kalibr, OCamCalib, mrcal, VisualMesh or this program), shipped camera, or equidistant:180deg
    #[arg(long, value_name = "FILE")]
    lens: String,
    #[command(flatten)]
    photo: PhotoArguments,
    /// A shipped field (config/fields) or the path of a field file
    #[arg(long, value_name = "NAME")]
    field: Option<String>,
    /// Length and width of the field between the centres of its lines, metres: see `replay`
    #[arg(long, value_name = "LxW", value_parser = field_size, requires = "field")]
    field_size: Option<[f64; 2]>,
    /// About where camera_link is: on the field or at most 1 m off its carpet
    #[arg(long, value_name = "x,y,yaw_deg", value_parser = planar_pose, allow_hyphen_values = true)]
    initial: Option<Pose2>,
    /// PNG of the image's size whose dark pixels hide the robot's own body
    #[arg(long, value_name = "PNG")]
    body_mask: Option<String>,
    /// Write the image with the projected lines
    #[arg(long, value_name = "PNG")]
    overlay: Option<PathBuf>,
    /// Seed of all random numbers
    #[arg(long, value_name = "S", default_value_t = 1, value_parser = any_whole::<u64>)]
    seed: u64,
}

/// Colour of the projected lines.
const LINE_COLOUR: [u8; 3] = [230, 30, 60];

#[derive(Serialize)]
struct Report {
    field: String,
    fit: FitQuality,
    /// Pose of `camera_link` in `map`; null without any line in view.
    best: Option<Explanation>,
    mirror: Option<Pose>,
    /// Attitude and height of the best pose.
    roll_deg: f64,
    pitch_deg: f64,
    z: f64,
    /// Second best pose on the same field.
    next: Option<Explanation>,
    /// Best pose on each field that was tried.
    fields: Vec<FieldResult>,
}

/// A pose with its scores. Numbers without a unit are shares, 0 to 1, unless [`PoseHypothesis`] says otherwise.
#[derive(Clone, Copy, Serialize)]
struct Explanation {
    pose: Pose,
    refined: bool,
    /// Share of the expected line places that fit.
    fitting: f64,
    foremost: f64,
    explained: f64,
    digits: f64,
    half_seen_px: f64,
    places: usize,
    share: f64,
    weight: f64,
    log_likelihood: f64,
}

impl Explanation {
    fn of(found: &PoseHypothesis) -> Self {
        Self {
            pose: Pose::of(&found.place()),
            refined: found.refined,
            fitting: found.lines.share,
            foremost: found.lines.foremost,
            explained: found.explained,
            digits: found.lines.digits,
            half_seen_px: found.lines.half_seen_px,
            places: found.lines.expected,
            share: found.share,
            weight: found.weight,
            log_likelihood: found.log_likelihood,
        }
    }
}

#[derive(Clone, Copy, Serialize)]
struct Pose {
    x: f64,
    y: f64,
    yaw_deg: f64,
}

impl Pose {
    fn of(pose: &Pose2) -> Self {
        Self { x: pose.x, y: pose.y, yaw_deg: pose.yaw.to_degrees() }
    }
}

#[derive(Serialize)]
struct FieldResult {
    field: String,
    log_likelihood: f64,
    share: f64,
}

pub fn run(arguments: &TagArguments, json: bool) -> anyhow::Result<Outcome> {
    let shown = || arguments.image.display().to_string();
    if let Some(overlay) = &arguments.overlay {
        check_output(overlay, &inputs(arguments))?;
    }
    let beside =
        OtherInputs { lens: &arguments.lens, body_mask: arguments.body_mask.as_deref(), initial: arguments.initial };
    let (picture, known) = arguments.photo.open(&arguments.image, &beside)?;
    let fields = fields(arguments)?;
    // What a picture shows depends on how wide its lines are, and most fields share a width.
    let mut looks: Vec<(f64, Look)> = Vec::new();
    let locate = |(name, field): (String, Field)| {
        let width_m = field.line_width();
        let known_width = looks.iter().position(|(other_m, _)| *other_m == width_m);
        let index = known_width.unwrap_or_else(|| {
            looks.push((width_m, known.look(&picture, width_m)));
            looks.len() - 1
        });
        let located = known.locate(&looks[index].1, &field, arguments.seed);
        (name, field, located)
    };
    let mut results: Vec<(String, Field, ImageLocation)> = fields.into_iter().map(locate).collect();
    let score = |located: &ImageLocation| located.found.first().map_or(f64::NEG_INFINITY, |found| found.log_likelihood);
    // Wide lines are seen farther away, so that log likelihoods on fields with other lines compare only roughly.
    results.sort_by(|a, b| a.2.fit().cmp(&b.2.fit()).then(score(&b.2).total_cmp(&score(&a.2))));
    let Some((name, field, located)) = results.first() else { anyhow::bail!("{}: no field to try", shown()) };
    let best = located.found.first();
    if let (Some(path), Some(best)) = (&arguments.overlay, best) {
        let rgb = photo::rgb(&picture).with_context(shown)?;
        save(&drawing::overlay(&rgb, &known.lens, &best.map_from_link, field, LINE_COLOUR), path)?;
    }
    let tilt = best.map_or(known.attitude, |best| best.map_from_link.euler());
    let report = Report {
        field: name.clone(),
        fit: located.fit(),
        best: best.map(Explanation::of),
        mirror: best.map(|best| Pose::of(&best.place().mirrored())),
        roll_deg: tilt.roll.to_degrees(),
        pitch_deg: tilt.pitch.to_degrees(),
        z: best.map_or(known.height_m, |best| best.map_from_link.translation.z),
        next: located.found.get(1).map(Explanation::of),
        fields: results
            .iter()
            .filter_map(|(field, _, located)| {
                let PoseHypothesis { log_likelihood, share, .. } = *located.found.first()?;
                Some(FieldResult { field: field.clone(), log_likelihood, share })
            })
            .collect(),
    };
    if json {
        output::json(&report)?
    } else if report.fit != FitQuality::None
        && let Some(text) = for_people(&report)
    {
        output::lines(&text)?
    }
    match report.fit {
        FitQuality::None => anyhow::bail!("{}: no pose found: {}", shown(), photo::explain_no_pose(best)),
        FitQuality::Good | FitQuality::Doubtful => Ok(Outcome::Whole),
    }
}

/// All files that are read, over which the overlay must not be written.
fn inputs(arguments: &TagArguments) -> Vec<&Path> {
    let named = [Some(&arguments.lens), arguments.body_mask.as_ref(), arguments.field.as_ref()];
    let named = named.into_iter().flatten().map(Path::new);
    named.chain([arguments.image.as_path()]).collect()
}

/// Fields to try. With --initial, only those that have that pose on or near their carpet.
fn fields(arguments: &TagArguments) -> anyhow::Result<Vec<(String, Field)>> {
    let names = arguments.field.clone().map_or_else(field_names, |name| vec![name]);
    let mut fields = Vec::new();
    let mut refused = None;
    for name in names {
        let field = Field::new(load_field_of_size(&name, arguments.field_size)?)?;
        match arguments.initial.map_or(Ok(()), |initial| check_initial(&initial, &name, &field)) {
            Ok(()) => fields.push((name, field)),
            Err(error) => refused = Some(error),
        }
    }
    match refused {
        Some(error) if fields.is_empty() => Err(error.into()),
        _ => Ok(fields),
    }
}

/// Describes the result; `None` without a best pose.
fn for_people(report: &Report) -> Option<String> {
    let Report { best: Some(best), mirror: Some(mirror), .. } = report else { return None };
    let mut text = format!(
        "x {:.3} m, y {:.3} m, yaw {:.2} deg on {}, or its mirror x {:.3}, y {:.3}, yaw {:.2}\n\
         seen from z {:.3} m with roll {:.2}, pitch {:.2} deg\n\
         {:.0} % of the expected line contrast found on {:.1} m of certain line\n",
        best.pose.x,
        best.pose.y,
        best.pose.yaw_deg,
        report.field,
        mirror.x,
        mirror.y,
        mirror.yaw_deg,
        report.z,
        report.roll_deg,
        report.pitch_deg,
        100.0 * best.share,
        0.1 * best.weight
    );
    if let Some(next) = &report.next {
        text.push_str(&format!(
            "next best: x {:.3}, y {:.3}, yaw {:.2}, log likelihood {:.1} below\n",
            next.pose.x,
            next.pose.y,
            next.pose.yaw_deg,
            best.log_likelihood - next.log_likelihood
        ));
    }
    if report.fit == FitQuality::Doubtful {
        text.push_str("doubtful: it explains too little of the lines, or another pose explains them nearly as well\n");
    }
    for field in &report.fields {
        text.push_str(&format!(
            "  {:<14} log likelihood {:6.1}, share {:.2}\n",
            field.field, field.log_likelihood, field.share
        ));
    }
    Some(text.trim_end().to_owned())
}
