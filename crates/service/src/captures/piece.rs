//! A piece of a capture around a frame, as a log of its own that replays to the same tags.

use hyper::StatusCode;

use super::frame::{entry, gone};
use super::scan::Capture;
use crate::HttpProblem;
use realitysim_config::plain_file;
use realitysim_tagging::cut::{CutError, CutOptions, cut};

/// Longest piece that is cut, seconds. [`realitysim_tagging::cut`] has no such limit.
pub(in super::super) const MAX_PIECE_S: u32 = 60;
/// Largest images of a piece, bytes: an answer is held in memory until it is taken.
const MAX_PIECE_BYTES: u64 = 64 << 20;

/// Cuts `seconds` out of a capture, in the middle of which a frame lies.
pub(super) fn piece(capture: &Capture, frame: u32, seconds: u32) -> Result<Vec<u8>, HttpProblem> {
    let middle_s = capture.seconds_from_start(entry(capture, frame)?);
    let half_s = 0.5 * f64::from(seconds);
    let (from_s, to_s) = ((middle_s - half_s).max(0.0), middle_s + half_s);
    let is_within = |at_s: f64| from_s <= at_s && at_s <= to_s;
    let within = capture.frames.iter().filter(|frame| is_within(capture.seconds_from_start(frame)));
    let bytes: u64 = within.filter_map(|frame| frame.image).map(|image| u64::from(image.length)).sum();
    if bytes > MAX_PIECE_BYTES {
        return Err(too_large(bytes));
    }
    let temporary = tempfile::tempdir().map_err(|error| failed(error.to_string()))?;
    let output = temporary.path().join("piece.mcap");
    let options = CutOptions {
        source: capture.folder.clone(),
        output: output.clone(),
        temporary: temporary.path().to_owned(),
        settings: capture.info.settings.clone(),
        from_s,
        to_s,
        jpeg_quality: None,
        threads: 1,
    };
    cut(&options, &mut |_, _| {}).map_err(|error| match error {
        CutError::Nothing { .. } => gone("there is no frame with an image around this one"),
        _ => gone("no piece can be cut here: `realitysim log cut` says why"),
    })?;
    plain_file::read(&output, 2 * MAX_PIECE_BYTES).map_err(|error| failed(error.to_string()))
}

fn too_large(bytes: u64) -> HttpProblem {
    let what = format!(
        "the images of this piece have {} MB, and {} MB are sent: ask for fewer seconds, or use `realitysim log cut`",
        bytes >> 20,
        MAX_PIECE_BYTES >> 20
    );
    HttpProblem::new(StatusCode::PAYLOAD_TOO_LARGE, what)
}

fn failed(what: String) -> HttpProblem {
    HttpProblem::new(StatusCode::INTERNAL_SERVER_ERROR, format!("no piece was cut: {what}"))
}
