//! Command `realitysim db`: keeps an image database.

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use serde::Serialize;

use super::catalogue_beside::update_catalogue;
use super::paths::{check_output, save};
use super::settings::{UsageError, field_size};
use super::values::whole;
use super::{Outcome, output};
use crate::config::{Settings, load_field_of_size};
use crate::database::{self, Added, Checked, ImageDatabase, ScaledLens, Stats, TagLimits};
use crate::evaluation::drawing::{WalkGuide, WalkPlace, coverage_map};
use crate::geometry::PoseGrid;
use crate::recording::SESSION_FILE;
use crate::tagging::warnings::scaled_lens;
use crate::views::Hall;

/// Keep an image database: captures' images, found by the pose of their camera
///
/// Images stay where they were recorded; the database is an index that can be made anew from them at any time. It may be
/// changed while it is being used.
#[derive(Args)]
#[command(after_long_help = concat!(
    "Examples:",
    "\n  realitysim db add captures/2026-11-21T10-00-00Z-robot --db images/",
    "\n  realitysim db stats --db images/",
))]
pub struct DbArguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Add(AddArguments),
    Remove(RemoveArguments),
    /// Read all captures and folders of a database again, and make its index anew
    #[command(after_long_help = "Example:\n  realitysim db rebuild --db images/")]
    Rebuild(FolderArguments),
    /// What a database holds: images, sources, extent, how good the tags are
    #[command(after_long_help = "Example:\n  realitysim db stats --db images/")]
    Stats(FolderArguments),
    /// Read every image and compare it with what was indexed; exit code 3 if one is gone or changed
    #[command(after_long_help = "Example:\n  realitysim db verify --db images/")]
    Verify(FolderArguments),
    Coverage(CoverageArguments),
}

/// Add captures and folders of images
///
/// Of a capture every image with a valid tag that knows which half of the field it is in. A folder of images has poses.csv
/// (file,x,y,z,yaw_deg,pitch_deg,roll_deg of camera_link in map, perhaps sigma_xy_m,sigma_rotation_deg), camera_info.yaml as ROS camera_calibration writes it, and, if the
/// robot is in its pictures, body_mask.png, dark where it is. Makes the database if there is none.
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim db add captures/2026-11-21T10-00-00Z-robot --db images/")]
struct AddArguments {
    /// Captures' folders, segments, or folders of images
    #[arg(required = true)]
    sources: Vec<PathBuf>,
    /// The database's folder
    #[arg(long, value_name = "DIR")]
    db: PathBuf,
    /// For folders of images: a shipped field (config/fields) or the path of a field file
    #[arg(long, value_name = "NAME")]
    field: Option<String>,
    /// For folders of images: length and width of the field between the centres of its lines, metres: see `replay`
    #[arg(long, value_name = "LxW", value_parser = field_size, requires = "field")]
    field_size: Option<[f64; 2]>,
    /// Tags too that do not know which half of the field they are in: such an image may stand in the wrong half
    #[arg(long)]
    ambiguous: bool,
    /// Only poses whose place is known this well: standard deviation along its longer axis, 0.001 to 1
    #[arg(long, value_name = "M", default_value_t = TagLimits::default().sigma_m, value_parser = sigma)]
    max_sigma: f64,
}

/// Take a capture or folder out of a database; its files are not touched
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim db remove captures/2026-11-21T10-00-00Z-robot --db images/")]
struct RemoveArguments {
    /// As it was added
    source: PathBuf,
    /// The database's folder
    #[arg(long, value_name = "DIR")]
    db: PathBuf,
}

#[derive(Args)]
struct FolderArguments {
    /// The database's folder
    #[arg(long, value_name = "DIR")]
    db: PathBuf,
}

/// Show which poses a database has images of
///
/// Draws the field twice: with the images by place and heading, and with the share of headings that have an image near. Proposes
/// where to walk next: places where a turn on the spot closes the most gaps.
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim db coverage --db images/ -o coverage.png")]
struct CoverageArguments {
    /// The database's folder
    #[arg(long, value_name = "DIR")]
    db: PathBuf,
    /// The picture
    #[arg(short, long, value_name = "PNG")]
    output: Option<PathBuf>,
    /// Side of a cell, 0.02 to 5
    #[arg(long, value_name = "M", default_value_t = 0.25, value_parser = side)]
    cell: f64,
    /// Headings told apart, 1 to 360
    #[arg(long, value_name = "N", default_value_t = 24, value_parser = whole(1..=360u16))]
    headings: u16,
}

/// Poses of the paper's database.
const PAPER_POSES: u32 = 720_000;
/// Largest coverage grid: thirty times the paper's, 80 MB.
const MAX_CELLS: f64 = 20e6;

fn sigma(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
    if (0.001..=1.0).contains(&value) { Ok(value) } else { Err("0.001 to 1 metre".to_owned()) }
}

fn side(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
    if (0.02..=5.0).contains(&value) { Ok(value) } else { Err("0.02 to 5 metres".to_owned()) }
}

pub fn run(arguments: &DbArguments, json: bool) -> anyhow::Result<Outcome> {
    match &arguments.command {
        Command::Add(arguments) => add(arguments, json),
        Command::Remove(arguments) => remove(arguments, json),
        Command::Rebuild(arguments) => {
            let mut progress = output::Progress::new("reading");
            let added = database::rebuild(&arguments.db, &mut |done| progress.set(done, None))?;
            progress.finish();
            report_added(&added, &arguments.db, json)
        }
        Command::Stats(arguments) => stats(&database::stats(&arguments.db)?, json),
        Command::Verify(arguments) => {
            let mut progress = output::Progress::new("checking");
            let checked = database::verify(&arguments.db, &mut |done| progress.set(done, None))?;
            progress.finish();
            report_checked(&checked, json)
        }
        Command::Coverage(arguments) => coverage(arguments, json),
    }
}

fn add(arguments: &AddArguments, json: bool) -> anyhow::Result<Outcome> {
    let AddArguments { sources, db, field, field_size, ambiguous, max_sigma } = arguments;
    let limits = TagLimits { ambiguous: *ambiguous, sigma_m: *max_sigma };
    let inputs: Vec<&Path> = sources.iter().map(PathBuf::as_path).collect();
    check_output(db, &inputs)?;
    let field = field.as_deref().map(|name| load_field_of_size(name, *field_size)).transpose()?;
    let mut progress = output::Progress::new("reading");
    let added = database::add(db, sources, field.as_ref(), limits, &mut |done| progress.set(done, None))?;
    progress.finish();
    let is_capture = |source: &&PathBuf| source.join(SESSION_FILE).is_file();
    update_catalogue(&sources.iter().filter(is_capture).cloned().collect::<Vec<_>>());
    report_added(&added, db, json)
}

fn report_added(added: &Added, db: &Path, json: bool) -> anyhow::Result<Outcome> {
    output::losses(&added.losses);
    for empty in &added.empty {
        output::say(&format!("nothing came of {empty}"));
    }
    for ScaledLens { file, stated, images } in &added.scaled {
        output::say(&scaled_lens(&file.display().to_string(), *stated, *images));
    }
    if added.assumed > 0 {
        output::say(&format!(
            "{} images have poses without standard deviations: 1 cm and 0.25 deg are assumed (poses.csv may have sigma_xy_m and \
             sigma_rotation_deg)",
            added.assumed
        ));
    }
    if json {
        output::json(added)?;
    } else {
        let left_out = match added.left_out {
            0 => String::new(),
            count => {
                let mut why = vec!["no valid tag, or not to be decoded".to_owned()];
                if added.ambiguous > 0 {
                    why.push(format!(
                        "{} for tags that do not know which half of the field they are in (--ambiguous takes them)",
                        added.ambiguous
                    ));
                }
                if added.imprecise > 0 {
                    why.push(format!(
                        "{} for tags that are not known well enough (--max-sigma takes them)",
                        added.imprecise
                    ));
                }
                format!(", {count} left out ({})", why.join("; "))
            }
        };
        output::lines(&format!("{} images in {}{left_out}", added.images, db.display()))?;
    }
    Ok(if added.images == 0 { Outcome::NotReached } else { Outcome::of(&added.losses) })
}

fn remove(arguments: &RemoveArguments, json: bool) -> anyhow::Result<Outcome> {
    #[derive(Serialize)]
    struct Report {
        removed: u64,
    }
    let removed = database::remove(&arguments.db, &arguments.source)?;
    if json {
        output::json(&Report { removed })?;
    } else {
        output::lines(&format!("{removed} images taken out of {}", arguments.db.display()))?;
    }
    Ok(Outcome::Whole)
}

/// The planes of a hall that are known, and what becomes of the others.
fn hall_text(hall: &Hall) -> String {
    if hall.is_unknown() {
        return "hall unknown: what is above the ground is taken to be infinitely far".to_owned();
    }
    let metres = |plane: Option<f64>| plane.map_or_else(|| "far".to_owned(), |metres| format!("{metres:.1} m"));
    let [front, left, back, right] = hall.walls_m.map(metres);
    let turned =
        if hall.yaw_rad == 0.0 { String::new() } else { format!(", turned by {:.0} deg", hall.yaw_rad.to_degrees()) };
    format!(
        "hall: walls at +x {front}, +y {left}, -x {back}, -y {right} from the centre{turned}; ceiling {}",
        metres(hall.ceiling_m)
    )
}

fn stats(stats: &Stats, json: bool) -> anyhow::Result<Outcome> {
    if json {
        output::json(stats)?;
        return Ok(Outcome::Whole);
    }
    let mut text = format!(
        "{} images, field \"{}\", index {:.1} MB\n",
        stats.images,
        stats.field,
        stats.index_bytes as f64 * 1e-6
    );
    if let Some([low, high]) = stats.box_m {
        text.push_str(&format!(
            "x {:.2} to {:.2} m, y {:.2} to {:.2} m, z {:.2} to {:.2} m\n",
            low[0], high[0], low[1], high[1], low[2], high[2]
        ));
        if let (Some(metres), Some(degrees)) = (stats.sigma_m, stats.sigma_deg) {
            text.push_str(&format!("tags: median sigma {:.1} mm, {degrees:.2} deg\n", 1e3 * metres));
        }
        if stats.without_sigma > 0 {
            text.push_str(&format!(
                "poses of unknown accuracy: {}; 10 mm, 0.25 deg are assumed\n",
                stats.without_sigma
            ));
        }
    }
    for source in &stats.sources {
        let circle = source.lens.fov_deg.map_or_else(String::new, |fov_deg| format!(", {fov_deg:.0} deg across"));
        let bodies = if source.body_masks.is_empty() { "" } else { ", robot masked" };
        let goals = if source.goals { "" } else { ", without goals" };
        text.push_str(&format!(
            "{:>8} images ({} left out{circle}{bodies}{goals})  {}\n",
            source.images,
            source.left_out,
            source.path.display()
        ));
        text.push_str(&format!("         {}\n", hall_text(&source.hall)));
    }
    output::lines(text.trim_end())?;
    Ok(Outcome::Whole)
}

fn report_checked(checked: &Checked, json: bool) -> anyhow::Result<Outcome> {
    output::losses(&checked.losses);
    if json {
        output::json(checked)?;
    } else {
        output::lines(&format!("{} of {} images are as they were indexed", checked.sound, checked.images))?;
    }
    Ok(Outcome::of(&checked.losses))
}

/// What `coverage` says to programs.
#[derive(Serialize)]
struct CoverageReport<'a> {
    #[serde(flatten)]
    grid: &'a PoseGrid,
    walk_next: Vec<WalkPlace>,
}

fn walk_text(places: &[WalkPlace]) -> String {
    let place = |WalkPlace { x, y, missing }: &WalkPlace| {
        format!(
            "walk next to x {x:.1}, y {y:.1} m and turn around: {:.0} % of the headings are missing",
            100.0 * missing
        )
    };
    match places {
        [] => "every heading has an image within half a metre: nothing is missing".to_owned(),
        places => places.iter().map(place).collect::<Vec<_>>().join("\n"),
    }
}

fn coverage(arguments: &CoverageArguments, json: bool) -> anyhow::Result<Outcome> {
    let database = ImageDatabase::open(&arguments.db, &Settings::default().views)?;
    let half = database.field().carpet_half_extent() / arguments.cell;
    let cells = 4.0 * half.x * half.y * f64::from(arguments.headings);
    if cells > MAX_CELLS {
        let what = format!("--cell and --headings make {cells:.0} cells: at most {MAX_CELLS:.0} are counted");
        return Err(UsageError(what).into());
    }
    let found = database::coverage(database.index(), database.field(), arguments.cell, usize::from(arguments.headings));
    if let Some(path) = &arguments.output {
        check_output(path, &[&arguments.db])?;
        save(&coverage_map(&found, database.field()), path)?;
    }
    let walk_next = WalkGuide::new(&found).places();
    if json {
        output::json(&CoverageReport { grid: &found, walk_next })?;
    } else {
        let PoseGrid { filled, cells, cell_m, sectors, outside, .. } = found;
        let share = 100.0 * filled as f64 / cells as f64;
        let outside = if outside > 0 { format!("; {outside} images lie off the carpet") } else { String::new() };
        output::lines(&format!(
            "{filled} of {cells} poses filled ({share:.1} %): cells of {cell_m} m and {:.0} degrees; the paper's grid has \
             {PAPER_POSES}{outside}\n{}",
            360.0 / sectors as f64,
            walk_text(&walk_next)
        ))?;
    }
    Ok(Outcome::Whole)
}
