//! `realitysim tag`

use std::path::PathBuf;

use anyhow::Context;
use clap::Args;
use serde::Serialize;

use super::settings::{UsageError, numbers, planar_pose};
use super::{Outcome, output};
use crate::agent::single::{Found, Known};
use crate::config::{field_names, load_field, load_lens_for_image};
use crate::evaluation::drawing;
use crate::geometry::{Euler, Field, Pose2};
use crate::sensors::{body_mask, decode};

/// Find the pose of a single image
///
/// Lens, tilt and height are known; where the camera stood and which way it looked is found from the field lines: over
/// the whole field, or near --initial. A field looks the same from both goals: the mirror pose (-x, -y, yaw + 180)
/// explains the image as well. Without --field all shipped fields are tried.
#[derive(Args)]
pub struct TagArguments {
    /// A JPEG or PNG
    image: PathBuf,
    /// Lens file: TOML (config/cameras), ROS camera_calibration, Kalibr camchain or VisualMesh YAML
    #[arg(long, value_name = "FILE")]
    lens: String,
    /// Roll and pitch of camera_link, pitch > 0 looks down (a VisualMesh file has its own)
    #[arg(long, value_name = "roll_deg,pitch_deg", value_parser = attitude, allow_hyphen_values = true)]
    attitude: Option<Euler>,
    /// Height of camera_link above the carpet (a VisualMesh file has its own)
    #[arg(long, value_name = "M")]
    height: Option<f64>,
    /// A shipped field (config/fields) or the path of a field file
    #[arg(long, value_name = "NAME")]
    field: Option<String>,
    /// About where camera_link is
    #[arg(long, value_name = "x,y,yaw_deg", value_parser = planar_pose, allow_hyphen_values = true)]
    initial: Option<Pose2>,
    /// PNG of the image's size whose dark pixels hide the robot's own body
    #[arg(long, value_name = "PNG")]
    body_mask: Option<String>,
    /// Write the image with the projected lines
    #[arg(long, value_name = "PNG")]
    overlay: Option<PathBuf>,
    /// Seed of all random numbers
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
}

/// Colour of the projected lines.
const LINES: [u8; 3] = [230, 30, 60];

#[derive(Serialize)]
struct Report {
    field: String,
    /// `camera_link` in `map`.
    best: Found,
    mirror: Pose,
    roll_deg: f64,
    pitch_deg: f64,
    z: f64,
    /// The next best explanation on the same field.
    next: Option<Found>,
    /// Of every field that was tried.
    fields: Vec<FieldResult>,
}

#[derive(Serialize)]
struct Pose {
    x: f64,
    y: f64,
    yaw_deg: f64,
}

#[derive(Serialize)]
struct FieldResult {
    field: String,
    log_likelihood: f64,
    share: f64,
}

pub fn run(arguments: &TagArguments, json: bool) -> anyhow::Result<Outcome> {
    let shown = || arguments.image.display().to_string();
    let bytes = std::fs::read(&arguments.image).with_context(shown)?;
    let picture = decode::compressed(&bytes).with_context(shown)?;
    let (width, height) = (picture.width as u32, picture.height as u32);
    let lens = load_lens_for_image(&arguments.lens, width, height)?;
    let stated = lens.visual_mesh_pose.map(|pose| pose.world_from_camera_link);
    let attitude = arguments.attitude.or(stated.map(|pose| pose.euler())).ok_or_else(|| {
        UsageError(format!("--attitude is missing, and {} does not say how the camera was tilted", arguments.lens))
    })?;
    let height_m = arguments.height.or(stated.map(|pose| pose.translation.z)).ok_or_else(|| {
        UsageError(format!("--height is missing, and {} does not say how high the camera was", arguments.lens))
    })?;
    if !(0.01..=100.0).contains(&height_m) {
        return Err(UsageError(format!("--height is {height_m}: it must be 0.01 to 100 m")).into());
    }
    let body = match &arguments.body_mask {
        Some(png) => Some(body_mask(png, width, height).map_err(|message| UsageError(format!("{png}: {message}")))?),
        None => None,
    };
    let known = Known { lens: lens.lens, attitude, height_m, initial: arguments.initial, body };
    let seen = known.look(&picture);
    let names = arguments.field.clone().map_or_else(field_names, |name| vec![name]);
    let mut results: Vec<(String, Field, Vec<Found>)> = Vec::new();
    for name in names {
        let field = Field::new(load_field(&name)?)?;
        let located = known.locate(&seen, &field, arguments.seed);
        results.push((name, field, located.found));
    }
    let score = |found: &[Found]| found.first().map_or(f64::NEG_INFINITY, |found| found.log_likelihood);
    results.sort_by(|a, b| score(&b.2).total_cmp(&score(&a.2)));
    let Some((name, field, found)) = results.first() else { anyhow::bail!("{}: no field to try", shown()) };
    let Some(best) = found.first() else {
        anyhow::bail!("{}: no ground of the field is in view: check --attitude, --height and the lens", shown());
    };
    if let Some(path) = &arguments.overlay {
        let rgb = image::RgbImage::from_raw(width, height, picture.to_rgb());
        let rgb = rgb.with_context(|| format!("{}: its pixels do not fit its size", shown()))?;
        let drawn = drawing::overlay(&rgb, &known.lens, &known.map_from_link(&best.pose), field, LINES);
        drawn.save(path).with_context(|| path.display().to_string())?;
    }
    let mirror = best.pose.mirrored();
    let report = Report {
        field: name.clone(),
        best: *best,
        mirror: Pose { x: mirror.x, y: mirror.y, yaw_deg: mirror.yaw.to_degrees() },
        roll_deg: attitude.roll.to_degrees(),
        pitch_deg: attitude.pitch.to_degrees(),
        z: height_m,
        next: found.get(1).copied(),
        fields: results
            .iter()
            .filter_map(|(field, _, found)| {
                let Found { log_likelihood, share, .. } = *found.first()?;
                Some(FieldResult { field: field.clone(), log_likelihood, share })
            })
            .collect(),
    };
    if json {
        output::json(&report)?
    } else {
        output::lines(&for_people(&report))?
    }
    Ok(Outcome::Whole)
}

fn for_people(report: &Report) -> String {
    let Report { best, mirror, .. } = report;
    let mut text = format!(
        "x {:.3} m, y {:.3} m, yaw {:.2} deg on {}, or its mirror x {:.3}, y {:.3}, yaw {:.2}\n\
         {:.0} % of the expected line contrast found on {:.1} m of certain line\n",
        best.pose.x,
        best.pose.y,
        best.pose.yaw.to_degrees(),
        report.field,
        mirror.x,
        mirror.y,
        mirror.yaw_deg,
        100.0 * best.share,
        0.1 * best.weight
    );
    if let Some(next) = &report.next {
        text.push_str(&format!(
            "next best: x {:.3}, y {:.3}, yaw {:.2}, log likelihood {:.1} below\n",
            next.pose.x,
            next.pose.y,
            next.pose.yaw.to_degrees(),
            best.log_likelihood - next.log_likelihood
        ));
    }
    for field in &report.fields {
        text.push_str(&format!(
            "  {:<14} log likelihood {:6.1}, share {:.2}\n",
            field.field, field.log_likelihood, field.share
        ));
    }
    text.trim_end().to_owned()
}

fn attitude(text: &str) -> Result<Euler, String> {
    let [roll_deg, pitch_deg] = numbers::<2>(text, "roll_deg,pitch_deg")?;
    Ok(Euler { yaw: 0.0, pitch: pitch_deg.to_radians(), roll: roll_deg.to_radians() })
}
