//! Command `realitysim measure view-walk`: makes views along a straight path.

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::Context;
use clap::Args;
use glam::{DQuat, DVec3};
use image::RgbImage;
use jpeg_encoder::ColorType;
use serde::Serialize;

use crate::cli::paths::{check_output, make_folder, save, write, write_bytes};
use crate::cli::settings::planar_pose;
use crate::cli::values::{number, whole};
use crate::cli::{Outcome, output};
use crate::config::Settings;
use crate::database::{ImageDatabase, ViewQuery};
use crate::evaluation::{Summary, drawing};
use crate::geometry::{Euler, Isometry, Pose2, wrap_angle};
use crate::log_input::encode::jpeg;
use crate::tagging::single_image::{ImagePrior, MEASURED_HEIGHT_SIGMA_M};
use crate::views::{MAX_HEIGHT_M, MAX_TURN_DEG, MIN_HEIGHT_M, Method};
use crate::vision::Picture;

/// Walk through a database: views along a straight way, as in Fig. 11 and 12 of the paper
///
/// By default from the paper's (0, 3, 0) to (8, 6, 4), read as half metres from the field's corner and radians: that is our
/// reading, the paper does not say. Writes sheet.png, walk.csv and the views as frames/00000.jpg and so on. How evenly the lines move is measured by finding the
/// pose of every view from its lines and comparing it with the one asked for.
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim measure view-walk --db images/ --from -2,0,0 --to 2,0.5,90")]
pub struct ViewWalkArguments {
    /// The database's folder
    #[arg(long, value_name = "DIR")]
    db: PathBuf,
    /// Of camera_link
    #[arg(long, value_name = "x,y,yaw_deg", value_parser = planar_pose, allow_hyphen_values = true)]
    from: Option<Pose2>,
    /// Of camera_link; the turn is as the numbers say, more than half a turn is not shortened
    #[arg(long, value_name = "x,y,yaw_deg", value_parser = planar_pose, allow_hyphen_values = true)]
    to: Option<Pose2>,
    /// Height of camera_link; without it the mean of the database's
    #[arg(long, value_name = "M", allow_negative_numbers = true, value_parser = number(MIN_HEIGHT_M..=MAX_HEIGHT_M))]
    z: Option<f64>,
    /// Degrees, above 0 looks down; without it the mean of the database's
    #[arg(long, value_name = "DEG", allow_hyphen_values = true, value_parser = number(-MAX_TURN_DEG..=MAX_TURN_DEG))]
    pitch: Option<f64>,
    /// Views
    #[arg(long, value_name = "N", default_value_t = 60, value_parser = whole(2..=10_000u16))]
    frames: u16,
    /// Where the pictures go
    #[arg(short, long, value_name = "DIR", default_value = "walk")]
    output: PathBuf,
    /// Robot config, for its section [views]
    #[arg(long, value_name = "FILE")]
    config: Option<String>,
}

#[derive(Serialize)]
struct Report {
    views: usize,
    stored: usize,
    /// Pose found from the view's lines against the pose asked for.
    position_cm: Option<Summary>,
    yaw_deg: Option<Summary>,
    /// Change of that difference between neighbouring views, which the eye sees as a jump.
    jump_cm: Option<Summary>,
    /// Views whose pose could not be found from their lines.
    not_found: usize,
    /// Share of the lens's image that the views fill.
    valid_share: Shares,
    output: PathBuf,
}

#[derive(Serialize)]
struct Shares {
    least: f64,
    mean: f64,
}

struct Step {
    asked: Pose2,
    found: Option<Pose2>,
    made: &'static str,
    valid_share: f64,
}

const JPEG_QUALITY: u8 = 90;
/// Width and number of the small pictures on the sheet.
const THUMB_PX: u32 = 320;
const THUMBS: usize = 15;
const THUMB_COLUMNS: u32 = 5;

pub fn run(arguments: &ViewWalkArguments, json: bool) -> anyhow::Result<Outcome> {
    let settings = arguments.config.as_deref().map_or(Ok(Settings::default()), Settings::load)?;
    let folder = &arguments.output;
    check_output(folder, &[&arguments.db])?;
    make_folder(folder)?;
    let database = ImageDatabase::open(&arguments.db, &settings.views)?;
    anyhow::ensure!(!database.index().is_empty(), crate::database::DatabaseError::Empty);
    let (from, to) = end_poses(arguments, &database);
    let (mean_z, mean_pitch) = mean_height_and_pitch(&database);
    let (z, pitch) = (arguments.z.unwrap_or(mean_z), arguments.pitch.map_or(mean_pitch, f64::to_radians));
    let frames = usize::from(arguments.frames);
    let (mut steps, mut thumbs, mut camera) = (Vec::new(), Vec::new(), None);
    let pictures = folder.join("frames");
    make_folder(&pictures)?;
    let mut progress = output::Progress::new("walking");
    for frame in 0..frames {
        let part = frame as f64 / (frames - 1) as f64;
        let asked = Pose2 {
            x: from.x + part * (to.x - from.x),
            y: from.y + part * (to.y - from.y),
            yaw: from.yaw + part * (to.yaw - from.yaw),
        };
        let attitude = Euler { yaw: asked.yaw, pitch, roll: 0.0 };
        let map_from_link = Isometry::from_euler(attitude, DVec3::new(asked.x, asked.y, z));
        let wanted = ViewQuery {
            map_from_link,
            method: Method::Exact,
            camera: camera.clone(),
            max_distance_m: f64::INFINITY,
            may_be_stored: true,
            without: Vec::new(),
        };
        let shown = database.view(&wanted)?;
        let image = &shown.answer.image;
        let (width, height, rgb) = (image.width, image.height, image.to_rgb());
        let picture = jpeg(&rgb, width, height, ColorType::Rgb, JPEG_QUALITY)?;
        write_bytes(&pictures.join(format!("{frame:05}.jpg")), &picture)?;
        let known = ImagePrior {
            lens: shown.camera.lens().clone(),
            attitude,
            tilt_sigma_rad: 0.0,
            height_m: z,
            height_sigma_m: MEASURED_HEIGHT_SIGMA_M,
            initial: Some(Pose2 { yaw: wrap_angle(asked.yaw), ..asked }),
            body: None,
        };
        let picture = Picture::from_rgb(width, height, &rgb).context("a view without pixels")?;
        let located = known.locate(&known.look(&picture, database.field().line_width()), database.field(), 1);
        let found = located.found.first().filter(|found| found.refined).map(|found| found.place());
        let made = match shown.answer.made {
            crate::views::Provenance::Stored => "stored",
            _ => "made",
        };
        steps.push(Step { asked, found, made, valid_share: shown.answer.valid_share });
        if thumbs.len() * frames <= frame * THUMBS {
            let full = RgbImage::from_raw(width as u32, height as u32, rgb).context("a view without pixels")?;
            let high = THUMB_PX * height as u32 / width as u32;
            let words = format!("{:.2}, {:.2}, {:.0} deg", asked.x, asked.y, asked.yaw.to_degrees());
            thumbs.push((drawing::scaled(&full, THUMB_PX, high), words));
        }
        camera.get_or_insert_with(|| Arc::clone(&shown.camera));
        progress.set(frame as u64 + 1, Some(frames as u64));
    }
    progress.finish();
    save(&drawing::panels(&thumbs, THUMB_COLUMNS), &folder.join("sheet.png"))?;
    write(&folder.join("walk.csv"), &csv(&steps))?;
    let report = report(&steps, folder.clone());
    if json {
        output::json(&report)?;
    } else {
        let Report { views, stored, not_found, position_cm, yaw_deg, jump_cm, valid_share, .. } = &report;
        let table = [
            output::row("position", "cm", position_cm.as_ref()),
            output::row("yaw", "deg", yaw_deg.as_ref()),
            output::row("jump", "cm", jump_cm.as_ref()),
        ];
        output::lines(&format!(
            "{views} views, {stored} of them stored images, that show {:.1} % of the picture (the least {:.1} %); {not_found} whose \
             lines do not tell where they are\n  by their own lines     mean   median      p95      max\n{}\n{}",
            100.0 * valid_share.mean,
            100.0 * valid_share.least,
            table.join("\n"),
            folder.display()
        ))?;
    }
    Ok(Outcome::Whole)
}

fn end_poses(arguments: &ViewWalkArguments, database: &ImageDatabase) -> (Pose2, Pose2) {
    let d = database.field().dimensions();
    let paper = |x: f64, y: f64, yaw: f64| Pose2 { x: 0.5 * x - d.length_m / 2.0, y: 0.5 * y - d.width_m / 2.0, yaw };
    (arguments.from.unwrap_or(paper(0.0, 3.0, 0.0)), arguments.to.unwrap_or(paper(8.0, 6.0, 4.0)))
}

/// Mean height (m) and pitch (rad) of the database's images.
fn mean_height_and_pitch(database: &ImageDatabase) -> (f64, f64) {
    let count = database.index().len() as f64;
    let (mut z, mut pitch) = (0.0, 0.0);
    for record in database.index().records() {
        let [x, y, qz, w] = record.rotation.map(f64::from);
        z += f64::from(record.place[2]) / count;
        pitch += Euler::from_rotation(DQuat::from_xyzw(x, y, qz, w)).pitch / count;
    }
    (z, pitch)
}

fn report(steps: &[Step], output: PathBuf) -> Report {
    let off = |step: &Step| {
        let found = step.found?;
        Some((found.x - step.asked.x, found.y - step.asked.y, wrap_angle(found.yaw - step.asked.yaw)))
    };
    let found: Vec<(f64, f64, f64)> = steps.iter().filter_map(off).collect();
    let jumps = steps.windows(2).filter_map(|pair| {
        let (a, b) = (off(&pair[0])?, off(&pair[1])?);
        Some(100.0 * libm::hypot(b.0 - a.0, b.1 - a.1))
    });
    let summary = |values: Vec<f64>| (!values.is_empty()).then(|| Summary::of(&values));
    Report {
        views: steps.len(),
        stored: steps.iter().filter(|step| step.made == "stored").count(),
        position_cm: summary(found.iter().map(|off| 100.0 * libm::hypot(off.0, off.1)).collect()),
        yaw_deg: summary(found.iter().map(|off| off.2.abs().to_degrees()).collect()),
        jump_cm: summary(jumps.collect()),
        not_found: steps.len() - found.len(),
        valid_share: Shares {
            least: steps.iter().map(|step| step.valid_share).fold(1.0, f64::min),
            mean: steps.iter().map(|step| step.valid_share).sum::<f64>() / steps.len() as f64,
        },
        output,
    }
}

fn csv(steps: &[Step]) -> String {
    let mut text = "x,y,yaw_deg,made,valid_share,found_x,found_y,found_yaw_deg\n".to_owned();
    for Step { asked, found, made, valid_share } in steps {
        let yaw_deg = asked.yaw.to_degrees();
        text.push_str(&format!("{:.6},{:.6},{yaw_deg:.6},{made},{valid_share:.4},", asked.x, asked.y));
        match found {
            Some(found) => text.push_str(&format!("{:.6},{:.6},{:.6}\n", found.x, found.y, found.yaw.to_degrees())),
            None => text.push_str(",,\n"),
        }
    }
    text
}
