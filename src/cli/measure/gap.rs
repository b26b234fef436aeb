//! Command `realitysim measure gap`: compares recorded images with views and renderings.

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::Context;
use clap::Args;
use image::RgbImage;
use serde::Serialize;

use crate::cli::detector::{number_in, run_detector};
use crate::cli::paths::{check_output, save};
use crate::cli::values::{number, whole};
use crate::cli::{Outcome, output};
use crate::config::Settings;
use crate::database::{ImageDatabase, ViewQuery};
use crate::evaluation::drawing;
use crate::evaluation::views::{Detection, Detector};
use crate::geometry::Isometry;
use crate::scene::{Renderer, Scene, SceneFile};
use crate::views::{Camera, MAX_FAR_M, Method, NOTHING, Raster, SURE, Target, World, similarity};
use crate::vision::Picture;

/// Measure the gap between recorded, made-up and rendered images
///
/// Images of the database are held out, with all others taken near them, and seen from their poses as recorded, as the exact and the
/// paper's view, as the nearest image, and rendered. What the project's line detector finds in each is compared, and their
/// brightness. A detector of your own: --detector COMMAND is run with the name of a PNG and prints a number.
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim measure gap --db images/ --frames 40 -o gap.png")]
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
    /// Run in a shell with the name of a PNG as its last argument; prints a number
    #[arg(long, value_name = "COMMAND")]
    detector: Option<String>,
    /// Robot config, for its section [views]
    #[arg(long, value_name = "FILE")]
    config: Option<String>,
}

/// Forms of an image, in the order of the table.
const FORMS: [&str; 5] = ["recorded", "exact view", "paper's view", "nearest image", "rendered"];

/// Means over the images in one form.
#[derive(Clone, Debug, Default, Serialize)]
struct Row {
    form: &'static str,
    images: usize,
    detection: Detection,
    /// PSNR against the recorded image, on the ground.
    psnr_db: f64,
    /// Half the sum of the differences between the luma histograms of this form and the recorded image.
    histogram: f64,
    /// Mean answer of the user's detector.
    detector: Option<f64>,
}

struct Judge<'a> {
    arguments: &'a GapArguments,
    own: Detector,
    ground: Vec<bool>,
    recorded: &'a Raster,
    pose: Isometry,
}

pub fn run(arguments: &GapArguments, json: bool) -> anyhow::Result<Outcome> {
    let settings = arguments.config.as_deref().map_or(Ok(Settings::default()), Settings::load)?;
    if let Some(path) = &arguments.output {
        check_output(path, &[&arguments.db])?;
    }
    let database = ImageDatabase::open(&arguments.db, &settings.views)?;
    let count = database.index().len();
    anyhow::ensure!(count > 0, crate::database::DatabaseError::Empty);
    let frames = usize::from(arguments.frames).min(count);
    let mut rows: Vec<Vec<Row>> = vec![Vec::new(); FORMS.len()];
    let mut progress = output::Progress::new("comparing");
    let mut pictures = Vec::new();
    for frame in 0..frames {
        let number = (2 * frame + 1) * count / (2 * frames);
        let forms = forms(&database, number, arguments.apart)?;
        let Some((camera, pose, images)) = forms else { continue };
        let world = World::without_goals(database.field());
        let target = Target::new(&camera, &pose, &world);
        let (width, height) = (camera.width(), camera.height());
        let ground = (0..width * height).map(|i| target.surface(i % width, i / width));
        let judge = Judge {
            arguments,
            own: Detector::new(camera.lens(), database.field()),
            ground: ground.map(|surface| surface == Some(crate::views::Surface::Ground)).collect(),
            recorded: &images[0],
            pose,
        };
        for (rows, (form, image)) in rows.iter_mut().zip(FORMS.iter().zip(&images)) {
            rows.push(judge.row(form, image)?);
        }
        if frame == frames / 2 || pictures.is_empty() {
            pictures = images;
        }
        progress.set(frame as u64 + 1, Some(frames as u64));
    }
    progress.finish();
    let rows: Vec<Row> = rows.iter().filter(|rows| !rows.is_empty()).map(|rows| mean(rows)).collect();
    anyhow::ensure!(!rows.is_empty(), "no image has others around it: record more, or lower --apart");
    if let Some(path) = &arguments.output {
        let panel = |(image, row): (&Raster, &Row)| {
            let words = format!("{}: response {:.2}", row.form, row.detection.response);
            (RgbImage::from_raw(image.width as u32, image.height as u32, image.to_rgb()).unwrap_or_default(), words)
        };
        let panels: Vec<_> = pictures.iter().zip(&rows).map(panel).collect();
        save(&drawing::panels(&panels, 3), path)?;
    }
    if json {
        output::json(&rows)?;
    } else {
        output::lines(table(&rows).trim_end())?;
    }
    Ok(Outcome::Whole)
}

/// Camera, pose of `camera_link` in `map`, and the images in the order of `FORMS`.
type Forms = (Arc<Camera>, Isometry, Vec<Raster>);

/// Makes all forms of one image. `None` if no view can be made, since no other image is near.
fn forms(database: &ImageDatabase, number: usize, apart: f64) -> anyhow::Result<Option<Forms>> {
    let record = database.index().record(number);
    let (pose, camera) = (record.pose(), database.camera(&record).context("an image of an unknown source")?);
    let recorded = database.image(number).map_err(anyhow::Error::msg)?;
    // 512 neighbours are far more than a walk has within that distance.
    let near = database.index().nearest(&pose, 512, &database.metric());
    let held_out = |at: &crate::database::Neighbour| {
        database.index().record(at.number).pose().translation.distance(pose.translation) < apart
    };
    let mut without: Vec<usize> = near.iter().filter(|at| held_out(at)).map(|at| at.number).collect();
    without.push(number);
    let mut images = vec![recorded.full().clone()];
    for method in [Method::Exact, Method::Paper, Method::Nearest] {
        let camera = Some(Arc::clone(camera));
        let wanted = ViewQuery {
            map_from_link: pose,
            method,
            camera,
            max_distance_m: f64::INFINITY,
            may_be_stored: true,
            without: without.clone(),
        };
        match database.view(&wanted) {
            Ok(shown) => images.push(shown.answer.image),
            Err(crate::database::DatabaseError::View(_) | crate::database::DatabaseError::Image { .. }) => {
                return Ok(None);
            }
            Err(error) => return Err(error.into()),
        }
    }
    images.push(rendered(database, camera, &pose)?);
    Ok(Some((Arc::clone(camera), pose, images)))
}

/// Scene for the rendered form. Its route does not matter: only field, lens and texture count.
const SCENE: &str = r#"
[scene]
title = "Rendered in place of a recorded image"
task = "The rendered side of the reality gap."
seed = 9
field = "the database's"

[camera]
lens = "the database's"
rate_hz = 10.0
torso_height_m = 0.4
mount_xyz_m = [0.0, 0.0, 0.1]
mount_pitch_deg = 0.0

[route]
kind = "still"
poses = [[0.0, 0.0, 0.0]]
hold_s = 1.0
"#;

fn rendered(database: &ImageDatabase, camera: &Camera, pose: &Isometry) -> anyhow::Result<Raster> {
    let lens = camera.lens().parameters().clone();
    let scene = Scene::build(SceneFile::from_toml(SCENE)?, database.field().dimensions().clone(), lens)?;
    let mut rgb = Vec::new();
    Renderer::new(&scene).render_clean(pose, 0, &mut rgb);
    Raster::from_rgb(camera.width(), camera.height(), &rgb, camera.shows())
        .context("a rendered image of the camera's size")
}

impl Judge<'_> {
    fn row(&self, form: &'static str, image: &Raster) -> anyhow::Result<Row> {
        let picture = Picture::from_rgb(image.width, image.height, &image.to_rgb()).context("a picture")?;
        let shown: Vec<bool> =
            image.pixels.iter().zip(&self.recorded.pixels).map(|(a, b)| a[3] != NOTHING && b[3] == SURE).collect();
        Ok(Row {
            form,
            images: 1,
            detection: self.own.look(&picture, &self.pose),
            psnr_db: similarity(&self.recorded.pixels, &image.pixels, image.width, &self.ground, &shown).psnr_db,
            histogram: histogram_distance(&self.recorded.pixels, &image.pixels, &shown),
            detector: self.arguments.detector.as_deref().map(|command| ask(command, image)).transpose()?,
        })
    }
}

/// Distance of two luma histograms of 32 bins: 0 (equal) to 1 (nothing in common), over pixels that both images show.
fn histogram_distance(a: &[[u8; 4]], b: &[[u8; 4]], shown: &[bool]) -> f64 {
    let mut counts = [[0f64; 2]; 32];
    for ((a, b), _) in a.iter().zip(b).zip(shown).filter(|(_, shown)| **shown) {
        for (which, [r, g, b, _]) in [a, b].into_iter().enumerate() {
            let luma = (77 * u32::from(*r) + 150 * u32::from(*g) + 29 * u32::from(*b)) >> 8;
            counts[luma as usize / 8][which] += 1.0;
        }
    }
    let all = shown.iter().filter(|shown| **shown).count().max(1) as f64;
    counts.iter().map(|[a, b]| (a - b).abs()).sum::<f64>() / (2.0 * all)
}

fn ask(command: &str, image: &Raster) -> anyhow::Result<f64> {
    let file = std::env::temp_dir().join(format!("realitysim-gap-{}.png", std::process::id()));
    let picture = RgbImage::from_raw(image.width as u32, image.height as u32, image.to_rgb()).unwrap_or_default();
    save(&picture, &file)?;
    let answer = run_detector(command, &file);
    let _ = std::fs::remove_file(&file);
    number_in(&answer?).with_context(|| format!("--detector {command:?}"))
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
        detector: rows[0].detector.map(|_| of(&|row| row.detector.unwrap_or(0.0))),
    }
}

fn table(rows: &[Row]) -> String {
    let named = if rows.iter().any(|row| row.detector.is_some()) { " your detector |" } else { "" };
    let rule = if named.is_empty() { "" } else { " --- |" };
    let mut text = format!(
        "Means over {} images.\n\n| | response on lines | lines missed | false lines | histogram distance | PSNR on the ground |{named}\n\
         | --- | --- | --- | --- | --- | --- |{rule}\n",
        rows[0].images
    );
    for row in rows {
        let Detection { response, missed, false_lines, .. } = row.detection;
        let psnr = if row.psnr_db > 90.0 { "-".to_owned() } else { format!("{:.1} dB", row.psnr_db) };
        let own = row.detector.map_or(String::new(), |value| format!(" {value:.4} |"));
        text.push_str(&format!(
            "| {} | {response:.3} | {:.1} % | {:.2} % | {:.3} | {psnr} |{own}\n",
            row.form,
            100.0 * missed,
            100.0 * false_lines,
            row.histogram
        ));
    }
    text
}
