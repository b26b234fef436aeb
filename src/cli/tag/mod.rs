//! Command `realitysim tag`: finds the pose of single images.

mod many;

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::Args;
use serde::Serialize;

use super::paths::{check_output, save};
use super::photo::{self, Camera, OtherInputs, PhotoArguments, by_fit};
use super::settings::{check_initial, field_size, planar_pose};
use super::values::any_whole;
use super::{Outcome, output};
use crate::config::{field_names, load_field_of_size};
use crate::evaluation::drawing;
use crate::geometry::{Field, Lens, Pose2};
use crate::tagging::image_location::{FitQuality, ImageLocation, PoseHypothesis};
use crate::vision::Picture;

/// Find the pose of single images
///
/// Lens and height are known, and the tilt to about two degrees; where the camera stood, which way it looked and how it
/// was tilted is found from the field lines: over the whole field, or near --initial. A field looks the same from both
/// goals: the mirror pose (-x, -y, yaw + 180) explains the image as well. Without --field all shipped fields are tried; if one image has
/// no pose on the field that is named, the shipped field that fits is.
///
/// Without --attitude or --height these are found from the lines, too, which takes longer and needs more lines in view.
///
/// The fit is good, doubtful (it leaves much unexplained, or a pose elsewhere explains the image nearly as well) or none: no pose
/// found. Exit code 1 if no image has a pose. Of a folder or several images --sheet shows all, the most doubtful first, and --poses writes
/// those that are good for `realitysim db add`.
#[derive(Args)]
#[command(after_long_help = concat!(
    "Examples:",
    "\n  realitysim tag photo.jpg --lens camera.yaml --attitude 0,25 --height 0.55 --overlay out.png",
    "\n  realitysim tag frames/ --lens camera.yaml --attitude-csv tilts.csv --sheet sheet.png",
))]
pub struct TagArguments {
    /// JPEGs and PNGs, or folders of them
    #[arg(required = true, value_name = "IMAGE|FOLDER")]
    images: Vec<PathBuf>,
    /// Lens file (of ROS, OpenCV, Kalibr, OCamCalib, mrcal, VisualMesh or this program), shipped camera, equidistant:180deg, or a capture
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
    /// Write the image with the projected lines; of one image
    #[arg(long, value_name = "PNG")]
    overlay: Option<PathBuf>,
    /// What is known of each image: image, and roll_deg,pitch_deg, height, or x,y,yaw_deg (about where it was taken)
    #[arg(long, value_name = "CSV")]
    attitude_csv: Option<PathBuf>,
    /// Write a page of all images with the projected lines, the most doubtful first
    #[arg(long, value_name = "PNG")]
    sheet: Option<PathBuf>,
    /// Write the poses that are good, with standard deviations, as `db add` reads them: into the folder of the images
    #[arg(long, value_name = "CSV")]
    poses: Option<PathBuf>,
    /// Seed of all random numbers
    #[arg(long, value_name = "S", default_value_t = 1, value_parser = any_whole::<u64>)]
    seed: u64,
}

/// Colour of the projected lines.
const LINE_COLOUR: [u8; 3] = [230, 30, 60];

#[derive(Serialize)]
struct Report {
    image: PathBuf,
    field: String,
    fit: FitQuality,
    /// Pose of `camera_link` in `map`; null without any line in view.
    best: Option<Explanation>,
    mirror: Option<Pose>,
    /// Attitude and height of the best pose.
    roll_deg: f64,
    pitch_deg: f64,
    z: f64,
    /// Standard deviations of the best pose; null if it is not refined.
    sigma_xy_m: Option<f64>,
    sigma_rotation_deg: Option<f64>,
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
    let named = inputs(arguments);
    let inputs: Vec<&Path> = named.iter().map(PathBuf::as_path).collect();
    for output in [&arguments.overlay, &arguments.sheet, &arguments.poses].into_iter().flatten() {
        check_output(output, &inputs)?;
    }
    match &arguments.images[..] {
        [image] if !image.is_dir() && many::arguments_given(arguments).is_none() => run_one(arguments, image, json),
        _ => many::run(arguments, json),
    }
}

/// The best poses of an image.
struct Tagged {
    lens: Lens,
    field: Field,
    located: ImageLocation,
    report: Report,
}

/// Finds the pose of one image. `initial` and `photo` are what is known of it.
fn tag(
    arguments: &TagArguments,
    photo: &PhotoArguments,
    image: &Path,
    initial: Option<Pose2>,
) -> anyhow::Result<(Picture, Tagged)> {
    let beside = OtherInputs { lens: &arguments.lens, body_mask: arguments.body_mask.as_deref(), initial };
    let (picture, camera) = photo.open_any(image, &beside)?;
    let fields = fields(arguments, initial)?;
    let mut results = camera.locate(&picture, &fields, arguments.seed);
    results.sort_by(|a, b| by_fit(&a.2, &b.2));
    let Some((name, field, located)) = results.first() else { anyhow::bail!("{}: no field to try", image.display()) };
    let best = located.found.first();
    let tilt = best.map(|best| best.map_from_link.euler());
    let sigmas = best.and_then(|best| best.sigmas);
    let report = Report {
        image: image.to_owned(),
        field: (*name).to_owned(),
        fit: located.fit(),
        best: best.map(Explanation::of),
        mirror: best.map(|best| Pose::of(&best.place().mirrored())),
        roll_deg: tilt.map_or(0.0, |tilt| tilt.roll.to_degrees()),
        pitch_deg: tilt.map_or(0.0, |tilt| tilt.pitch.to_degrees()),
        z: best.map_or(0.0, |best| best.map_from_link.translation.z),
        sigma_xy_m: sigmas.map(|sigmas| sigmas.xy_m),
        sigma_rotation_deg: sigmas.map(|sigmas| sigmas.rotation_rad.to_degrees()),
        next: located.found.get(1).map(Explanation::of),
        fields: results
            .iter()
            .filter_map(|(field, _, located)| {
                let PoseHypothesis { log_likelihood, share, .. } = *located.found.first()?;
                Some(FieldResult { field: (*field).to_owned(), log_likelihood, share })
            })
            .collect(),
    };
    let (field, located) = ((*field).clone(), located.clone());
    let lens = camera.lens().clone();
    Ok((picture, Tagged { lens, field, located, report }))
}

fn run_one(arguments: &TagArguments, image: &Path, json: bool) -> anyhow::Result<Outcome> {
    let shown = || image.display().to_string();
    let (picture, tagged) = tag(arguments, &arguments.photo, image, arguments.initial)?;
    let Tagged { lens, field, located, report } = tagged;
    let best = located.found.first();
    if let (Some(path), Some(best)) = (&arguments.overlay, best) {
        let rgb = photo::rgb(&picture).with_context(shown)?;
        save(&drawing::overlay(&rgb, &lens, &best.map_from_link, &field, LINE_COLOUR), path)?;
    }
    if json {
        output::json(&report)?
    } else if report.fit != FitQuality::None
        && let Some(text) = for_people(&report)
    {
        output::lines(&text)?
    }
    match report.fit {
        FitQuality::None => {
            let other = other_field(arguments, image)?.map_or_else(String::new, |name| {
                format!("; of the shipped fields {name} explains it best: try --field {name}")
            });
            anyhow::bail!("{}: no pose found: {}{other}", shown(), photo::explain_no_pose(Some(&located)))
        }
        FitQuality::Good | FitQuality::Doubtful => Ok(Outcome::Whole),
    }
}

/// The shipped field that explains an image best, if the one that was named explains nothing.
fn other_field(arguments: &TagArguments, image: &Path) -> anyhow::Result<Option<String>> {
    if arguments.field.is_none() {
        return Ok(None);
    }
    let beside = OtherInputs { lens: &arguments.lens, body_mask: arguments.body_mask.as_deref(), initial: None };
    // Where attitude and height are free as well, too much fits by chance, and takes minutes.
    let (picture, Camera::Known(prior)) = arguments.photo.open_any(image, &beside)? else { return Ok(None) };
    let mut placed = Vec::new();
    for name in field_names() {
        let field = Field::new(load_field_of_size(&name, None)?)?;
        let located = prior.locate_by_survey(&prior.look(&picture, field.line_width()), &field, arguments.seed);
        if located.fit() != FitQuality::None {
            placed.push((name, located));
        }
    }
    let best = placed.into_iter().min_by(|a, b| by_fit(&a.1, &b.1));
    Ok(best.map(|(name, _)| name))
}

/// All files that are read, over which nothing must be written. Poses may be written into the folder of the images.
fn inputs(arguments: &TagArguments) -> Vec<PathBuf> {
    let named = [Some(&arguments.lens), arguments.body_mask.as_ref(), arguments.field.as_ref()];
    let named = named.into_iter().flatten().map(PathBuf::from);
    let images = arguments.images.iter().filter(|image| !image.is_dir()).cloned();
    named.chain(images).chain(arguments.attitude_csv.clone()).collect()
}

/// Fields to try. With an initial pose, only those that have it on or near their carpet.
fn fields(arguments: &TagArguments, initial: Option<Pose2>) -> anyhow::Result<Vec<(String, Field)>> {
    let names = arguments.field.clone().map_or_else(field_names, |name| vec![name]);
    let mut fields = Vec::new();
    let mut refused = None;
    for name in names {
        let field = Field::new(load_field_of_size(&name, arguments.field_size)?)?;
        match initial.map_or(Ok(()), |initial| check_initial(&initial, &name, &field)) {
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
