//! Many images at once: a table of verdicts, a page of overlays, and the poses for a database.

use std::collections::{BTreeMap, HashMap};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;
use std::thread;

use anyhow::Context;
use image::RgbImage;
use serde::Serialize;

use super::super::import::pictures::names_in;
use super::super::paths::{self, cannot_read, cannot_write, check_old, save};
use super::super::photo::{self, PhotoArguments};
use super::super::settings::UsageError;
use super::super::{Outcome, output};
use super::{LINE_COLOUR, Report, TagArguments, Tagged, tag};
use crate::cli::host_info::cores;
use crate::config::{camera_calibration_yaml, plain_file};
use crate::database::{POSES_HEAD, SIGMAS_HEAD};
use crate::evaluation::drawing;
use crate::geometry::{Euler, Field, Isometry, Lens, Pose2};
use crate::log_input::decode;
use crate::log_input::tables::pictures::{KnownPicture, read_known};
use crate::log_input::tables::{MAX_TABLE_BYTES, Table};
use crate::recording::Loss;
use crate::tagging::image_location::{FitQuality, PoseHypothesis};

/// Most images on a page.
const MAX_SHEET_IMAGES: usize = 200;
/// Columns of the page.
const SHEET_COLUMNS: u32 = 4;
/// Width of an image on the page, pixels.
const SHEET_WIDTH_PX: u32 = 400;
/// Most characters of a name on the page.
const MAX_NAME_SHOWN: usize = 24;
/// Name of the lens file beside poses, as a database expects it.
const CAMERA_FILE: &str = "camera_info.yaml";

/// The result for one image.
struct Verdict {
    path: PathBuf,
    fit: FitQuality,
    lens: Lens,
    field: Field,
    best: Option<PoseHypothesis>,
    /// Whether about where it was taken was known, so that the half of the field is.
    is_half_known: bool,
}

/// An image that cannot be read.
#[derive(Serialize)]
struct Unreadable<'a> {
    image: &'a Path,
    error: String,
}

/// Name of the first argument that is for many images, if one is given.
pub(super) fn arguments_given(arguments: &TagArguments) -> Option<&'static str> {
    let given = [
        (arguments.attitude_csv.is_some(), "--attitude-csv"),
        (arguments.sheet.is_some(), "--sheet"),
        (arguments.poses.is_some(), "--poses"),
    ];
    given.into_iter().find_map(|(is_given, name)| is_given.then_some(name))
}

pub(super) fn run(arguments: &TagArguments, json: bool) -> anyhow::Result<Outcome> {
    if arguments.overlay.is_some() {
        return Err(UsageError("--overlay is of one image; --sheet shows many".to_owned()).into());
    }
    let images = images_of(&arguments.images)?;
    let known = known_of(arguments, &images)?;
    let pending = arguments.poses.as_deref().map(|poses| begin_poses(poses, &images)).transpose()?;
    let mut progress = output::Progress::new("tagging");
    let (mut verdicts, mut lost, mut done) = (Vec::new(), Vec::new(), 0);
    let mut first: Option<(&Path, [u32; 2])> = None;
    tag_all(arguments, &images, &known, &mut |index, tagged| {
        let path = &images[index];
        done += 1;
        progress.set(done, Some(images.len() as u64));
        match tagged {
            Ok(tagged) => {
                let size = [tagged.lens.width(), tagged.lens.height()];
                let (first, first_size) = *first.get_or_insert((path, size));
                if size != first_size {
                    return Err(other_size(path, size, first, first_size).into());
                }
                print_one(&tagged.report, json)?;
                verdicts.push(verdict(path, tagged, known_name(path).and_then(|name| known.get(name)), arguments));
            }
            // A wrong lens or field is wrong for all images.
            Err(error) if !error.chain().any(|cause| cause.is::<decode::DecodeError>() || is_unreadable(cause)) => {
                return Err(error);
            }
            Err(error) => {
                let error = super::super::error_text(&error);
                if json {
                    output::json(&Unreadable { image: path, error: error.clone() })?;
                }
                lost.push(Loss::new(path, error));
            }
        }
        Ok(())
    })?;
    progress.finish();
    output::losses(&lost);
    if let Some(sheet) = &arguments.sheet {
        save(&contact_sheet(&verdicts)?, sheet)?;
    }
    if let (Some(pending), Some(path)) = (pending, &arguments.poses) {
        write_poses(pending, path, &verdicts)?;
    }
    summarize(&verdicts);
    let is_in_vain = verdicts.iter().all(|verdict| verdict.fit == FitQuality::None);
    Ok(if is_in_vain { Outcome::NotReached } else { Outcome::of(&lost) })
}

/// The error about pictures of two sizes, which one lens cannot have taken.
fn other_size(
    path: &Path,
    [width, height]: [u32; 2],
    first: &Path,
    [first_width, first_height]: [u32; 2],
) -> UsageError {
    UsageError(format!(
        "{} is {width} x {height} pixels, and {} {first_width} x {first_height}: the pictures of one camera have one size; move the \
         others into a folder of their own",
        path.display(),
        first.display()
    ))
}

fn is_unreadable(cause: &(dyn std::error::Error + 'static)) -> bool {
    cause.is::<std::io::Error>()
}

/// All images that are named, those of a folder in natural order.
fn images_of(named: &[PathBuf]) -> anyhow::Result<Vec<PathBuf>> {
    let mut images = Vec::new();
    for path in named {
        if path.is_dir() {
            images.extend(names_in(path)?.into_iter().map(|name| path.join(name)));
        } else {
            images.push(path.clone());
        }
    }
    Ok(images)
}

fn known_name(path: &Path) -> Option<&str> {
    path.file_name()?.to_str()
}

/// What --attitude-csv says of each image, by the name of its file.
fn known_of(arguments: &TagArguments, images: &[PathBuf]) -> anyhow::Result<HashMap<String, KnownPicture>> {
    let Some(path) = &arguments.attitude_csv else { return Ok(HashMap::new()) };
    let text = plain_file::read_text(path, MAX_TABLE_BYTES).map_err(|error| cannot_read(path, error))?;
    let shown = path.display().to_string();
    let mut table = Table::parse(&text, &shown)?;
    let rows = read_known(&mut table, None)?.rows;
    let ignored = table.ignored_columns();
    if !ignored.is_empty() {
        output::say(&format!("{shown}: not used: {}", ignored.join(", ")));
    }
    let known: HashMap<String, KnownPicture> = rows.into_iter().map(|known| (known.name.clone(), known)).collect();
    let without: Vec<&PathBuf> =
        images.iter().filter(|image| known_name(image).is_none_or(|name| !known.contains_key(name))).collect();
    match without[..] {
        [] => {}
        [..] if without.len() == images.len() => {
            anyhow::bail!(
                "{shown}: no row names one of the {} images (the first is {})",
                images.len(),
                images[0].display()
            )
        }
        [first, ..] => output::say(&format!(
            "{shown} lacks {} images, whose attitude and height are taken from the arguments or found: the first is {}",
            without.len(),
            first.display()
        )),
    }
    Ok(known)
}

/// Tags images on all processors. `done` gets each with its number, in the order of the images.
fn tag_all(
    arguments: &TagArguments,
    images: &[PathBuf],
    known: &HashMap<String, KnownPicture>,
    done: &mut dyn FnMut(usize, anyhow::Result<Tagged>) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let threads = cores().min(images.len().max(1));
    let next = AtomicUsize::new(0);
    let (sender, results) = mpsc::sync_channel(threads);
    thread::scope(|scope| {
        for _ in 0..threads {
            let (sender, next) = (sender.clone(), &next);
            scope.spawn(move || {
                while let Some((index, image)) =
                    Some(next.fetch_add(1, Ordering::Relaxed)).and_then(|index| Some((index, images.get(index)?)))
                {
                    let facts = known_name(image).and_then(|name| known.get(name));
                    let (photo, initial) = with_facts(arguments, facts);
                    // Results wait for those of earlier images, without their pictures.
                    let tagged = tag(arguments, &photo, image, initial).map(|(_, tagged)| tagged);
                    if sender.send((index, tagged)).is_err() {
                        return;
                    }
                }
            });
        }
        drop(sender);
        let (mut waiting, mut expected) = (BTreeMap::new(), 0);
        // Leaving early drops the receiver, which ends the threads.
        for (index, tagged) in results {
            waiting.insert(index, tagged);
            while let Some(tagged) = waiting.remove(&expected) {
                done(expected, tagged)?;
                expected += 1;
            }
        }
        Ok(())
    })
}

fn with_facts(arguments: &TagArguments, facts: Option<&KnownPicture>) -> (PhotoArguments, Option<Pose2>) {
    let tilt = facts.and_then(|facts| facts.tilt_rad);
    let attitude = tilt.map(|[roll, pitch]| Euler { yaw: 0.0, pitch, roll });
    let photo = arguments.photo.of_image(attitude, facts.and_then(|facts| facts.height_m));
    (photo, facts.and_then(|facts| facts.initial).or(arguments.initial))
}

fn verdict(path: &Path, tagged: Tagged, facts: Option<&KnownPicture>, arguments: &TagArguments) -> Verdict {
    let Tagged { lens, field, located, report, .. } = tagged;
    let is_half_known = with_facts(arguments, facts).1.is_some();
    let best = located.found.first().copied();
    Verdict { path: path.to_owned(), fit: report.fit, lens, field, best, is_half_known }
}

fn print_one(report: &Report, json: bool) -> anyhow::Result<()> {
    if json {
        return output::json(report);
    }
    let name = report.image.display();
    match (&report.best, report.fit) {
        (Some(best), FitQuality::Good | FitQuality::Doubtful) => output::lines(&format!(
            "{name}: {}, x {:.3} m, y {:.3} m, yaw {:.2} deg, z {:.3} m, roll {:.2}, pitch {:.2} deg on {}",
            word(report.fit),
            best.pose.x,
            best.pose.y,
            best.pose.yaw_deg,
            report.z,
            report.roll_deg,
            report.pitch_deg,
            report.field
        )),
        _ => output::lines(&format!("{name}: {}", word(FitQuality::None))),
    }
}

fn word(fit: FitQuality) -> &'static str {
    match fit {
        FitQuality::Good => "good",
        FitQuality::Doubtful => "doubtful",
        FitQuality::None => "no pose",
    }
}

/// How little a verdict may be trusted: by the fit, then by the lines that are not explained, then by chance.
fn doubt(verdict: &Verdict) -> (u8, f64) {
    let rank = match verdict.fit {
        FitQuality::None => 0,
        FitQuality::Doubtful => 1,
        FitQuality::Good => 2,
    };
    let agreement = verdict.best.map_or(0.0, |best| best.lines.share * best.explained * best.lines.digits.max(0.0));
    (rank, agreement)
}

/// A page of the images, the most doubtful first, each with its lines, name and verdict.
fn contact_sheet(verdicts: &[Verdict]) -> anyhow::Result<RgbImage> {
    let mut order: Vec<&Verdict> = verdicts.iter().collect();
    order.sort_by(|a, b| {
        let ((rank, agreement), (other_rank, other_agreement)) = (doubt(a), doubt(b));
        rank.cmp(&other_rank).then(agreement.total_cmp(&other_agreement))
    });
    if order.len() > MAX_SHEET_IMAGES {
        output::say(&format!("the page shows the {MAX_SHEET_IMAGES} most doubtful of {} images", order.len()));
        order.truncate(MAX_SHEET_IMAGES);
    }
    let mut pictures = Vec::new();
    for verdict in order {
        pictures.push((small_overlay(verdict)?, words(verdict)));
    }
    Ok(drawing::panels(&pictures, SHEET_COLUMNS))
}

/// The image in the size of the page, with the lines of its pose if it has one.
fn small_overlay(verdict: &Verdict) -> anyhow::Result<RgbImage> {
    let Verdict { path, fit, lens, field, best, .. } = verdict;
    let shown = || path.display().to_string();
    // Read again, because all images at once may not fit into memory.
    let bytes = plain_file::read(path, decode::MAX_IMAGE_FILE_BYTES).map_err(|error| cannot_read(path, error))?;
    let rgb = photo::rgb(&decode::compressed(&bytes).with_context(shown)?).with_context(shown)?;
    let drawn = match best {
        Some(best) if *fit != FitQuality::None => drawing::overlay(&rgb, lens, &best.map_from_link, field, LINE_COLOUR),
        _ => rgb,
    };
    let height_px = (u64::from(SHEET_WIDTH_PX) * u64::from(drawn.height()) / u64::from(drawn.width().max(1))).max(1);
    Ok(drawing::scaled(&drawn, SHEET_WIDTH_PX, height_px as u32))
}

fn words(verdict: &Verdict) -> String {
    let name = known_name(&verdict.path).unwrap_or("?");
    let count = name.chars().count();
    // The end of a name tells it from its neighbours.
    let name = match count > MAX_NAME_SHOWN {
        true => format!("...{}", name.chars().skip(count + 3 - MAX_NAME_SHOWN).collect::<String>()),
        false => name.to_owned(),
    };
    let place = match (&verdict.best, verdict.fit) {
        (Some(best), FitQuality::Good | FitQuality::Doubtful) => {
            let Pose2 { x, y, yaw } = best.place();
            format!(" {x:.2} {y:.2} m {:.0} deg", yaw.to_degrees())
        }
        _ => String::new(),
    };
    format!("{name}: {}{place}", word(verdict.fit))
}

/// Begins the table of poses, so that nothing is tagged in vain where none can be written.
fn begin_poses(path: &Path, images: &[PathBuf]) -> anyhow::Result<paths::PendingFile> {
    check_old(path, |old| old.starts_with(POSES_HEAD.as_bytes()))?;
    let folder = |path: &Path| path.parent().map(|folder| folder.join(".").canonicalize());
    let own = folder(path).and_then(Result::ok);
    if let Some(other) = images.iter().find(|image| folder(image).and_then(Result::ok) != own) {
        let what = "the poses of a database lie in the folder of their images";
        return Err(
            UsageError(format!("--poses {}: {what}, and {} is elsewhere", path.display(), other.display())).into()
        );
    }
    paths::PendingFile::create(path)
}

/// Writes the good poses, and the lens beside them if none is there.
fn write_poses(mut pending: paths::PendingFile, path: &Path, verdicts: &[Verdict]) -> anyhow::Result<()> {
    let failed = |error| cannot_write(path, error);
    writeln!(pending, "{POSES_HEAD}{SIGMAS_HEAD}").map_err(failed)?;
    let mut written = 0;
    let (mut halves, mut lens) = (0, None);
    for Verdict { path: image, fit, best, is_half_known, lens: own, .. } in verdicts {
        let (Some(best), FitQuality::Good, Some(name)) = (best, fit, known_name(image)) else { continue };
        let Some(sigmas) = best.sigmas else { continue };
        if name.contains(',') {
            output::say(&format!("{}: its name has a comma, so poses.csv cannot name it", image.display()));
            continue;
        }
        let Isometry { translation, .. } = best.map_from_link;
        let Euler { yaw, pitch, roll } = best.map_from_link.euler();
        let [yaw_deg, pitch_deg, roll_deg, rotation_deg] = [yaw, pitch, roll, sigmas.rotation_rad].map(f64::to_degrees);
        writeln!(
            pending,
            "{name},{:.4},{:.4},{:.4},{yaw_deg:.4},{pitch_deg:.4},{roll_deg:.4},{:.4},{rotation_deg:.4}",
            translation.x, translation.y, translation.z, sigmas.xy_m
        )
        .map_err(failed)?;
        written += 1;
        halves += usize::from(!is_half_known);
        lens = lens.or(Some(own));
    }
    pending.keep()?;
    let camera = path.with_file_name(CAMERA_FILE);
    if let Some(lens) = lens.filter(|_| !camera.exists()) {
        let mut file = paths::PendingFile::create(&camera)?;
        let text = camera_calibration_yaml(lens.parameters());
        file.write_all(text.as_bytes()).map_err(|error| cannot_write(&camera, error))?;
        file.keep()?;
    }
    output::say(&format!("{written} good poses written to {}", path.display()));
    if halves > 0 {
        output::say(&format!(
            "{halves} of them may be in the other half of the field, which lines alone do not tell: x, y and yaw_deg in --attitude-csv, \
             even rough ones, do"
        ));
    }
    Ok(())
}

fn summarize(verdicts: &[Verdict]) {
    let count = |fit| verdicts.iter().filter(|verdict| verdict.fit == fit).count();
    output::say(&format!(
        "{} images: {} good, {} doubtful, {} without a pose",
        verdicts.len(),
        count(FitQuality::Good),
        count(FitQuality::Doubtful),
        count(FitQuality::None)
    ));
}
