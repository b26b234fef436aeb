//! The tags of a capture as arrays, with every digit that they have.

use super::frame::read;
use super::scan::{Capture, FrameEntry};
use crate::HttpProblem;
use crate::arrays::{Values, npy, npz};
use hyper::StatusCode;
use realitysim_ros2::messages::{FrameTag, Message};

/// Number of entries of a covariance of position and orientation, 6 x 6.
const COVARIANCE: usize = 36;

/// Returns one row for each tagged frame, as `.npz`; the document of the service says which arrays it has. A tag that cannot be read any
/// more has NaN for its pose.
pub(super) fn tag_arrays(capture: &Capture) -> Result<Vec<u8>, HttpProblem> {
    let count = capture.frames.len();
    let (mut position, mut orientation) = (Vec::with_capacity(3 * count), Vec::with_capacity(4 * count));
    let mut covariance = Vec::with_capacity(COVARIANCE * count);
    for frame in &capture.frames {
        let tag = tag_of(capture, frame);
        let pose = tag.as_ref().map(|tag| &tag.pose.pose);
        position.extend(pose.map_or([f64::NAN; 3], |pose| [pose.position.x, pose.position.y, pose.position.z]));
        let turn = pose.map(|pose| &pose.orientation);
        orientation.extend(turn.map_or([f64::NAN; 4], |turn| [turn.x, turn.y, turn.z, turn.w]));
        covariance.extend(tag.as_ref().map_or([f64::NAN; COVARIANCE], |tag| tag.pose.covariance));
    }
    let whole = |of: fn(&FrameEntry) -> i64| capture.frames.iter().map(of).collect::<Vec<i64>>();
    let flag =
        |of: fn(&FrameEntry) -> bool| capture.frames.iter().map(|frame| u8::from(of(frame))).collect::<Vec<u8>>();
    let arrays = [
        ("stamp_ns", npy(&[count], Values::I64(&whole(|frame| frame.stamp_ns)))),
        ("valid", npy(&[count], Values::U8(&flag(|frame| frame.valid)))),
        ("ambiguous", npy(&[count], Values::U8(&flag(|frame| frame.ambiguous)))),
        ("reason", npy(&[count], Values::I64(&whole(|frame| i64::from(frame.reason))))),
        ("has_image", npy(&[count], Values::U8(&flag(|frame| frame.image.is_some())))),
        ("position", npy(&[count, 3], Values::F64(&position))),
        ("orientation", npy(&[count, 4], Values::F64(&orientation))),
        ("covariance", npy(&[count, 6, 6], Values::F64(&covariance))),
    ];
    npz(&arrays).map_err(|error| HttpProblem::new(StatusCode::INTERNAL_SERVER_ERROR, error.to_string()))
}

fn tag_of(capture: &Capture, frame: &FrameEntry) -> Option<FrameTag> {
    FrameTag::decode(&read(capture, frame.tag?).ok()?).ok()
}
