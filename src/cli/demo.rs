//! Command `realitysim demo`: renders a walk, tags it and draws the result.

use std::path::{Path, PathBuf};

use clap::Args;
use glam::DVec2;

use super::paths::{check_output, make_folder, save};
use super::{Outcome, eval, output, scene};
use crate::cli::host_info::cores;
use crate::config::Settings;
use crate::database::{self, TagLimits};
use crate::evaluation::capture::{read_truth, tagged};
use crate::evaluation::drawing::{self, Route, RouteStyle};
use crate::evaluation::{Comparison, Tagged, compare};
use crate::geometry::{Field, Isometry, Lens};
use crate::log_input::log::{LogSource, files_of};
use crate::log_input::{decode, scene_source};
use crate::recording::{read_info, read_tags};
use crate::ros2::mcap_read::Selection;
use crate::tagging::{ReplayOptions, replay};

/// See a robot walk a field and every frame of its camera tagged
///
/// Renders a scene into a log, replays the log, judges the tags against the truth, draws a picture, and makes a database of
/// the images. Needs no hardware and no network.
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim demo -o demo/")]
pub struct DemoArguments {
    /// A scene file to walk in place of the built-in demo (replay/scenes/demo.toml)
    #[arg(long)]
    scene: Option<String>,
    /// Where log, capture and picture go
    #[arg(short, long, default_value = "demo")]
    output: PathBuf,
}

const SCENE: &str = include_str!("../../replay/scenes/demo.toml");

/// Frame that is drawn, as a share of the valid tags.
const SHOWN_AT: f64 = 0.4;
const MAP_PX: u32 = 620;
const PALE: [u8; 3] = [255, 235, 120];
const STRONG: [u8; 3] = [230, 30, 60];

pub fn run(arguments: &DemoArguments, json: bool) -> anyhow::Result<Outcome> {
    let folder = &arguments.output;
    check_output(folder, &[])?;
    let scene = match &arguments.scene {
        Some(path) => scene_source::load(path)?,
        None => scene_source::parse(SCENE, "the built-in demo")?,
    };
    make_folder(folder)?;
    let log = folder.join("walk.mcap");
    eprintln!("1/3  rendering a walk as a robot would have recorded it: {}", scene.file().scene.title);
    scene::render(&scene, &log)?;
    eprintln!("2/3  tagging every frame");
    let options = ReplayOptions {
        source: log.clone(),
        captures: folder.join("captures"),
        settings: Settings { field: scene.file().scene.field.clone(), ..Settings::default() },
        initial: None,
        threads: cores(),
        realtime: false,
        warm_start: false,
    };
    let mut progress = output::Progress::new("tagging");
    let report = replay(&options, &mut |done, total| progress.set(done, total))?;
    progress.finish();
    eprintln!("3/3  judging the tags against the truth");
    let tags: Vec<Tagged> = read_tags(&report.session)?.found.iter().map(tagged).collect();
    let truth = read_truth(&log, &options.settings.topics.ground_truth)?.found;
    let comparison = compare(&tags, &truth);
    let (picture, images) = (folder.join("demo.png"), folder.join("images"));
    let session = std::slice::from_ref(&report.session);
    database::add(&images, session, None, TagLimits::default(), &mut |_| {})?;
    draw(&report.session, &tags, &truth, &comparison, &picture)?;
    if json {
        output::json(
            &serde_json::json!({ "replay": report, "eval": comparison, "picture": picture, "database": images }),
        )?;
    } else {
        output::lines(&format!(
            "\n{}\n\n  image to tag: p50 {:.1} ms, p99 {:.1} ms a frame, {} particles x {} iterations\n\n\
             capture  {}\npicture  {}\n\n\
             Look at it in a browser: `realitysim serve --db {} --captures {}`, then http://127.0.0.1:8765",
            eval::table(&comparison, 0),
            report.filter_ms.p50,
            report.filter_ms.p99,
            report.particles,
            report.iterations,
            report.session.display(),
            picture.display(),
            images.display(),
            options.captures.display()
        ))?;
    }
    Ok(if report.data_was_lost() { Outcome::DataLost } else { Outcome::Whole })
}

/// Draws the field from above with both routes, beside one frame with the projected lines.
fn draw(
    session: &Path,
    tags: &[Tagged],
    truth: &[(i64, Isometry)],
    comparison: &Comparison,
    path: &Path,
) -> anyhow::Result<()> {
    let info = read_info(session)?;
    let field = Field::new(info.field)?;
    let lens = Lens::new(info.lens)?;
    let place = |pose: &Isometry| DVec2::new(pose.translation.x, pose.translation.y);
    // A frame without a valid tag leaves a gap.
    let tagged_route = tags.iter().map(|tag| if tag.valid { place(&tag.pose) } else { DVec2::NAN }).collect();
    let routes = [
        Route {
            label: "true route of the camera".to_owned(),
            colour: PALE,
            points: truth.iter().map(|(_, pose)| place(pose)).collect(),
            style: RouteStyle::Wide,
            dots: false,
        },
        Route {
            label: "tagged route".to_owned(),
            colour: STRONG,
            points: tagged_route,
            style: RouteStyle::Thin,
            dots: true,
        },
    ];
    let error = &comparison.position_cm;
    let caption = [format!(
        "{} of {} frames valid, error mean {:.2} cm, p95 {:.2} cm",
        comparison.valid, comparison.frames, error.mean, error.p95
    )];
    let map = drawing::field_map(&field, &routes, MAP_PX, &caption);
    let shown = tags.iter().filter(|tag| tag.valid).nth((comparison.valid as f64 * SHOWN_AT) as usize);
    let picture = match shown.map(|tag| frame(session, &info.settings.topics.image, tag)).transpose()?.flatten() {
        Some((image, tag)) => {
            let overlay = drawing::overlay(&image, &lens, &tag.pose, &field, STRONG);
            drawing::side_by_side(&map, &overlay, "one frame, with the lines where its tag puts them")
        }
        None => map,
    };
    save(&picture, path)
}

/// Finds the image that a tag belongs to.
fn frame<'a>(session: &Path, topic: &str, tag: &'a Tagged) -> anyhow::Result<Option<(image::RgbImage, &'a Tagged)>> {
    let raw = "/camera/image_raw";
    for message in LogSource::new(files_of(session)?, Selection::topics([topic, raw])) {
        let message = message?;
        if decode::stamp_ns(&message)? == tag.stamp_ns {
            let picture = decode::picture(&message)?;
            let image = image::RgbImage::from_raw(picture.width as u32, picture.height as u32, picture.to_rgb());
            return Ok(image.map(|image| (image, tag)));
        }
    }
    Ok(None)
}
