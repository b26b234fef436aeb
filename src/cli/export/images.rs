//! Frames as files, with tables of their tags and what a database needs to read them.

use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::Path;

use anyhow::Context;
use serde::Serialize;

use super::super::paths::{cannot_write, write};
use super::frames::{each_frame, own_folder};
use crate::config::camera_calibration_yaml;
use crate::database::{FIELD_FILE, POSES_HEAD, SIGMAS_HEAD};
use crate::log_input::decode;
use crate::recording::{Loss, read_info};
use crate::ros2::mcap_read::LogMessage;
use crate::ros2::messages::{CompressedImageView, FrameTag};
use crate::vision::BodyMask;

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
pub(super) fn images(capture: &Path, tags: &[FrameTag], folder: &Path) -> anyhow::Result<(usize, Vec<Loss>)> {
    own_folder(folder)?;
    let written = write_frames(capture, tags, folder);
    if written.is_err() {
        for name in ["tags.csv", "tags.jsonl"] {
            let _ = fs::remove_file(folder.join(name));
        }
    }
    let (written, lost, poses) = written?;
    if !poses.is_empty() {
        write(&folder.join("poses.csv"), &format!("{POSES_HEAD}{SIGMAS_HEAD}\n{poses}"))?;
        write_camera(capture, folder)?;
    }
    Ok((written, lost))
}

/// Writes the frames and both tables. Returns the lines of `poses.csv` as well.
fn write_frames(capture: &Path, tags: &[FrameTag], folder: &Path) -> anyhow::Result<(usize, Vec<Loss>, String)> {
    let failed = |error| cannot_write(folder, error);
    let mut csv = BufWriter::new(File::create(folder.join("tags.csv")).map_err(failed)?);
    let mut jsonl = BufWriter::new(File::create(folder.join("tags.jsonl")).map_err(failed)?);
    writeln!(csv, "{CSV_HEAD}").map_err(failed)?;
    let mut poses = String::new();
    let (written, lost) = each_frame(capture, tags, &mut |tag, message| {
        let (ending, bytes) = match file_of(message) {
            Ok(file) => file,
            Err(error) => return Ok(Err(error.to_string())),
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
        Ok(Ok(()))
    })?;
    csv.flush().map_err(failed)?;
    jsonl.flush().map_err(failed)?;
    Ok((written, lost, poses))
}

/// A line of `poses.csv`.
fn pose_line(row: &Row, tag: &FrameTag) -> String {
    let Row { file, x, y, z, yaw_deg, pitch_deg, roll_deg, sigma_xy_m, .. } = row;
    let rotation = [21, 28, 35].map(|at| tag.pose.covariance[at]).into_iter().fold(0.0, f64::max);
    let rotation_deg = libm::sqrt(rotation).to_degrees();
    format!("{file},{x:.6},{y:.6},{z:.6},{yaw_deg:.6},{pitch_deg:.6},{roll_deg:.6},{sigma_xy_m:.6},{rotation_deg:.6}\n")
}

/// Writes what else a folder of images needs: lens and field, and the body mask if the capture has a single one.
fn write_camera(capture: &Path, folder: &Path) -> anyhow::Result<()> {
    let session = if capture.is_dir() { Some(capture) } else { capture.parent() };
    let Some(info) = session.and_then(|session| read_info(session).ok()) else { return Ok(()) };
    write(&folder.join("camera_info.yaml"), &camera_calibration_yaml(&info.lens))?;
    let field = toml::to_string(&info.field).with_context(|| folder.display().to_string())?;
    write(&folder.join(FIELD_FILE), &field)?;
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
