//! Reads captures and folders of images into records.

use std::collections::{HashMap, HashSet, VecDeque};
use std::fs;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::thread;

use glam::DVec3;
use serde::Serialize;

use super::contents::{Source, SourceKind, TagLimits};
use super::error::{DatabaseError, io};
use super::lit_pixels::LitPixels;
use super::pixels::{colours, quality, read_bytes};
use super::record::{Form, Record};
use super::remote_files;
use realitysim_config::{ConfigError, load_field, load_lens_for_image, plain_file};
use realitysim_geometry::{Euler, FieldDimensions, Isometry, LensParameters};
use realitysim_log_input::log::{self, LogSource};
use realitysim_log_input::{InputSource, body_mask, decode};
use realitysim_recording::{
    Loss, REFINED_FOLDER, Readout, ReadoutError, RefinedInfo, SESSION_FILE, losses, read_info, read_tags, refined_info,
};
use realitysim_ros2::mcap_read::{LogMessage, Selection};
use realitysim_ros2::messages::{CompressedImageView, FrameTag};
use realitysim_views::{Hall, MAX_HEIGHT_M, MAX_PLACE_M, MAX_TURN_DEG, MIN_HEIGHT_M};
use realitysim_vision::BodyMask;

/// A source that was read, with its images.
pub(super) struct Read {
    pub(super) source: Source,
    /// The images. The number of their source is set when they are added to the contents.
    pub(super) records: Vec<Record>,
    /// The source's field; `None` if the source does not name it.
    pub(super) field: Option<FieldDimensions>,
    /// Number of images left out because their valid tag does not know which half of the field it is in.
    pub(super) ambiguous: u64,
    /// Number of images left out because the standard deviation of their pose exceeds the limit.
    pub(super) imprecise: u64,
    /// Number of images whose pose has no standard deviations, for which some are assumed.
    pub(super) assumed: u64,
    /// Parts that could not be read.
    pub(super) losses: Vec<Loss>,
    /// Why there is no record, if there is none.
    pub(super) empty: Option<Loss>,
    /// The lens of the source, if it was stated for images of another size and scaled to these.
    pub(super) scaled: Option<ScaledLens>,
    /// The pixels that the images light.
    pub(super) lit: LitPixels,
    /// Masks of the robot's own body that the source itself holds.
    pub(super) bodies: Vec<BodyMask>,
}

/// A lens that was stated for images of another size, and scaled: right if the images were scaled, wrong if they were cut.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ScaledLens {
    /// The file that states the lens.
    pub file: PathBuf,
    /// Width and height of the images that it is stated for, pixels.
    pub stated: [u32; 2],
    /// Width and height of the images that it was scaled to, pixels.
    pub images: [u32; 2],
}

/// The file of a folder of images with their poses.
const POSES: &str = "poses.csv";
/// The first line of that file.
pub const POSES_HEAD: &str = "file,x,y,z,yaw_deg,pitch_deg,roll_deg";
/// What the first line may go on with: standard deviations of the position along its longer axis, and of the rotation.
pub const SIGMAS_HEAD: &str = ",sigma_xy_m,sigma_rotation_deg";
/// Standard deviation of a pose that is stated as exact, metres and radians.
const EXACT: f64 = 1e-6;
/// Largest standard deviations of a pose: beyond a field and a full turn nothing is known.
const MAX_SIGMA_M: f64 = 100.0;
const MAX_SIGMA_DEG: f64 = 360.0;
/// The file of a folder of images with its lens.
const CAMERA: &str = "camera_info.yaml";
/// The file of a folder of images with its field, if it has one.
pub const FIELD_FILE: &str = "field.toml";
/// The file of a folder of images that is dark where they show the robot's own body.
const MASK: &str = "body_mask.png";
/// Share of the pixels from which a body mask is refused, because no robot hides so much.
const ALL_HIDDEN: f64 = 0.95;
/// Most images that are held to be decoded together, which bounds the memory.
const MAX_BATCH: usize = 64;

/// Whether a path is a capture or a folder of images.
pub(super) fn is_source(path: &Path) -> bool {
    path.join(POSES).is_file() || path.join(SESSION_FILE).is_file()
}

/// Reads a capture, one of its segments, or a folder with `poses.csv`. `done` gets the number of images so far.
pub(super) fn read(path: &Path, limits: TagLimits, done: &mut dyn FnMut(u64)) -> Result<Read, DatabaseError> {
    let here = remote_files::local(path).map_err(io(path))?;
    let mut read =
        if here.join(POSES).is_file() { read_folder(here, limits, done)? } else { read_capture(here, limits, done)? };
    // Its images are read from where the source lies, not from a copy that may go.
    read.source.path = remote_files::absolute(path).map_err(io(path))?;
    Ok(read)
}

fn read_capture(path: PathBuf, limits: TagLimits, done: &mut dyn FnMut(u64)) -> Result<Read, DatabaseError> {
    let folder = if path.is_dir() { path.as_path() } else { path.parent().unwrap_or(&path) };
    if !folder.join(SESSION_FILE).is_file() {
        let what = "neither a capture (with session.json) nor a folder of images (with poses.csv); `realitysim replay LOG -o DIR` \
                    makes a capture of a log";
        return Err(DatabaseError::Source { path, what: what.to_owned() });
    }
    let info = read_info(folder)?;
    let (refined, Readout { found: tags, mut losses, .. }) = best_tags(&path)?;
    let mut waiting: HashMap<i64, VecDeque<&FrameTag>> = HashMap::new();
    let is_somewhere = |tag: &&FrameTag| Isometry::from(tag.pose.pose).is_finite();
    let (mut ambiguous, mut imprecise) = (0, 0);
    for tag in tags.iter().filter(|tag| tag.valid).filter(is_somewhere) {
        if tag.ambiguous && !limits.ambiguous {
            ambiguous += 1;
            continue;
        }
        let sigma_m = tag.pose.sigma_xy_m();
        if sigma_m.is_nan() || sigma_m > limits.sigma_m {
            imprecise += 1;
            continue;
        }
        waiting.entry(tag.header.stamp.to_nanoseconds()).or_default().push_back(tag);
    }
    let files = log::files_of(&path)?;
    // Refined tags belong to the lens that was fitted with them.
    let lens = refined.map_or(info.lens, |refined| refined.lens);
    let topic = info.settings.topics.image.clone();
    let mut log = LogSource::with_outputs(files.clone(), Selection::topics([topic.as_str()]));
    let (mut records, mut left_out, mut batch, mut lit) = (Vec::new(), 0, Vec::new(), LitPixels::default());
    let (mut other_sizes, mut images) = (0, 0_u64);
    let size = [lens.width as usize, lens.height as usize];
    loop {
        let message = log.next().transpose()?;
        if message.is_none() || batch.len() == MAX_BATCH {
            let misfits = decode_batch(&mut batch, size, &mut records, &mut lit);
            left_out += misfits.all;
            other_sizes += misfits.other_sizes;
            done(records.len() as u64);
        }
        let Some(message) = message else { break };
        images += 1;
        let tag = decode::stamp_ns(&message).ok().and_then(|stamp| waiting.get_mut(&stamp)?.pop_front());
        let place =
            log.place().and_then(|(file, at)| Some((files.iter().position(|known| *known == *file)? as u32, at)));
        match (tag, place, stored(&message)) {
            (Some(tag), Some((file, at)), Some((within, bytes, form))) => {
                batch.push((record_of(tag, file, at + within, bytes, form), bytes.to_vec()));
            }
            (Some(_), None, _) => {
                let what = "its images are compressed once more and cannot be found by their place: record it anew with \
                            `realitysim replay`";
                return Err(DatabaseError::Source { path, what: what.to_owned() });
            }
            _ => left_out += 1,
        }
    }
    losses.extend(
        self::losses(&path, log.damage()).into_iter().filter(|loss| !losses.contains(loss)).collect::<Vec<_>>(),
    );
    if other_sizes > 0 {
        let what = format!("{other_sizes} images are not of the size of its lens, {} x {}: left out", size[0], size[1]);
        losses.push(Loss::new(&path, what));
    }
    let empty = records.is_empty().then(|| {
        let valid = tags.iter().filter(|tag| tag.valid).count();
        let what = match (images, valid, tags.len()) {
            (0, ..) => format!(
                "no image on {topic}, where its session.json (settings.topics.image) says that they are; `realitysim replay` makes a capture of \
                 its segments anew"
            ),
            (_, 0, tags) => format!("none of its {tags} tags is valid"),
            (_, valid, _) if imprecise == valid as u64 => {
                format!("none of its {valid} valid tags is known to {} m (--max-sigma takes others)", limits.sigma_m)
            }
            (_, valid, _) if ambiguous == valid as u64 => {
                format!("none of its {valid} valid tags knows which half of the field it is in (--ambiguous takes them)")
            }
            _ => format!("none of its {images} images on {topic} has a valid tag, the size of its lens, and decodes"),
        };
        Loss::new(&path, what)
    });
    let relative = |file: &PathBuf| file.strip_prefix(&path).map(Path::to_owned).unwrap_or_default();
    let source = Source {
        kind: SourceKind::Capture,
        lens,
        files: files.iter().map(relative).collect(),
        dark: None,
        darkening: None,
        moved: None,
        hall: Hall::default(),
        // A capture without stored masks names the files of the machine where it was made.
        body_masks: info.settings.camera.body_mask.iter().map(|mask| mask.png.clone()).collect(),
        images: records.len() as u64,
        left_out,
        limits,
        // Scenes are rendered without goals.
        goals: !info.source.is_some_and(|source| InputSource::is_scene(Path::new(&source))),
        path,
    };
    let bodies = info.body_masks.iter().filter_map(|runs| BodyMask::from_runs(size[0], size[1], runs)).collect();
    let assumed = without_sigmas(&records);
    Ok(Read {
        source,
        records,
        field: Some(info.field),
        ambiguous,
        imprecise,
        assumed,
        losses,
        empty,
        scaled: None,
        lit,
        bodies,
    })
}

/// The tags by which the images of a capture, or of one of its segments, are added, and the refined lens if they are refined ones.
pub fn best_tags(path: &Path) -> Result<(Option<RefinedInfo>, Readout<FrameTag>), DatabaseError> {
    let folder = if path.is_dir() { path } else { path.parent().unwrap_or(path) };
    let refined = match refined_info(path) {
        // Refined tags are used only if they fit held-out lines better than the recorded ones.
        Ok(refined) => refined.filter(RefinedInfo::is_better),
        Err(error) => return Err(DatabaseError::Source { path: path.to_owned(), what: error.to_string() }),
    };
    let refined_folder = folder.join(REFINED_FOLDER);
    let tags_from = if refined.is_some() { &refined_folder } else { path };
    let tags = match read_tags(tags_from) {
        // The camera may have sent nothing during this segment.
        Err(ReadoutError::NoMessages { loss: None, .. }) => {
            Readout { found: Vec::new(), losses: Vec::new(), warnings: Vec::new() }
        }
        tags => tags?,
    };
    Ok((refined, tags))
}

/// The covariances of the poses of a capture's images by their stamps in nanoseconds, each 6 x 6 row by row: x, y, z in metres and the
/// rotations about the fixed axes x, y, z in radians. A folder of images has none.
pub fn covariances(source: &Source) -> Result<HashMap<i64, [f64; 36]>, DatabaseError> {
    if source.kind == SourceKind::Folder {
        return Ok(HashMap::new());
    }
    let (_, tags) = best_tags(&remote_files::local(&source.path).map_err(io(&source.path))?)?;
    let valid = tags.found.iter().filter(|tag| tag.valid);
    Ok(valid.map(|tag| (tag.header.stamp.to_nanoseconds(), tag.pose.covariance)).collect())
}

/// Number of images whose pose has no standard deviations.
fn without_sigmas(records: &[Record]) -> u64 {
    records.iter().filter(|record| !record.says_how_good_it_is()).count() as u64
}

/// The stored image in a message: where its bytes begin, the bytes, and their form.
fn stored(message: &LogMessage) -> Option<(u64, &[u8], Form)> {
    if message.channel.type_name != "sensor_msgs/msg/CompressedImage" {
        return Some((0, &message.data, Form::RosImage));
    }
    let image = CompressedImageView::decode(&message.data).ok()?.data;
    Some(((image.as_ptr() as usize - message.data.as_ptr() as usize) as u64, image, Form::File))
}

/// Sharpness and brightness of the image in a message, as a database has them of its images; `None` if the image does not decode.
///
/// Sharpness is the mean absolute second difference of green along the rows over the mean of green, brightness is that mean, 0 to 255.
/// Black pixels do not count.
pub fn image_quality(message: &LogMessage) -> Option<[f32; 2]> {
    let (_, bytes, form) = stored(message)?;
    let (sharpness, brightness) = quality(&colours(bytes, form).ok()?);
    Some([sharpness, brightness])
}

/// A record of a tag and its stored image, without the image's quality. Standard deviations are the larger ones of x and y, and
/// of the three rotations.
fn record_of(tag: &FrameTag, file: u32, offset: u64, bytes: &[u8], form: Form) -> Record {
    let covariance = &tag.pose.covariance;
    let sigma = |a: usize, b: usize| libm::sqrt(covariance[a].max(covariance[b]).max(0.0)) as f32;
    Record {
        file,
        offset,
        length: bytes.len() as u32,
        crc: crc32fast::hash(bytes),
        stamp_ns: tag.header.stamp.to_nanoseconds(),
        sigma_m: sigma(0, 7),
        sigma_rad: sigma(21, 28).max(sigma(35, 35)),
        form,
        ..Record::at(&Isometry::from(tag.pose.pose))
    }
}

/// Numbers of images that are left out of a batch.
#[derive(Clone, Copy, Debug, Default)]
struct Misfits {
    /// Images that do not decode or do not have the size of their lens.
    all: u64,
    /// Images that do not have the size of their lens.
    other_sizes: u64,
}

/// Decodes a batch on all processors, and adds the good images to `records` and `lit`.
fn decode_batch(
    batch: &mut Vec<(Record, Vec<u8>)>,
    [width, height]: [usize; 2],
    records: &mut Vec<Record>,
    lit: &mut LitPixels,
) -> Misfits {
    let threads = thread::available_parallelism().map_or(1, usize::from);
    let share = batch.len().div_ceil(threads).max(1);
    let (before, mut other_sizes) = (records.len(), 0);
    thread::scope(|scope| {
        let look = |part: &[(Record, Vec<u8>)]| -> (Vec<Record>, LitPixels, u64) {
            let (mut lit, mut others) = (LitPixels::default(), 0);
            let good = part.iter().filter_map(|(record, bytes)| {
                let colours = colours(bytes, record.form).ok()?;
                let (sharpness, brightness) = quality(&colours);
                let fits = colours.width == width && colours.height == height;
                others += u64::from(!fits);
                fits.then(|| {
                    lit.add(&colours.rgb);
                    Record { sharpness, brightness, ..*record }
                })
            });
            (good.collect(), lit, others)
        };
        let workers: Vec<_> = batch.chunks(share).map(|part| scope.spawn(move || look(part))).collect();
        for worker in workers {
            // If a decoder panics, its part of the batch counts as left out.
            if let Ok((found, more, others)) = worker.join() {
                records.extend(found);
                lit.join(&more);
                other_sizes += others;
            }
        }
    });
    let all = (batch.len() - (records.len() - before)) as u64;
    batch.clear();
    Misfits { all, other_sizes }
}

/// Largest `poses.csv`: a line takes some hundred bytes, so it has two million images.
const MAX_TABLE_BYTES: u64 = 256 << 20;

/// Reads a folder of images with `poses.csv` and `camera_info.yaml`.
fn read_folder(path: PathBuf, limits: TagLimits, done: &mut dyn FnMut(u64)) -> Result<Read, DatabaseError> {
    let table = path.join(POSES);
    let text = plain_file::read_text(&table, MAX_TABLE_BYTES).map_err(io(&table))?;
    let wrong =
        |line: usize, what: String| DatabaseError::Source { path: table.clone(), what: format!("line {line}: {what}") };
    let mut lines = text.trim_start_matches('\u{feff}').lines().enumerate().map(|(i, line)| (i + 1, line.trim()));
    let has_sigmas = match lines.next() {
        Some((_, head)) if head == POSES_HEAD => false,
        Some((_, head)) if head.strip_prefix(POSES_HEAD) == Some(SIGMAS_HEAD) => true,
        found => {
            let found = found.map_or("", |(_, head)| head).to_owned();
            let may_follow = format!("perhaps with {SIGMAS_HEAD:?} behind it");
            return Err(wrong(1, format!("the head is {found:?}, and {POSES_HEAD:?} is needed, {may_follow}")));
        }
    };
    let (mut files, mut records, mut losses, mut batch) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let (mut lens, mut scaled, mut left_out, mut imprecise, mut lit) = (None, None, 0, 0, LitPixels::default());
    for (line, text) in lines.filter(|(_, text)| !text.is_empty()) {
        let Posed { name, pose, sigma_m, sigma_rad } = row(text, has_sigmas).map_err(|what| wrong(line, what))?;
        let file = path.join(&name);
        let inside = name.components().all(|part| matches!(part, std::path::Component::Normal(_)));
        if !inside {
            return Err(wrong(line, format!("{} does not lie in this folder", name.display())));
        }
        if sigma_m > limits.sigma_m {
            imprecise += 1;
            left_out += 1;
            continue;
        }
        let read = |meta: fs::Metadata| read_bytes(&file, 0, meta.len().min(u64::from(u32::MAX)) as u32);
        let bytes = match fs::metadata(&file).and_then(read) {
            Ok(bytes) => bytes,
            Err(error) => {
                losses.push(Loss::new(&file, format!("cannot be read: {error}")));
                left_out += 1;
                continue;
            }
        };
        if lens.is_none() {
            lens = match colours(&bytes, Form::File) {
                Ok(first) => {
                    let camera = camera_of(&path, &file, [first.width as u32, first.height as u32])?;
                    scaled = camera.1;
                    Some(camera.0)
                }
                Err(what) => {
                    losses.push(Loss::new(&file, what));
                    left_out += 1;
                    continue;
                }
            };
        }
        let mut record = record_of(&FrameTag::default(), files.len() as u32, 0, &bytes, Form::File);
        record.set_pose(&pose);
        (record.sigma_m, record.sigma_rad) = (sigma_m as f32, sigma_rad as f32);
        files.push(name);
        batch.push((record, bytes));
        if batch.len() == MAX_BATCH {
            decode_folder_batch(&mut batch, &lens, &mut records, &mut lit);
            done(records.len() as u64);
        }
    }
    decode_folder_batch(&mut batch, &lens, &mut records, &mut lit);
    done(records.len() as u64);
    let good: HashSet<u32> = records.iter().map(|record| record.file).collect();
    for (_, name) in files.iter().enumerate().filter(|(number, _)| !good.contains(&(*number as u32))) {
        let [width, height] = lens.as_ref().map_or([0; 2], |lens: &LensParameters| [lens.width, lens.height]);
        losses.push(Loss::new(&path.join(name), format!("does not decode as a picture of {width} x {height}")));
        left_out += 1;
    }
    let lens = lens.ok_or_else(|| DatabaseError::Source {
        path: path.clone(),
        what: match imprecise {
            0 => format!("{POSES} names no image that can be read"),
            _ => format!("none of its poses is known to {} m (--max-sigma takes others)", limits.sigma_m),
        },
    })?;
    let bodies = body_of(&path, &lens)?.into_iter().collect();
    let field = field_of(&path)?;
    let empty = records.is_empty().then(|| Loss::new(&path, "none of its images can be read"));
    let (kind, images) = (SourceKind::Folder, records.len() as u64);
    let source = Source {
        kind,
        path,
        lens,
        files,
        body_masks: Vec::new(),
        dark: None,
        darkening: None,
        moved: None,
        hall: Hall::default(),
        images,
        left_out,
        limits,
        goals: true,
    };
    let assumed = without_sigmas(&records);
    Ok(Read { source, records, field, ambiguous: 0, imprecise, assumed, losses, empty, scaled, lit, bodies })
}

/// Decodes a batch of a folder's images, once the lens is known from the first readable one.
fn decode_folder_batch(
    batch: &mut Vec<(Record, Vec<u8>)>,
    lens: &Option<LensParameters>,
    records: &mut Vec<Record>,
    lit: &mut LitPixels,
) {
    let Some(lens) = lens else { return };
    decode_batch(batch, [lens.width as usize, lens.height as usize], records, lit);
}

/// Reads the lens from `camera_info.yaml` beside the images, for images of this size, and whether it was scaled to them.
fn camera_of(
    folder: &Path,
    image: &Path,
    [width, height]: [u32; 2],
) -> Result<(LensParameters, Option<ScaledLens>), DatabaseError> {
    let path = folder.join(CAMERA);
    if !path.is_file() {
        let what = format!("without {CAMERA}, as ROS camera_calibration writes it, nobody knows the lens");
        return Err(DatabaseError::Source { path: folder.to_owned(), what });
    }
    let file = load_lens_for_image(&path.display().to_string(), width, height).map_err(|error| {
        DatabaseError::Source { path: folder.to_owned(), what: format!("{error} (as {} is)", image.display()) }
    })?;
    let scaled = file.scaled_from.map(|stated| ScaledLens { file: path, stated, images: [width, height] });
    Ok((file.lens.parameters().clone(), scaled))
}

/// Reads the field beside the images; `None` if there is none.
fn field_of(folder: &Path) -> Result<Option<FieldDimensions>, DatabaseError> {
    let file = folder.join(FIELD_FILE);
    if !file.is_file() {
        return Ok(None);
    }
    let wrong = |error: ConfigError| DatabaseError::Source { path: folder.to_owned(), what: error.to_string() };
    load_field(&file.display().to_string()).map(Some).map_err(wrong)
}

/// Reads the body mask beside the images; `None` if there is none.
fn body_of(folder: &Path, lens: &LensParameters) -> Result<Option<BodyMask>, DatabaseError> {
    let path = folder.join(MASK);
    let Ok(there) = path.symlink_metadata() else { return Ok(None) };
    let read = || -> Result<BodyMask, String> {
        // Opening a named pipe would block.
        if !there.is_file() && !path.is_file() {
            return Err("not a plain file".to_owned());
        }
        let mask = body_mask(&path.display().to_string(), lens.width, lens.height)?;
        let hidden = mask.to_gray().iter().filter(|pixel| **pixel == 0).count() as f64;
        match hidden / (f64::from(lens.width) * f64::from(lens.height)) {
            ALL_HIDDEN.. => Err("hides nearly all of the picture: the robot is dark in it, the rest bright".to_owned()),
            0.0 => Err("hides nothing: the robot is dark in it, the rest bright".to_owned()),
            _ => Ok(mask),
        }
    };
    read().map(Some).map_err(|what| DatabaseError::Image { path, what })
}

/// A line of `poses.csv`.
struct Posed {
    /// Name of the image's file.
    name: PathBuf,
    /// Pose of `camera_link` in `map`.
    pose: Isometry,
    /// Standard deviation of the position along its longer axis, metres; 0 if it is not stated.
    sigma_m: f64,
    /// Standard deviation of the rotation, radians; 0 if it is not stated.
    sigma_rad: f64,
}

/// Parses a line of `poses.csv`. An empty standard deviation is not stated.
fn row(text: &str, has_sigmas: bool) -> Result<Posed, String> {
    let cells: Vec<&str> = text.split(',').map(str::trim).collect();
    let [name, numbers @ ..] = cells.as_slice() else { return Err("empty".to_owned()) };
    let needed = if has_sigmas { 9 } else { 7 };
    if cells.len() != needed {
        let sigmas = if has_sigmas { SIGMAS_HEAD } else { "" };
        return Err(format!("{} cells, and {needed} are needed: {POSES_HEAD}{sigmas}", cells.len()));
    }
    let number = |cell: &str| match cell.parse() {
        Ok(number) if f64::is_finite(number) => Ok(number),
        _ => Err(format!("{cell:?} is no number")),
    };
    let mut values = [0.0; 8];
    for (index, (value, cell)) in values.iter_mut().zip(numbers).enumerate() {
        let is_sigma = index >= 6;
        *value = if is_sigma && cell.is_empty() { 0.0 } else { number(cell)? };
    }
    let [x, y, z, yaw, pitch, roll, sigma_m, sigma_deg] = values;
    let is_stated = |index: usize| numbers.get(index).is_some_and(|cell: &&str| !cell.is_empty());
    if is_stated(6) != is_stated(7) {
        return Err("sigma_xy_m and sigma_rotation_deg are stated both, or both left empty".to_owned());
    }
    let within = |name: &str, value: f64, range: RangeInclusive<f64>| {
        let (low, high) = (range.start(), range.end());
        if range.contains(&value) { Ok(()) } else { Err(format!("{name} is {value}: {low} to {high} is possible")) }
    };
    within("x", x, -MAX_PLACE_M..=MAX_PLACE_M)?;
    within("y", y, -MAX_PLACE_M..=MAX_PLACE_M)?;
    within("z", z, MIN_HEIGHT_M..=MAX_HEIGHT_M)?;
    for (name, angle) in [("yaw_deg", yaw), ("pitch_deg", pitch), ("roll_deg", roll)] {
        within(name, angle, -MAX_TURN_DEG..=MAX_TURN_DEG)?;
    }
    within("sigma_xy_m", sigma_m, 0.0..=MAX_SIGMA_M)?;
    within("sigma_rotation_deg", sigma_deg, 0.0..=MAX_SIGMA_DEG)?;
    let euler = Euler { yaw: yaw.to_radians(), pitch: pitch.to_radians(), roll: roll.to_radians() };
    let pose = Isometry::from_euler(euler, DVec3::new(x, y, z));
    // 0 would say that nothing is known, and an exact pose is known best.
    let stated = |sigma: f64| if is_stated(6) { sigma.max(EXACT) } else { 0.0 };
    let (sigma_m, sigma_rad) = (stated(sigma_m), stated(sigma_deg.to_radians()));
    Ok(Posed { name: PathBuf::from(name), pose, sigma_m, sigma_rad })
}
