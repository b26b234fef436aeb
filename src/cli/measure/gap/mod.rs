//! Command `realitysim measure gap`: compares recorded images with views and renderings.

mod forms;
mod judged_detector;
mod tables;

use std::path::PathBuf;

use anyhow::Context;
use clap::Args;
use image::RgbImage;
use serde::Serialize;

use crate::cli::marks::rgb;
use crate::cli::paths::{check_output, save, write};
use crate::cli::values::{number, whole};
use crate::cli::{Outcome, output};
use crate::config::Settings;
use crate::database::ImageDatabase;
use crate::evaluation::drawing;
use crate::evaluation::perception::DetectorReport;
use crate::evaluation::views::{Detection, Detector};
use crate::views::{MAX_FAR_M, NOTHING, SURE, Surface, Target, World, luma, similarity};
use crate::vision::Picture;

use forms::{FORMS, HeldOut, forms};
use judged_detector::JudgedDetector;
use tables::tables;

/// Measure the gap between recorded, made-up and rendered images
///
/// Images of the database are held out, with all others taken near them, and seen from their poses as recorded, as the exact and the
/// paper's view, as the nearest image, and rendered. What the project's line detector finds in each is compared, and their
/// brightness.
///
/// A detector of your own: --detector COMMAND is started once, reads names of PNGs from standard input, and prints what it finds in each,
/// a line for each landmark and an empty line at the end: `class u v [score]`, or a box `class u_min v_min u_max v_max [score]`. Classes are l_crossing, t_crossing, x_crossing, penalty_mark, centre and goalpost. The tables
/// say how it does by landmark, distance and light; --error-model writes a file from which simulators can sample its errors.
#[derive(Args)]
#[command(after_long_help = concat!(
    "Examples:",
    "\n  realitysim measure gap --db images/ --frames 40 -o gap.png",
    "\n  realitysim measure gap --db images/ --detector ./detect.py --error-model errors.json",
))]
pub struct GapArguments {
    /// The database's folder
    #[arg(long, value_name = "DIR")]
    db: PathBuf,
    /// How many images are held out, evenly over the database
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = whole(1..=1000u16))]
    frames: u16,
    /// Images nearer than this are held out as well
    #[arg(long, value_name = "M", default_value_t = 0.1, value_parser = number(0.0..=MAX_FAR_M))]
    apart: f64,
    /// One of the images, in all its forms
    #[arg(short, long, value_name = "PNG")]
    output: Option<PathBuf>,
    /// Run in a shell; reads names of PNGs and prints detections
    #[arg(long, value_name = "COMMAND")]
    detector: Option<String>,
    /// Model of the detector's errors on recorded images: misses, false ones, bias and spread by distance, angle and speed
    #[arg(long, value_name = "JSON", requires = "detector")]
    error_model: Option<PathBuf>,
    /// Robot config, for its section [views]
    #[arg(long, value_name = "FILE")]
    config: Option<String>,
}

/// Means over the images in one form.
#[derive(Clone, Debug, Serialize)]
struct Row {
    form: &'static str,
    images: usize,
    detection: Detection,
    /// PSNR against the recorded image, on the ground.
    psnr_db: f64,
    /// Half the sum of the differences between the luma histograms of this form and the recorded image.
    histogram: f64,
    /// How the user's detector does.
    detector: Option<DetectorReport>,
}

pub fn run(arguments: &GapArguments, json: bool) -> anyhow::Result<Outcome> {
    let settings = arguments.config.as_deref().map_or(Ok(Settings::default()), Settings::load)?;
    for path in [&arguments.output, &arguments.error_model].into_iter().flatten() {
        check_output(path, &[&arguments.db])?;
    }
    let database = ImageDatabase::open(&arguments.db, &settings.views)?;
    anyhow::ensure!(!database.index().is_empty(), crate::database::DatabaseError::Empty);
    let command = arguments.detector.as_deref();
    let mut detector = command.map(|command| JudgedDetector::new(command, &database)).transpose()?;
    let (rows, pictures) = compare(arguments, &database, detector.as_mut())?;
    if let Some(path) = &arguments.output {
        save(&page(&rows, pictures), path)?;
    }
    if let Some((path, detector)) = arguments.error_model.as_ref().zip(detector.as_ref()) {
        write(path, &(serde_json::to_string_pretty(&detector.error_model())? + "\n"))?;
    }
    if json {
        output::json(&rows)?;
    } else {
        output::lines(tables(&rows).trim_end())?;
    }
    Ok(Outcome::Whole)
}

/// Compares the forms of images. Returns a row for each form, and the forms of an image in the middle.
fn compare(
    arguments: &GapArguments,
    database: &ImageDatabase,
    mut detector: Option<&mut JudgedDetector>,
) -> anyhow::Result<(Vec<Row>, Vec<RgbImage>)> {
    let count = database.index().len();
    let frames = usize::from(arguments.frames).min(count);
    let mut rows: Vec<Vec<Row>> = vec![Vec::new(); FORMS.len()];
    let mut pictures = Vec::new();
    let mut progress = output::Progress::new("comparing");
    for frame in 0..frames {
        progress.set(frame as u64, Some(frames as u64));
        let number = (2 * frame + 1) * count / (2 * frames);
        let Some(held_out) = forms(database, number, arguments.apart)? else { continue };
        let judge = Judge::new(database, &held_out);
        let is_shown = frame == frames / 2 || pictures.is_empty();
        let mut shown = Vec::new();
        for (form, rows) in rows.iter_mut().enumerate() {
            rows.push(judge.row(form)?);
            let looked_at = detector.as_mut().map(|detector| detector.look(&held_out, form)).transpose()?;
            if is_shown {
                shown.push(looked_at.map_or_else(|| rgb(&held_out.images[form]), Ok)?);
            }
        }
        if is_shown {
            pictures = shown;
        }
    }
    progress.finish();
    anyhow::ensure!(!rows[0].is_empty(), "no image has others around it: record more, or lower --apart");
    let report = |form| detector.as_ref().map(|detector| detector.report(form));
    let means = rows.iter().enumerate().map(|(form, rows)| Row { detector: report(form), ..mean(rows) });
    Ok((means.collect(), pictures))
}

/// The forms of an image beside each other.
fn page(rows: &[Row], pictures: Vec<RgbImage>) -> RgbImage {
    let words = |row: &Row| format!("{}: response {:.2}", row.form, row.detection.response);
    let panels: Vec<_> = pictures.into_iter().zip(rows.iter().map(words)).collect();
    drawing::panels(&panels, 3)
}

/// Judges the forms of an image by the recorded one and its pose.
struct Judge<'a> {
    own: Detector,
    ground: Vec<bool>,
    held_out: &'a HeldOut,
}

impl<'a> Judge<'a> {
    fn new(database: &ImageDatabase, held_out: &'a HeldOut) -> Self {
        let camera = &held_out.camera;
        let world = World::without_goals(database.field());
        let target = Target::new(camera, &held_out.pose, &world);
        let (width, height) = (camera.width(), camera.height());
        let ground = (0..width * height).map(|i| target.surface(i % width, i / width) == Some(Surface::Ground));
        Self { own: Detector::new(camera.lens(), database.field()), ground: ground.collect(), held_out }
    }

    fn row(&self, form: usize) -> anyhow::Result<Row> {
        let (recorded, image) = (&self.held_out.images[0], &self.held_out.images[form]);
        let picture = Picture::from_rgb(image.width, image.height, &image.to_rgb()).context("a picture")?;
        let shown: Vec<bool> =
            image.pixels.iter().zip(&recorded.pixels).map(|(a, b)| a[3] != NOTHING && b[3] == SURE).collect();
        Ok(Row {
            form: FORMS[form],
            images: 1,
            detection: self.own.look(&picture, &self.held_out.pose),
            psnr_db: similarity(&recorded.pixels, &image.pixels, image.width, &self.ground, &shown).psnr_db,
            histogram: histogram_distance(&recorded.pixels, &image.pixels, &shown),
            detector: None,
        })
    }
}

/// Distance of two luma histograms of 32 bins: 0 (equal) to 1 (nothing in common), over pixels that both images show.
fn histogram_distance(a: &[[u8; 4]], b: &[[u8; 4]], shown: &[bool]) -> f64 {
    let mut counts = [[0f64; 2]; 32];
    for ((a, b), _) in a.iter().zip(b).zip(shown).filter(|(_, shown)| **shown) {
        for (which, pixel) in [a, b].into_iter().enumerate() {
            counts[usize::from(luma(*pixel)) / 8][which] += 1.0;
        }
    }
    let all = shown.iter().filter(|shown| **shown).count().max(1) as f64;
    counts.iter().map(|[a, b]| (a - b).abs()).sum::<f64>() / (2.0 * all)
}

fn mean(rows: &[Row]) -> Row {
    let of = |value: &dyn Fn(&Row) -> f64| rows.iter().map(value).sum::<f64>() / rows.len() as f64;
    Row {
        form: rows[0].form,
        images: rows.len(),
        detection: Detection {
            response: of(&|row| row.detection.response),
            missed: of(&|row| row.detection.missed),
            false_lines: of(&|row| row.detection.false_lines),
            places: rows.iter().map(|row| row.detection.places).sum(),
        },
        psnr_db: of(&|row| row.psnr_db),
        histogram: of(&|row| row.histogram),
        detector: None,
    }
}
