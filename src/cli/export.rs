//! `realitysim export`

use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::{Args, ValueEnum};
use serde::Serialize;

use super::{Outcome, output};
use crate::evaluation::capture::read_tags;
use crate::recording::SessionInfo;
use crate::ros2::mcap_read::Selection;
use crate::ros2::messages::{CompressedImageView, FrameTag, ImageView};
use crate::sensors::decode;
use crate::sensors::log::{self, LogSource};

/// Write a capture's tags or frames in a form that other programs read
///
/// tum: a text file, `stamp tx ty tz qx qy qz qw` of camera_link in map, valid tags only (evo reads it).
/// images: a folder with one file per frame, tags.csv and tags.jsonl; JPEG and PNG are copied byte for byte, raw
/// frames become PNG.
#[derive(Args)]
pub struct ExportArguments {
    /// A capture's folder, or one of its segments
    capture: PathBuf,
    /// What to write
    #[arg(long)]
    to: Format,
    /// File (tum) or folder (images) to write
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
}

pub fn run(arguments: &ExportArguments, json: bool) -> anyhow::Result<Outcome> {
    let tags = read_tags(&arguments.capture)?;
    let written = match arguments.to {
        Format::Tum => tum(&tags, &arguments.output)?,
        Format::Images => images(&arguments.capture, &tags, &arguments.output)?,
    };
    let report = Report { output: arguments.output.clone(), written };
    if json {
        output::json(&report)?;
    } else {
        output::lines(&format!("{written} written to {}", report.output.display()))?;
    }
    Ok(Outcome::Whole)
}

fn tum(tags: &[FrameTag], path: &Path) -> anyhow::Result<usize> {
    let shown = || path.display().to_string();
    let mut file = BufWriter::new(File::create(path).with_context(shown)?);
    let mut written = 0;
    for tag in tags.iter().filter(|tag| tag.valid) {
        let (p, q) = (&tag.pose.pose.position, &tag.pose.pose.orientation);
        let stamp = &tag.header.stamp;
        writeln!(
            file,
            "{}.{:09} {:.6} {:.6} {:.6} {:.9} {:.9} {:.9} {:.9}",
            stamp.sec, stamp.nanosec, p.x, p.y, p.z, q.x, q.y, q.z, q.w
        )
        .with_context(shown)?;
        written += 1;
    }
    file.flush().with_context(shown)?;
    Ok(written)
}

/// A row of `tags.csv` and a line of `tags.jsonl`.
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

fn images(capture: &Path, tags: &[FrameTag], folder: &Path) -> anyhow::Result<usize> {
    let shown = || folder.display().to_string();
    fs::create_dir_all(folder).with_context(shown)?;
    let mut csv = BufWriter::new(File::create(folder.join("tags.csv")).with_context(shown)?);
    let mut jsonl = BufWriter::new(File::create(folder.join("tags.jsonl")).with_context(shown)?);
    writeln!(csv, "{CSV_HEAD}").with_context(shown)?;
    let topic = image_topic(capture)?;
    let source = LogSource::new(log::files_of(capture)?, Selection::topics([topic.as_str()]));
    let mut progress = output::Progress::new("exporting");
    let mut written = 0;
    let mut left = tags.iter().peekable();
    for message in source {
        let message = message?;
        let (stamp_ns, ending, bytes) = match message.channel.type_name.as_str() {
            "sensor_msgs/msg/CompressedImage" => {
                let image = CompressedImageView::decode(&message.data)?;
                let ending = if image.data.starts_with(b"\x89PNG") { "png" } else { "jpg" };
                (image.header.stamp.to_nanoseconds(), ending, image.data.to_vec())
            }
            _ => (ImageView::decode(&message.data)?.header.stamp.to_nanoseconds(), "png", png(&message)?),
        };
        // Tags stand in the order of the frames; a frame without one was written while the agent was stopped.
        let Some(tag) = left.next_if(|tag| tag.header.stamp.to_nanoseconds() == stamp_ns) else { continue };
        let row = row(format!("{:06}.{ending}", tag.sequence), stamp_ns, tag);
        let path = folder.join(&row.file);
        fs::write(&path, &bytes).with_context(|| path.display().to_string())?;
        let Row {
            file,
            valid,
            reason,
            x,
            y,
            z,
            yaw_deg,
            pitch_deg,
            roll_deg,
            sigma_xy_m,
            sigma_yaw_deg,
            ambiguous,
            ..
        } = &row;
        writeln!(
            csv,
            "{file},{stamp_ns},{valid},{reason},{x:.6},{y:.6},{z:.6},{yaw_deg:.6},{pitch_deg:.6},{roll_deg:.6},\
             {sigma_xy_m:.6},{sigma_yaw_deg:.6},{ambiguous}"
        )
        .with_context(shown)?;
        serde_json::to_writer(&mut jsonl, &row)?;
        writeln!(jsonl).with_context(shown)?;
        written += 1;
        progress.set(written as u64, Some(tags.len() as u64));
    }
    progress.finish();
    csv.flush().with_context(shown)?;
    jsonl.flush().with_context(shown)?;
    if written < tags.len() {
        bail!("{}: only {written} of {} tags have their image on {topic}", capture.display(), tags.len());
    }
    Ok(written)
}

fn row(file: String, stamp_ns: i64, tag: &FrameTag) -> Row<'_> {
    let (p, covariance) = (&tag.pose.pose.position, &tag.pose.covariance);
    Row {
        file,
        stamp_ns,
        valid: tag.valid,
        reason: &tag.reason,
        x: p.x,
        y: p.y,
        z: p.z,
        yaw_deg: tag.yaw.to_degrees(),
        pitch_deg: tag.pitch.to_degrees(),
        roll_deg: tag.roll.to_degrees(),
        sigma_xy_m: libm::sqrt(covariance[0].max(covariance[7])),
        sigma_yaw_deg: libm::sqrt(covariance[35]).to_degrees(),
        ambiguous: tag.ambiguous,
    }
}

/// The session's own word for it, else the default.
fn image_topic(capture: &Path) -> anyhow::Result<String> {
    let folder = if capture.is_dir() { Some(capture) } else { capture.parent() };
    let session = folder.and_then(|folder| fs::read(folder.join("session.json")).ok());
    let configured = session.and_then(|bytes| serde_json::from_slice::<SessionInfo>(&bytes).ok());
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

fn png(message: &crate::ros2::mcap_read::LogMessage) -> anyhow::Result<Vec<u8>> {
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
