//! Every frame as a picture with its tag: lines, place, ellipse and reason.

use std::path::Path;

use anyhow::Context;
use image::RgbImage;
use jpeg_encoder::ColorType;

use super::super::explain;
use super::super::paths::cannot_write;
use super::frames::{each_drawn_frame, own_folder};
use crate::evaluation::drawing::{FrameSheet, ShownTag};
use crate::geometry::{Field, Isometry, Lens};
use crate::log_input::{decode, encode};
use crate::recording::{Loss, SessionInfo, read_info};
use crate::ros2::mcap_read::LogMessage;
use crate::ros2::messages::FrameTag;

/// Quality of the pictures, 1 to 100: edges of a pixel stay sharp.
const QUALITY: u8 = 92;

/// Writes a picture per frame. Returns their number, and what was lost.
pub(super) fn overlays(capture: &Path, tags: &[FrameTag], folder: &Path) -> anyhow::Result<(usize, Vec<Loss>)> {
    let sheets = TagSheets::new(capture, tags)?;
    own_folder(folder)?;
    each_drawn_frame(
        capture,
        tags,
        |tag, message| sheets.draw(tag, message),
        |tag, picture| {
            let path = folder.join(format!("{:06}.jpg", tag.sequence));
            std::fs::write(&path, picture).map_err(|error| cannot_write(&path, error))
        },
    )
}

/// Returns a picture as a JPEG.
fn jpeg(picture: &RgbImage) -> anyhow::Result<Vec<u8>> {
    let (width, height) = picture.dimensions();
    Ok(encode::jpeg(picture, width as usize, height as usize, ColorType::Rgb, QUALITY)?)
}

/// Returns what is known of the session that a capture or one of its segments belongs to.
pub(super) fn session_info(capture: &Path) -> anyhow::Result<SessionInfo> {
    let folder = if capture.is_dir() { capture } else { capture.parent().unwrap_or(Path::new(".")) };
    Ok(read_info(folder)?)
}

/// Draws the frames of a capture with their tags.
pub(super) struct TagSheets {
    sheet: FrameSheet,
    first_ns: i64,
}

impl TagSheets {
    pub(super) fn new(capture: &Path, tags: &[FrameTag]) -> anyhow::Result<Self> {
        let info = session_info(capture)?;
        let sheet = FrameSheet::new(Lens::new(info.lens)?, Field::new(info.field)?);
        let first_ns = tags.first().map_or(0, |tag| tag.header.stamp.to_nanoseconds());
        Ok(Self { sheet, first_ns })
    }

    /// Draws a frame with its tag, as a JPEG. A picture that does not decode is an error.
    pub(super) fn draw(&self, tag: &FrameTag, message: &LogMessage) -> anyhow::Result<Vec<u8>> {
        let picture = decode::picture(message)?;
        let (width, height) = (picture.width as u32, picture.height as u32);
        let image = RgbImage::from_raw(width, height, picture.to_rgb()).context("its pixels do not fit its size")?;
        jpeg(&self.sheet.draw(&image, &self.shown(tag)))
    }

    fn shown(&self, tag: &FrameTag) -> ShownTag {
        let covariance = &tag.pose.covariance;
        let mirror = Isometry::from(tag.mirror_pose).translation.truncate();
        ShownTag {
            map_from_camera: Isometry::from(tag.pose.pose),
            covariance: [covariance[0], covariance[1], covariance[7]],
            valid: tag.valid,
            mirror: tag.ambiguous.then_some(mirror),
            words: self.words(tag),
        }
    }

    fn words(&self, tag: &FrameTag) -> Vec<String> {
        let elapsed_s = 1e-9 * (tag.header.stamp.to_nanoseconds() - self.first_ns) as f64;
        let verdict = if tag.valid { "valid".to_owned() } else { format!("INVALID: {}", tag.reason) };
        let FrameTag { sequence, lines_fitting, lines_expected, lines_rms_px, lines_explained, yaw, .. } = tag;
        let (at, sigma_cm) = (&tag.pose.pose.position, 100.0 * tag.pose.sigma_xy_m());
        let mut words = vec![
            format!("frame {sequence}, {elapsed_s:.2} s: {verdict}"),
            format!(
                "x {:.3}, y {:.3}, z {:.3} m, yaw {:.1} deg; sigma {sigma_cm:.2} cm, {:.2} deg",
                at.x,
                at.y,
                at.z,
                yaw.to_degrees(),
                libm::sqrt(tag.pose.covariance[35]).to_degrees()
            ),
            format!(
                "{lines_fitting} of {lines_expected} line places fit, {lines_rms_px:.2} px off; {:.0} % of the line seen is \
                 explained",
                100.0 * lines_explained
            ),
        ];
        if tag.ambiguous {
            words.push("which half of the field is not known: the gray circle is the mirror pose".to_owned());
        }
        if !tag.valid {
            words.push(explain::advice(&tag.reason, None).to_owned());
        }
        words
    }
}
