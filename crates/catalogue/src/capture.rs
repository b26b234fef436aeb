//! The rows of a capture: its tags, and where its images lie.

use std::collections::{HashMap, VecDeque};
use std::path::{Path, PathBuf};

use jiff::Timestamp;

use super::error::{CatalogueError, io};
use super::partition;
use super::row::{CatalogueRow, short};
use super::{FORMAT, FileHead};
use realitysim_config::plain_file;
use realitysim_database::{best_tags, image_quality, in_parallel};
use realitysim_geometry::Isometry;
use realitysim_log_input::decode;
use realitysim_log_input::log::{LogSource, files_of};
use realitysim_recording::{Head, Loss, SESSION_FILE, SessionInfo, losses, read_info, source_hash};
use realitysim_ros2::mcap_read::{LogMessage, Selection};
use realitysim_ros2::messages::FrameTag;

/// The rows of a session, and where they belong.
#[derive(Clone, Debug, PartialEq)]
pub struct CapturedSession {
    /// Where the rows are from.
    pub head: FileHead,
    /// Path of their file within a catalogue.
    pub file: PathBuf,
    /// One row for each tag, in the order of the frames.
    pub rows: Vec<CatalogueRow>,
    /// Parts of the capture that cannot be read.
    pub losses: Vec<Loss>,
    /// Reasons why rows may not be what they are taken for.
    pub warnings: Vec<String>,
}

/// Reads the rows of a capture: of its refined tags if they are better, as the image database does, else of its recorded ones.
/// `done` gets the number of images read so far.
///
/// # Errors
///
/// Fails if the folder is no capture, its `session.json` states no time of its start, or its log cannot be opened.
pub fn rows_of_capture(capture: &Path, done: &mut dyn FnMut(u64)) -> Result<CapturedSession, CatalogueError> {
    let capture = capture.canonicalize().map_err(io(capture))?;
    let path = capture.join(SESSION_FILE);
    if !path.is_file() {
        let what =
            format!("no capture: it lacks {SESSION_FILE}; `realitysim replay LOG -o DIR` makes a capture of a log");
        return Err(CatalogueError::Source { path: capture, what });
    }
    let wrong = |what: String| CatalogueError::Source { path: path.clone(), what };
    let bytes = plain_file::read(&path, MAX_SESSION_BYTES).map_err(io(&path))?;
    let head = Head::parse(&bytes).map_err(wrong)?;
    let started: Timestamp = head.started.parse().map_err(|_| {
        wrong(format!("started is {:?}, and a time such as 2026-11-28T10:00:00Z is needed", head.started))
    })?;
    let info = read_info(&capture)?;
    let source_hash = source_hash(&capture)?;
    let (refined, tags) = best_tags(&capture)?;
    let same = CatalogueRow {
        session: capture.file_name().unwrap_or_default().to_string_lossy().into_owned(),
        session_id: head.id(&bytes).as_str().to_owned(),
        refined: refined.is_some(),
        software: info.software.clone(),
        config_hash: config_hash(&bytes),
        ..CatalogueRow::default()
    };
    let mut rows: Vec<CatalogueRow> = tags.found.iter().map(|tag| row_of(tag, &same)).collect();
    let mut losses = tags.losses;
    for loss in place_images(&capture, &info, &mut rows, done)? {
        if !losses.contains(&loss) {
            losses.push(loss);
        }
    }
    let valid = rows.iter().filter(|row| row.valid).count() as u64;
    let file = partition::folder_of(&info.field, started, &head.robot);
    Ok(CapturedSession {
        file: file.join(partition::file_name(&same.session, &same.session_id)),
        warnings: clock_warning(&capture, started, &rows).into_iter().collect(),
        head: FileHead {
            format: FORMAT,
            capture: capture.display().to_string(),
            source_hash,
            valid,
            session: same.session,
            session_id: same.session_id,
        },
        rows,
        losses,
    })
}

/// Largest `session.json`, bytes: it holds a config, a field and a lens.
const MAX_SESSION_BYTES: u64 = 4 << 20;

/// The hash of the settings as `session.json` states them, 16 hexadecimal digits.
fn config_hash(session: &[u8]) -> String {
    let value: serde_json::Value = serde_json::from_slice(session).unwrap_or_default();
    blake3::hash(value["settings"].to_string().as_bytes()).to_hex()[..16].to_owned()
}

/// The row of a tag, without its image; `same` has what all rows of the session share.
fn row_of(tag: &FrameTag, same: &CatalogueRow) -> CatalogueRow {
    let is_valid = tag.valid && Isometry::from(tag.pose.pose).is_finite();
    let mut row = CatalogueRow {
        sequence: i64::try_from(tag.sequence).unwrap_or(i64::MAX),
        stamp_ns: tag.header.stamp.to_nanoseconds(),
        valid: is_valid,
        reason: if tag.valid && !is_valid { NOT_FINITE } else { &tag.reason }.to_owned(),
        ambiguous: tag.ambiguous,
        residual: short(tag.residual as f32),
        lines_expected: i32::try_from(tag.lines_expected).unwrap_or(i32::MAX),
        lines_fitting: i32::try_from(tag.lines_fitting).unwrap_or(i32::MAX),
        ..same.clone()
    };
    if is_valid {
        let position = tag.pose.pose.position;
        row.set_pose([position.x, position.y, position.z], [tag.yaw, tag.pitch, tag.roll].map(f64::to_degrees));
        let sigma = |number: usize| tag.pose.covariance[7 * number].max(0.0).sqrt();
        let degrees = |number: usize| sigma(number).to_degrees();
        row.set_sigmas([sigma(0), sigma(1), sigma(2), degrees(3), degrees(4), degrees(5)]);
    }
    row
}

/// Reason of a tag that claims to be valid and whose pose is not finite, as the localization names it.
const NOT_FINITE: &str = "numerical_fault";

/// States where the image of each row lies; rows of frames that were not written stay without. Returns what could not be read.
fn place_images(
    capture: &Path,
    info: &SessionInfo,
    rows: &mut [CatalogueRow],
    done: &mut dyn FnMut(u64),
) -> Result<Vec<Loss>, CatalogueError> {
    let mut waiting: HashMap<i64, VecDeque<usize>> = HashMap::new();
    for (number, row) in rows.iter().enumerate() {
        waiting.entry(row.stamp_ns).or_default().push_back(number);
    }
    let mut log = LogSource::with_outputs(files_of(capture)?, Selection::topics([info.settings.topics.image.as_str()]));
    let (mut images, mut batch) = (0, Vec::with_capacity(MAX_BATCH));
    loop {
        let message = log.next().transpose()?;
        if message.is_none() || batch.len() == MAX_BATCH {
            measure(&mut batch, rows);
        }
        let Some(message) = message else { break };
        images += 1;
        done(images);
        let number = decode::stamp_ns(&message).ok().and_then(|stamp| waiting.get_mut(&stamp)?.pop_front());
        let (Some(row), Some((file, at))) = (number.and_then(|number| rows.get_mut(number)), log.place()) else {
            continue;
        };
        let hash = blake3::hash(&message.data);
        row.segment = file.file_name().map(|name| name.to_string_lossy().into_owned());
        row.offset = i64::try_from(at).ok();
        row.length = i32::try_from(message.data.len()).ok();
        row.blake3 = hash.as_bytes().first_chunk().copied();
        batch.extend(number.map(|number| (number, message)));
    }
    Ok(losses(capture, log.damage()))
}

/// Most images that are decoded together, which bounds the memory.
const MAX_BATCH: usize = 64;

/// States brightness and sharpness of a batch of images in their rows, and empties the batch.
fn measure(batch: &mut Vec<(usize, LogMessage)>, rows: &mut [CatalogueRow]) {
    let qualities = in_parallel(batch.len(), |index| image_quality(&batch[index].1));
    for ((number, _), quality) in batch.drain(..).zip(qualities) {
        let (Some(row), Some([sharpness, brightness])) = (rows.get_mut(number), quality) else { continue };
        row.brightness = Some(brightness.round() as i32);
        row.sharpness = Some(short(sharpness));
    }
}

/// Largest difference between the start of a session and the first stamp of its frames, seconds, that is no other clock: the
/// start is that of the first message, and a camera may follow late.
const SAME_CLOCK_S: i64 = 3600;

/// Names the clocks of a session whose frames are stamped at another time than it says that it began.
fn clock_warning(capture: &Path, started: Timestamp, rows: &[CatalogueRow]) -> Option<String> {
    let first_ns = rows.iter().map(|row| row.stamp_ns).min()?;
    let first = Timestamp::from_nanosecond(i128::from(first_ns)).ok()?;
    let differ = (first.as_second() - started.as_second()).abs() > SAME_CLOCK_S;
    differ.then(|| {
        format!(
            "{}: its frames are stamped from {first:.0} on, and its {SESSION_FILE} says that it began at {started:.0}: the clocks \
             differ; its date is that of {SESSION_FILE}",
            capture.display()
        )
    })
}
