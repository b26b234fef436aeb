//! What a capture tells of the robot at each of its frames, beside the tags: where the camera is on it, odometry, how it leans.

use std::path::Path;

use super::error::ReplayError;
use super::open_input::{self, OpenLog};
use realitysim_config::Settings;
use realitysim_geometry::{Isometry, Pose2};
use realitysim_recording::Loss;

/// The robot at the exposure of one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackedFrame {
    /// Time of the exposure, nanoseconds.
    pub stamp_ns: i64,
    /// Pose of `camera_link` in `base_footprint`, if the transforms give it.
    pub footprint_from_link: Option<Isometry>,
    /// Pose of `base_footprint` in `odom`, if there is odometry.
    pub odometry: Option<Pose2>,
    /// Angle between the torso's axis and the vertical, radians, if it is measured.
    pub lean_rad: Option<f64>,
}

/// The robot at all frames of a capture, in order of time, and what of the capture could not be read.
///
/// `settings` are those of the capture; `progress` gets the numbers of frames read and of all frames.
///
/// # Errors
///
/// [`ReplayError`] if the capture cannot be read as a log.
pub fn robot_track(
    capture: &Path,
    settings: &Settings,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<(Vec<TrackedFrame>, Vec<Loss>), ReplayError> {
    let OpenLog { setup, mut messages, checkpoint, frames: count, lost: mut losses, .. } =
        open_input::log(capture, settings)?;
    let mut assembler = setup.assembler(checkpoint.map(|checkpoint| checkpoint.synchroniser), false);
    let mut track = Vec::new();
    for frame in assembler.frames_of(messages.by_ref()) {
        let frame = frame?;
        let place = frame.robot.place.as_ref().ok();
        track.push(TrackedFrame {
            stamp_ns: frame.stamp_ns,
            footprint_from_link: place.map(|place| place.footprint_from_link),
            odometry: frame.robot.odometry,
            lean_rad: place.and_then(|place| place.lean_rad),
        });
        progress(track.len() as u64, count);
    }
    track.sort_by_key(|frame| frame.stamp_ns);
    messages.damage().iter().for_each(|(file, damage)| Loss::of_damage(file, damage).join(&mut losses));
    Ok((track, losses))
}
