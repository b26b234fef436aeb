//! Command `realitysim export`: writes tags or frames in formats of other programs.

use std::collections::{HashMap, VecDeque};
use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::{Args, ValueEnum};
use serde::Serialize;

use super::paths::{cannot_write, check_old, check_output, make_folder, write};
use super::settings::UsageError;
use super::{Outcome, output};
use crate::config::camera_calibration_yaml;
use crate::database::{POSES_HEAD, SIGMAS_HEAD};
use crate::log_input::decode;
use crate::log_input::log::{self, LogSource};
use crate::recording::{Loss, Readout, losses, read_info, read_tags};
use crate::ros2::mcap_read::{LogMessage, Selection};
use crate::ros2::messages::{CompressedImageView, FrameTag};
use crate::ros2::topics;
use crate::vision::BodyMask;

/// Write a capture's tags or frames in a form that other programs read
///
/// tum: a text file, `stamp tx ty tz qx qy qz qw` of camera_link in map, valid tags only (evo reads it).
/// images: a folder with one file per frame, tags.csv and tags.jsonl; JPEG and PNG are copied byte for byte, raw
/// frames become PNG. With poses.csv (valid poses that know their half of the field) and camera_info.yaml it is a folder of images
/// for `db add`. What a damaged or incomplete capture no longer holds is named, and the rest written (exit code 3).
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim export captures/2026-11-21T10-00-00Z-robot --to images -o frames/")]
pub struct ExportArguments {
    /// A capture's folder, or one of its segments
    capture: PathBuf,
    /// What to write
    #[arg(long)]
    to: Format,
    /// File (tum) or folder (images) to write, outside of any capture
    #[arg(short, long)]
    output: PathBuf,
}

#[derive(Clone, Copy, ValueEnum)]
enum Format {
    Tum,
    Images,
}

#[derive(Serialize)]
struct Report {
    output: PathBuf,
    written: usize,
    lost: Vec<Loss>,
}

pub fn run(arguments: &ExportArguments, json: bool) -> anyhow::Result<Outcome> {
    let ExportArguments { capture, output, to } = arguments;
    check_output(output, &[capture])?;
    let Readout { found: tags, losses, .. } = read_tags(capture)?;
    let (written, lost) = match to {
        Format::Tum => (tum(&tags, output)?, losses),
        Format::Images => images(capture, &tags, output)?,
    };
    output::losses(&lost);
    let report = Report { output: output.clone(), written, lost };
    if json {
        output::json(&report)?;
    } else {
        output::lines(&format!("{written} written to {}", report.output.display()))?;
    }
    Ok(Outcome::of(&report.lost))
}

fn tum(tags: &[FrameTag], path: &Path) -> anyhow::Result<usize> {
    let failed = |error| cannot_write(path, error);
    if !tags.iter().any(|tag| tag.valid) {
        bail!("nothing was written: none of its {} tags is valid", tags.len());
    }
    check_old(path, is_tum)?;
    let mut file = BufWriter::new(File::create(path).map_err(failed)?);
    let mut written = 0;
    for tag in tags.iter().filter(|tag| tag.valid) {
        let (p, q) = (&tag.pose.pose.position, &tag.pose.pose.orientation);
        let stamp = &tag.header.stamp;
        writeln!(
            file,
            "{}.{:09} {:.6} {:.6} {:.6} {:.9} {:.9} {:.9} {:.9}",
            stamp.sec, stamp.nanosec, p.x, p.y, p.z, q.x, q.y, q.z, q.w
        )
        .map_err(failed)?;
        written += 1;
    }
    file.flush().map_err(failed)?;
    Ok(written)
}

/// Whether a file begins with a line as `tum` writes it.
fn is_tum(old: &[u8]) -> bool {
    let line = String::from_utf8_lossy(old).lines().next().unwrap_or_default().to_owned();
    line.split(' ').filter(|number| number.parse::<f64>().is_ok()).count() == TUM_COLUMNS
}

const TUM_COLUMNS: usize = 8;

/// A row of `tags.csv`, which is also a line of `tags.jsonl`.
#[derive(Serialize)]
struct Row<'a> {
    file: String,
    stamp_ns: i64,
    valid: bool,
    reason: &'a str,
    x: f64,
    y: f64,
    z: f64,
    yaw_deg: f64,
    pitch_deg: f64,
    roll_deg: f64,
    sigma_xy_m: f64,
    sigma_yaw_deg: f64,
    ambiguous: bool,
}

const CSV_HEAD: &str = "file,stamp_ns,valid,reason,x,y,z,yaw_deg,pitch_deg,roll_deg,sigma_xy_m,sigma_yaw_deg,ambiguous";

/// Writes each tagged frame to a file, with `tags.csv` and `tags.jsonl`. Returns the number of frames written, and what was
/// lost.
fn images(capture: &Path, tags: &[FrameTag], folder: &Path) -> anyhow::Result<(usize, Vec<Loss>)> {
    let image_topic = image_topic(capture)?;
    let failed = |error| cannot_write(folder, error);
    make_folder(folder)?;
    // Files of another export would mix with those of this one.
    if fs::read_dir(folder).map_err(failed)?.next().is_some() {
        let what = "is not empty, and an export needs a folder of its own: name another, or remove what is in it first";
        return Err(UsageError(format!("{}: {what}", folder.display())).into());
    }
    let mut csv = BufWriter::new(File::create(folder.join("tags.csv")).map_err(failed)?);
    let mut jsonl = BufWriter::new(File::create(folder.join("tags.jsonl")).map_err(failed)?);
    writeln!(csv, "{CSV_HEAD}").map_err(failed)?;
    // A frame or a tag may be lost, so they are matched by their stamp; those of the same stamp in their order.
    let mut waiting: HashMap<i64, VecDeque<&FrameTag>> = HashMap::new();
    for tag in tags {
        waiting.entry(tag.header.stamp.to_nanoseconds()).or_default().push_back(tag);
    }
    // The tags are read again with the images, so that damage to them is counted, too.
    let selection = Selection::topics([image_topic.as_str(), topics::FRAME_TAG]);
    let mut source = LogSource::with_outputs(log::files_of(capture)?, selection);
    let mut progress = output::Progress::new("exporting");
    let (mut written, mut unreadable, mut first_error) = (0, 0, None);
    let mut poses = String::new();
    for message in source.by_ref() {
        let message = message?;
        if message.channel.topic != image_topic {
            continue;
        }
        let tag = match decode::stamp_ns(&message) {
            Ok(stamp_ns) => waiting.get_mut(&stamp_ns).and_then(VecDeque::pop_front),
            // Replay could not read the stamp either, so this frame has no tag.
            Err(_) => None,
        };
        let Some(tag) = tag else { continue };
        let (ending, bytes) = match file_of(&message) {
            Ok(file) => file,
            Err(error) => {
                unreadable += 1;
                first_error.get_or_insert_with(|| format!("frame {}: {error}", tag.sequence));
                continue;
            }
        };
        let row = row(format!("{:06}.{ending}", tag.sequence), tag);
        let path = folder.join(&row.file);
        fs::write(&path, &bytes).map_err(|error| cannot_write(&path, error))?;
        write_csv(&mut csv, &row).map_err(failed)?;
        if tag.valid && !tag.ambiguous {
            poses.push_str(&pose_line(&row, tag));
        }
        serde_json::to_writer(&mut jsonl, &row).map_err(|error| failed(error.into()))?;
        writeln!(jsonl).map_err(failed)?;
        written += 1;
        progress.set(written as u64, Some(tags.len() as u64));
    }
    progress.finish();
    csv.flush().map_err(failed)?;
    jsonl.flush().map_err(failed)?;
    if !poses.is_empty() {
        write(&folder.join("poses.csv"), &format!("{POSES_HEAD}{SIGMAS_HEAD}\n{poses}"))?;
        write_camera(capture, folder)?;
    }
    let mut lost = losses(capture, source.damage());
    let mut lose = |what: String| Loss::new(capture, what).join(&mut lost);
    if let Some(error) = first_error {
        lose(format!("{unreadable} frames on {image_topic} do not decode ({error})"));
    }
    let without = tags.len() - written - unreadable;
    if without > 0 {
        lose(format!("{without} of {} tags have no image on {image_topic}", tags.len()));
    }
    if written == 0 {
        for name in ["tags.csv", "tags.jsonl"] {
            let _ = fs::remove_file(folder.join(name));
        }
        let all: Vec<String> = lost.iter().map(ToString::to_string).collect();
        bail!("nothing was written: {}", all.join("; "));
    }
    Ok((written, lost))
}

/// A line of `poses.csv`.
fn pose_line(row: &Row, tag: &FrameTag) -> String {
    let Row { file, x, y, z, yaw_deg, pitch_deg, roll_deg, sigma_xy_m, .. } = row;
    let rotation = [21, 28, 35].map(|at| tag.pose.covariance[at]).into_iter().fold(0.0, f64::max);
    let rotation_deg = libm::sqrt(rotation).to_degrees();
    format!("{file},{x:.6},{y:.6},{z:.6},{yaw_deg:.6},{pitch_deg:.6},{roll_deg:.6},{sigma_xy_m:.6},{rotation_deg:.6}\n")
}

/// Writes what else a folder of images needs: the lens, and the body mask if the capture has a single one.
fn write_camera(capture: &Path, folder: &Path) -> anyhow::Result<()> {
    let session = if capture.is_dir() { Some(capture) } else { capture.parent() };
    let Some(info) = session.and_then(|session| read_info(session).ok()) else { return Ok(()) };
    write(&folder.join("camera_info.yaml"), &camera_calibration_yaml(&info.lens))?;
    let (width, height) = (info.lens.width, info.lens.height);
    if let [runs] = &info.body_masks[..]
        && let Some(mask) = BodyMask::from_runs(width as usize, height as usize, runs)
        && let Some(picture) = image::GrayImage::from_raw(width, height, mask.to_gray())
    {
        let path = folder.join("body_mask.png");
        picture.save(&path).with_context(|| path.display().to_string())?;
    }
    Ok(())
}

/// Returns the ending of a frame's file name, and the file's bytes.
fn file_of(message: &LogMessage) -> anyhow::Result<(&'static str, Vec<u8>)> {
    if message.channel.type_name != "sensor_msgs/msg/CompressedImage" {
        return Ok(("png", png(message)?));
    }
    let image = CompressedImageView::decode(&message.data)?;
    let ending = if image.data.starts_with(b"\x89PNG") { "png" } else { "jpg" };
    Ok((ending, image.data.to_vec()))
}

fn write_csv(csv: &mut impl Write, row: &Row) -> std::io::Result<()> {
    let Row { file, stamp_ns, valid, reason, x, y, z, .. } = row;
    let Row { yaw_deg, pitch_deg, roll_deg, sigma_xy_m, sigma_yaw_deg, ambiguous, .. } = row;
    writeln!(
        csv,
        "{file},{stamp_ns},{valid},{reason},{x:.6},{y:.6},{z:.6},{yaw_deg:.6},{pitch_deg:.6},{roll_deg:.6},\
         {sigma_xy_m:.6},{sigma_yaw_deg:.6},{ambiguous}"
    )
}

fn row(file: String, tag: &FrameTag) -> Row<'_> {
    let (p, covariance) = (&tag.pose.pose.position, &tag.pose.covariance);
    Row {
        file,
        stamp_ns: tag.header.stamp.to_nanoseconds(),
        valid: tag.valid,
        reason: &tag.reason,
        x: p.x,
        y: p.y,
        z: p.z,
        yaw_deg: tag.yaw.to_degrees(),
        pitch_deg: tag.pitch.to_degrees(),
        roll_deg: tag.roll.to_degrees(),
        sigma_xy_m: tag.pose.sigma_xy_m(),
        sigma_yaw_deg: libm::sqrt(covariance[35]).to_degrees(),
        ambiguous: tag.ambiguous,
    }
}

/// Returns the topic that the session's settings name; without it, the only topic of images.
fn image_topic(capture: &Path) -> anyhow::Result<String> {
    let folder = if capture.is_dir() { Some(capture) } else { capture.parent() };
    let configured = folder.and_then(|folder| read_info(folder).ok());
    let wanted = configured.map(|info| info.settings.topics.image).unwrap_or_default();
    let types = log::topic_types(&log::surveys(&log::files_of(capture)?)?);
    if types.contains_key(&wanted) {
        return Ok(wanted);
    }
    let images: Vec<&String> = types
        .iter()
        .filter(|(_, kinds)| kinds.iter().any(|kind| kind.ends_with("Image")))
        .map(|(topic, _)| topic)
        .collect();
    match images[..] {
        [topic] => Ok(topic.clone()),
        _ => bail!("{}: no single topic of images; there are: {images:?}", capture.display()),
    }
}

fn png(message: &LogMessage) -> anyhow::Result<Vec<u8>> {
    let picture = decode::picture(message)?;
    let rgb = picture.to_rgb();
    let mut bytes = Vec::new();
    let encoder = image::codecs::png::PngEncoder::new(&mut bytes);
    image::ImageEncoder::write_image(
        encoder,
        &rgb,
        picture.width as u32,
        picture.height as u32,
        image::ExtendedColorType::Rgb8,
    )?;
    Ok(bytes)
}
