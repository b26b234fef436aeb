//! Command `realitysim view`: shows a view from a database of recorded images.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::builder::TypedValueParser;
use clap::{Args, ValueEnum};
use glam::DVec3;
use image::RgbImage;
use serde::Serialize;

use super::labels::label_view;
use super::paths::{check_output, save, write_bytes};
use super::settings::UsageError;
use super::values::{any_whole, number, whole};
use super::view_depth::DepthForm;
use super::{Outcome, output};
use crate::config::{Settings, load_lens};
use crate::database::{ImageDatabase, ViewQuery, ViewResult};
use crate::evaluation::drawing;
use crate::geometry::{Euler, Isometry, Lens};
use crate::log_input::scene_source;
use crate::scene::ViewOverlay;
use crate::views::{
    Camera, FAR_M, MAX_FAR_M, MAX_HEIGHT_M, MAX_PLACE_M, MAX_TURN_DEG, MIN_HEIGHT_M, Method, NOTHING, Provenance,
    Raster, UNSURE, World,
};

/// Show what the camera would see from a pose, from a database of recorded images
///
/// The stored image itself if one was taken there, byte for byte if the output's name has its ending; else a view made
/// from its neighbours, with a statement of how it was made and how far it can be trusted.
#[derive(Args)]
#[command(after_long_help = concat!(
    "Example:",
    "\n  realitysim view --db images/ --x 0.3 --y -0.5 --z 0.5 --yaw 30 --pitch 18 -o view.png",
))]
pub struct ViewArguments {
    /// The database's folder
    #[arg(long, value_name = "DIR")]
    db: PathBuf,
    /// Where camera_link is in map, metres along the field
    #[arg(long, value_name = "M", allow_hyphen_values = true, value_parser = place())]
    x: f64,
    /// Where camera_link is in map, metres across the field
    #[arg(long, value_name = "M", allow_hyphen_values = true, value_parser = place())]
    y: f64,
    /// Height of camera_link above the ground, metres
    #[arg(long, value_name = "M", allow_hyphen_values = true, value_parser = number(MIN_HEIGHT_M..=MAX_HEIGHT_M))]
    z: f64,
    /// Heading of camera_link in map, degrees
    #[arg(long, value_name = "DEG", allow_hyphen_values = true, value_parser = turn())]
    yaw: f64,
    /// Pitch of camera_link, degrees; above 0 looks down
    #[arg(long, value_name = "DEG", default_value_t = 0.0, allow_hyphen_values = true, value_parser = turn())]
    pitch: f64,
    /// Roll of camera_link, degrees
    #[arg(long, value_name = "DEG", default_value_t = 0.0, allow_hyphen_values = true, value_parser = turn())]
    roll: f64,
    /// The picture to write, .png or .jpg
    #[arg(short, long)]
    output: PathBuf,
    /// How the view is made: through both lenses, by the paper's map, or the nearest image unchanged
    #[arg(long, default_value = "exact")]
    method: ViewMethod,
    /// Lens of the view: a shipped camera (config/cameras) or a lens file; without it, that of the nearest image
    #[arg(long, value_name = "FILE")]
    lens: Option<String>,
    /// Pixels of the view, 16 to 4096; one alone keeps the lens's proportions
    #[arg(long, value_name = "PX", value_parser = whole(16..=4096u32))]
    width: Option<u32>,
    /// Pixels of the view, 16 to 4096; one alone keeps the lens's proportions
    #[arg(long, value_name = "PX", value_parser = whole(16..=4096u32))]
    height: Option<u32>,
    /// Put the scene upon the view: its robots, people and balls (obstacles), light without a gradient, sensor noise
    #[arg(long, value_name = "SCENE")]
    scene: Option<String>,
    /// Whether the figures that the scene places are drawn
    #[arg(long, default_value = "draw", requires = "scene")]
    figures: Figures,
    /// As which frame of the scene
    #[arg(long, value_name = "N", default_value_t = 0, requires = "scene", value_parser = any_whole::<u64>)]
    frame: u64,
    /// How far away the nearest image may have been taken
    #[arg(long, value_name = "M", default_value_t = FAR_M, value_parser = number(0.0..=MAX_FAR_M))]
    max_distance: f64,
    /// When it was taken farther away, or images show less than a quarter of an exact view: no view at all (exit code 1), or
    /// the best there is, with a warning
    #[arg(long, default_value = "refuse")]
    outside: Outside,
    /// Nearest image, the paper's view and the exact one beside each other, with mask and numbers
    #[arg(long)]
    side_by_side: bool,
    /// Write the mask: white is known geometry, gray beyond the ground and recorded figures, black shows nothing
    #[arg(long, value_name = "PNG")]
    mask: Option<PathBuf>,
    /// Write the depth along each pixel's ray: .npy (metres; inf is far or unknown) or .png (millimetres, 16 bits; 0 is none)
    #[arg(long, value_name = "FILE")]
    depth: Option<PathBuf>,
    /// Write the view with its labels into this folder, as `realitysim labels --format png` does those of recorded images
    #[arg(long, value_name = "DIR", conflicts_with = "side_by_side")]
    labels: Option<PathBuf>,
    /// Robot config, for its section [views]
    #[arg(long, value_name = "FILE")]
    config: Option<String>,
}

fn place() -> impl TypedValueParser<Value = f64> {
    number(-MAX_PLACE_M..=MAX_PLACE_M)
}

fn turn() -> impl TypedValueParser<Value = f64> {
    number(-MAX_TURN_DEG..=MAX_TURN_DEG)
}

/// Unreadable images that are named, each in a line of its own.
const LISTED_UNREADABLE: usize = 3;

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum Figures {
    Draw,
    Omit,
}

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum Outside {
    Refuse,
    Warn,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum ViewMethod {
    Exact,
    Paper,
    Nearest,
}

impl From<ViewMethod> for Method {
    fn from(method: ViewMethod) -> Self {
        match method {
            ViewMethod::Exact => Self::Exact,
            ViewMethod::Paper => Self::Paper,
            ViewMethod::Nearest => Self::Nearest,
        }
    }
}

#[derive(Serialize)]
struct Report {
    output: PathBuf,
    made: &'static str,
    sources: Vec<Source>,
    valid_share: f64,
    sure_share: f64,
    /// `None` if no known geometry is in view, of which an error could be stated.
    expected_error_px: Option<f64>,
    /// Effects of the scene that were applied.
    effects: Vec<&'static str>,
    unreadable: Vec<String>,
    /// Reason to doubt the view.
    warning: Option<String>,
}

#[derive(Serialize)]
struct Source {
    file: PathBuf,
    offset: u64,
    stamp_ns: i64,
    distance_m: f64,
    angle_deg: f64,
    share: f64,
}

pub fn run(arguments: &ViewArguments, json: bool) -> anyhow::Result<Outcome> {
    let settings = arguments.config.as_deref().map_or(Ok(Settings::default()), Settings::load)?;
    let depth = arguments.depth.as_deref().map(|path| Ok::<_, UsageError>((path, DepthForm::of(path)?))).transpose()?;
    let ViewArguments { output, mask: mask_file, depth: depth_file, labels, .. } = arguments;
    for path in [Some(output), mask_file.as_ref(), depth_file.as_ref(), labels.as_ref()].into_iter().flatten() {
        let named = [&arguments.scene, &arguments.config].into_iter().flatten().map(Path::new);
        check_output(path, &named.chain([arguments.db.as_path()]).collect::<Vec<_>>())?;
    }
    let mut wanted = view_query(arguments);
    let scene = arguments.scene.as_deref().map(scene_source::load).transpose()?;
    let database = ImageDatabase::open(&arguments.db, &settings.views)?;
    wanted.camera = camera(arguments, &database, &wanted)?;
    let mut shown = database.view(&wanted)?;
    let overlay = scene.map(|scene| ViewOverlay::new(&scene, shown.camera.lens(), arguments.figures == Figures::Draw));
    let apply = |shown: &mut ViewResult| {
        overlay
            .as_ref()
            .map_or_else(Default::default, |overlay| apply(overlay, arguments.frame, database.world(), shown))
    };
    if let Some(overlay) = &overlay {
        overlay.check(database.field())?;
    }
    let (effects, figures_m) = apply(&mut shown);
    if arguments.side_by_side {
        save(&side_by_side_panels(&database, &wanted, &shown, apply)?, &arguments.output)?;
    } else {
        write(&shown, &arguments.output)?;
    }
    if let Some(path) = &arguments.mask {
        save(&mask(&shown.answer.image), path)?;
    }
    if let Some((path, form)) = depth {
        form.write(path, &shown.depth_m(database.world(), &figures_m), shown.camera.width())?;
    }
    if let Some(folder) = labels {
        let file = output.file_name().unwrap_or_default().to_string_lossy();
        label_view(folder, &file, &database, &shown, &figures_m, |path| write(&shown, path))?;
    }
    let report = Report { effects, ..report(&database, &shown, arguments) };
    if json {
        output::json(&report)?;
    } else {
        output::lines(&text_report(&report))?;
    }
    for what in report.unreadable.iter().take(LISTED_UNREADABLE).chain(&report.warning) {
        output::say(what);
    }
    if report.unreadable.len() > LISTED_UNREADABLE {
        let more = report.unreadable.len() - LISTED_UNREADABLE;
        eprintln!(
            "realitysim: and {more} more that cannot be read: --json names them, `realitysim db verify` finds all"
        );
    }
    Ok(if report.unreadable.is_empty() { Outcome::Whole } else { Outcome::DataLost })
}

fn view_query(arguments: &ViewArguments) -> ViewQuery {
    let ViewArguments { x, y, z, yaw, pitch, roll, max_distance, outside, .. } = *arguments;
    let euler = Euler { yaw: yaw.to_radians(), pitch: pitch.to_radians(), roll: roll.to_radians() };
    ViewQuery {
        map_from_link: Isometry::from_euler(euler, DVec3::new(x, y, z)),
        method: arguments.method.into(),
        camera: None,
        max_distance_m: if outside == Outside::Refuse { max_distance } else { f64::INFINITY },
        may_be_stored: arguments.scene.is_none(),
        without: Vec::new(),
    }
}

/// Camera with the lens and size asked for; `None` stands for that of the nearest image.
fn camera(
    arguments: &ViewArguments,
    database: &ImageDatabase,
    wanted: &ViewQuery,
) -> anyhow::Result<Option<Arc<Camera>>> {
    let size = [arguments.width, arguments.height];
    let given = arguments.lens.as_deref().map(load_lens).transpose()?.map(|file| file.lens.parameters().clone());
    let nearest = || {
        let camera = database.nearest_camera(&wanted.map_from_link);
        camera.map(|camera| camera.lens().parameters().clone())
    };
    let lens = match (given, size) {
        (None, [None, None]) => return Ok(None),
        (Some(lens), _) => lens,
        (None, _) => nearest().ok_or(crate::database::DatabaseError::Empty)?,
    };
    Ok(Some(Arc::new(Camera::new(&Lens::new(lens.resized(size))?))))
}

/// Applies the scene. Returns the effects, and the distances of its figures along the rays of the pixels.
///
/// A view that was changed no longer counts as a stored image.
fn apply(overlay: &ViewOverlay, frame: u64, world: &World, shown: &mut ViewResult) -> (Vec<&'static str>, Vec<f32>) {
    let effects = overlay.effects();
    if effects.is_empty() {
        return (effects, Vec::new());
    }
    shown.stored = None;
    (effects, overlay.apply(frame, &shown.camera, world, &mut shown.answer))
}

/// Writes the view. A stored image is written byte for byte if the file's ending fits its format.
fn write(shown: &ViewResult, path: &std::path::Path) -> anyhow::Result<()> {
    let ending = path.extension().and_then(|ending| ending.to_str()).unwrap_or_default().to_ascii_lowercase();
    match &shown.stored {
        Some(bytes) if has_format(bytes, &ending) => write_bytes(path, bytes),
        _ => save(&picture(&shown.answer.image), path),
    }
}

fn has_format(bytes: &[u8], ending: &str) -> bool {
    match ending {
        "png" => bytes.starts_with(b"\x89PNG"),
        "jpg" | "jpeg" => bytes.starts_with(&[0xff, 0xd8]),
        _ => false,
    }
}

fn picture(raster: &Raster) -> RgbImage {
    RgbImage::from_raw(raster.width as u32, raster.height as u32, raster.to_rgb()).unwrap_or_default()
}

fn mask(raster: &Raster) -> RgbImage {
    let rgb = raster.mask().into_iter().flat_map(|sure| [sure; 3]).collect();
    RgbImage::from_raw(raster.width as u32, raster.height as u32, rgb).unwrap_or_default()
}

/// Puts four panels together: nearest image, paper's view, exact view, and the exact view's mask.
fn side_by_side_panels<T>(
    database: &ImageDatabase,
    wanted: &ViewQuery,
    exact: &ViewResult,
    apply: impl Fn(&mut ViewResult) -> T,
) -> anyhow::Result<RgbImage> {
    let mut panels = Vec::new();
    for (name, method) in
        [("nearest image", Method::Nearest), ("paper (Eq. 3-4)", Method::Paper), ("exact", Method::Exact)]
    {
        let camera = Some(Arc::clone(&exact.camera));
        let shown = database.view(&ViewQuery { method, camera, ..wanted.clone() });
        let (image, caption) = match shown {
            Ok(mut shown) => {
                apply(&mut shown);
                let answer = &shown.answer;
                let error = match answer.trusted_error_px() {
                    Some(error) => format!("expected error {error:.1} px"),
                    None => "no known geometry".to_owned(),
                };
                (picture(&answer.image), format!("{name}: {}; shows {:.0} %", error, 100.0 * answer.valid_share))
            }
            Err(error) => {
                (RgbImage::new(exact.camera.width() as u32, exact.camera.height() as u32), format!("{name}: {error}"))
            }
        };
        panels.push((image, caption));
    }
    let tint = |raster: &Raster| {
        let mut image = picture(raster);
        for (pixel, from) in image.pixels_mut().zip(&raster.pixels) {
            match from[3] {
                NOTHING => pixel.0 = [200, 40, 40],
                UNSURE => pixel.0 = [pixel.0[0] / 2 + 40, pixel.0[1] / 2 + 40, pixel.0[2] / 2 + 110],
                _ => {}
            }
        }
        image
    };
    let caption =
        format!("mask: {:.0} % known geometry, blue beyond the ground, red nothing", 100.0 * exact.answer.sure_share);
    panels.push((tint(&exact.answer.image), caption));
    Ok(drawing::panels(&panels, 2))
}

fn report(database: &ImageDatabase, shown: &ViewResult, arguments: &ViewArguments) -> Report {
    let answer = &shown.answer;
    let source = |used: &crate::views::UsedSource| {
        let record = database.index().record(used.id as usize);
        let source = database.contents().sources.get(record.source as usize);
        Source {
            file: source.and_then(|source| source.file(record.file)).unwrap_or_default(),
            offset: record.offset,
            stamp_ns: record.stamp_ns,
            distance_m: used.distance_m,
            angle_deg: used.angle_rad.to_degrees(),
            share: used.share,
        }
    };
    Report {
        output: arguments.output.clone(),
        made: match answer.made {
            Provenance::Stored => "stored",
            Provenance::Nearest => "nearest",
            Provenance::Warped => "warped",
            Provenance::Composed => "composed",
        },
        sources: answer.sources.iter().map(source).collect(),
        valid_share: answer.valid_share,
        sure_share: answer.sure_share,
        expected_error_px: answer.trusted_error_px(),
        effects: Vec::new(),
        unreadable: shown.unreadable.clone(),
        warning: answer.warning(arguments.max_distance),
    }
}

fn text_report(report: &Report) -> String {
    let shows = match report.expected_error_px {
        Some(error) => format!("{:.1} % known geometry), expected error {error:.1} px", 100.0 * report.sure_share),
        None => "no known geometry: nothing can be said of its error)".to_owned(),
    };
    let mut text =
        format!("{}: {}, shows {:.1} % ({shows}\n", report.output.display(), report.made, 100.0 * report.valid_share,);
    for source in &report.sources {
        text.push_str(&format!(
            "  {:5.1} % from {} at byte {}: {:.1} cm and {:.1} deg away\n",
            100.0 * source.share,
            source.file.display(),
            source.offset,
            100.0 * source.distance_m,
            source.angle_deg
        ));
    }
    text.trim_end().to_owned()
}
