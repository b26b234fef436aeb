//! One frame of a capture: its picture, its tag, and what speaks for and against it.

use std::io::{Read, Seek, SeekFrom};
use std::sync::Arc;

use hyper::StatusCode;
use jpeg_encoder::ColorType;
use serde_json::{Value, json};

use super::scan::{Capture, FrameEntry, Place};
use crate::HttpProblem;
use realitysim_config::plain_file;
use realitysim_evaluation::drawing::projected_lines;
use realitysim_geometry::Isometry;
use realitysim_localization::refinement::line_measurement::Finding;
use realitysim_log_input::{decode, encode};
use realitysim_ros2::mcap_read::{Channel, LogMessage};
use realitysim_ros2::messages::{CompressedImage, CompressedImageView, FrameTag, Image, Message};
use realitysim_tagging::explanation::{ExplainOptions, Sight, explain};
use realitysim_vision::Picture;

/// Quality of a raw frame as JPEG, 1 to 100.
const QUALITY: u8 = 92;

/// Returns the frame's picture as it was recorded; a raw one becomes a JPEG.
pub(super) fn picture(capture: &Capture, frame: u32) -> Result<(Vec<u8>, &'static str), HttpProblem> {
    let place = image_place(capture, frame)?;
    let data = read(capture, place)?;
    if !place.is_compressed {
        let picture = decoded(data, place)?;
        let jpeg = encode::jpeg(&picture.to_rgb(), picture.width, picture.height, ColorType::Rgb, QUALITY);
        return Ok((jpeg.map_err(|_| changed())?, "image/jpeg"));
    }
    let image = CompressedImageView::decode(&data).map_err(|_| changed())?.data;
    let media_type = if image.starts_with(b"\x89PNG") { "image/png" } else { "image/jpeg" };
    Ok((image.to_vec(), media_type))
}

/// Returns the frame's pixels, R G B row by row, with its width and height.
pub(super) fn pixels(capture: &Capture, frame: u32) -> Result<(Vec<u8>, [usize; 2]), HttpProblem> {
    let place = image_place(capture, frame)?;
    let picture = decoded(read(capture, place)?, place)?;
    Ok((picture.to_rgb(), [picture.width, picture.height]))
}

/// Returns the frame's tag as JSON, with the lines of the field's paint where it puts them, in pixels from the corner of the image.
pub(super) fn tag(capture: &Capture, frame: u32) -> Result<Value, HttpProblem> {
    let place = entry(capture, frame)?.tag.ok_or_else(|| gone("the tag of this frame is compressed twice"))?;
    let tag = FrameTag::decode(&read(capture, place)?).map_err(|_| changed())?;
    let lines = projected_lines(&capture.lens, &Isometry::from(tag.pose.pose), &capture.field);
    let lines: Vec<Vec<[f64; 2]>> =
        lines.iter().map(|line| line.iter().map(|point| [tenth(point.x), tenth(point.y)]).collect()).collect();
    Ok(json!({ "tag": tag, "lines": lines }))
}

/// Returns the evidence for and against the frame's tag. The frames before it in its segment are tagged anew for that.
pub(super) fn explanation(capture: &Capture, frame: u32) -> Result<Value, HttpProblem> {
    let place = entry(capture, frame)?.image.ok_or_else(|| gone("the capture has no image of this frame"))?;
    let in_file = |entry: &&FrameEntry| entry.image.is_some_and(|image| image.file == place.file);
    let before = capture.frames[..frame as usize].iter().filter(in_file).count() as u64;
    let source = capture.files.get(place.file as usize).ok_or_else(changed)?.clone();
    let options = ExplainOptions { source, settings: capture.info.settings.clone(), initial: None, frame: before };
    let explained = explain(&options, &mut |_, _| {})
        .map_err(|_| gone("the segment of this frame cannot be tagged anew: `realitysim explain` says why"))?;
    let Some(Sight { evidence, .. }) = &explained.sight else {
        return Ok(json!({ "seen": false, "reason": explained.tag.reason }));
    };
    let point = |at: glam::DVec2| [tenth(at.x + 0.5), tenth(at.y + 0.5)];
    let of = |wanted: fn(&Finding) -> bool| {
        let found = evidence.lines.iter().filter(move |line| wanted(&line.finding));
        found
            .map(|line| if let Finding::Found(at) = line.finding { point(at) } else { point(line.pixel) })
            .collect::<Vec<_>>()
    };
    let shown = |on_line: bool| {
        evidence.shown.iter().filter(|(_, is)| *is == on_line).map(|(at, _)| point(*at)).collect::<Vec<_>>()
    };
    Ok(json!({
        "seen": true,
        "found": of(|finding| matches!(finding, Finding::Found(_))),
        "missing": of(|finding| matches!(finding, Finding::Missing)),
        "hidden": of(|finding| matches!(finding, Finding::Hidden)),
        "on_line": shown(true),
        "off_line": shown(false),
        "carpet": evidence.carpet.iter().map(|at| point(*at)).collect::<Vec<_>>(),
        "fitting": evidence.agreement.fitting,
        "expected": evidence.agreement.expected,
        "digits": tenth(evidence.agreement.digits),
        "explained_in_view": evidence.explained_in_view,
        "tried": evidence.tried,
    }))
}

fn image_place(capture: &Capture, frame: u32) -> Result<Place, HttpProblem> {
    let none = "the capture has no image of this frame: it was thinned or lost, or is compressed twice";
    entry(capture, frame)?.image.ok_or_else(|| gone(none))
}

pub(super) fn entry(capture: &Capture, frame: u32) -> Result<&FrameEntry, HttpProblem> {
    let count = capture.frames.len();
    capture.frames.get(frame as usize).ok_or_else(|| match count {
        0 => gone("the capture has no tagged frame"),
        _ => gone(&format!("there is no frame {frame}: they are 0 to {}", count - 1)),
    })
}

/// Reads the bytes of a message out of its segment.
pub(super) fn read(capture: &Capture, place: Place) -> Result<Vec<u8>, HttpProblem> {
    let path = capture.files.get(place.file as usize).ok_or_else(changed)?;
    let mut data = vec![0; place.length as usize];
    let mut file = plain_file::open(path).map_err(|_| changed())?;
    file.seek(SeekFrom::Start(place.offset)).and_then(|_| file.read_exact(&mut data)).map_err(|_| changed())?;
    Ok(data)
}

fn decoded(data: Vec<u8>, place: Place) -> Result<Picture, HttpProblem> {
    let channel = match place.is_compressed {
        true => Channel::of::<CompressedImage>(0, "image", Default::default()),
        false => Channel::of::<Image>(0, "image", Default::default()),
    };
    let message = LogMessage { channel: Arc::new(channel), sequence: 0, log_time_ns: 0, publish_time_ns: 0, data };
    decode::picture(&message).map_err(|_| gone("the image of this frame does not decode"))
}

pub(super) fn gone(what: &str) -> HttpProblem {
    HttpProblem::new(StatusCode::NOT_FOUND, what)
}

/// Refusal because a segment vanished or changed since it was read.
fn changed() -> HttpProblem {
    gone("the capture has changed since it was read: load it again")
}

/// Rounds to a tenth of a pixel. A number that is not finite becomes 0, since JSON has none.
fn tenth(value: f64) -> f64 {
    if value.is_finite() { libm::round(10.0 * value) / 10.0 } else { 0.0 }
}
