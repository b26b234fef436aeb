//! Refines the tags of a whole capture from all its frames together.
//!
//! The capture is read, [`realitysim_localization::smoothing`] fits all poses and the constants of lens and mount at once, and
//! the result is written beside the recorded tags, which stay as they are.

use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};

use nalgebra::{Matrix6, Vector6};
use thiserror::Error;

use super::error::ReplayError;
use super::open_input::{self, OpenLog};
use super::perception_pool::decode_picture;
use super::tag_log::{TagLogError, write_tag_log};
use realitysim_geometry::field::SizeDerivative;
use realitysim_geometry::{Field, FieldDimensions, FieldError, Isometry, Lens, LensError, LensParameters, Projector};
use realitysim_localization::refinement::LinePoints;
use realitysim_localization::refinement::line_measurement::{CameraModel, LineMeasurement, measure};
use realitysim_localization::refinement::miscalibration::Miscalibration;
use realitysim_localization::smoothing::alignment::{Look, matches};
use realitysim_localization::smoothing::{
    Constants, Frame, Model, NAMES, Overlap, Place, Smoothed, held_out_rms_px, smooth,
};
use realitysim_log_input::synchroniser::Frame as SensorFrame;
use realitysim_recording::{
    Loss, REFINED_FOLDER, REFINED_INFO, REFINED_TAGS, Readout, ReadoutError, RecordingError, RefinedConstant,
    RefinedInfo, SESSION_FILE, SessionInfo, captures_within, read_info, read_tags, write_atomically,
};
use realitysim_ros2::messages::{FrameTag, Pose};
use realitysim_vision::{Observations, Picture};

/// A capture with its refined tags.
pub struct OfflineRefinement {
    /// The capture's `session.json`.
    pub info: SessionInfo,
    /// The recorded tags.
    pub tags: Vec<FrameTag>,
    /// The same tags, with refined poses where that was possible.
    pub refined: Vec<FrameTag>,
    /// The fit of all frames.
    pub smoothed: Smoothed,
    /// See [`RefinedInfo::held_out_px`].
    pub held_out_px: [f64; 2],
    /// The lens with the fitted constants.
    pub lens: LensParameters,
    /// Stamps of the frames that took part, nanoseconds.
    pub stamps_ns: Vec<i64>,
    /// Parts of the capture that could not be read.
    pub losses: Vec<Loss>,
}

/// Why a capture cannot be refined.
#[derive(Debug, Error)]
pub enum RefineError {
    /// The folder has no `session.json`.
    #[error("{}: a capture's folder is needed, and there is no session.json{}", .0.display(), captures_within(.0))]
    NotACapture(PathBuf),
    /// No frame with a valid tag shows lines.
    #[error("{}: it has no valid tag with lines: nothing can be refined", .0.display())]
    NoFrames(PathBuf),
    /// The capture cannot be read, or the result cannot be written.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The tags cannot be read.
    #[error(transparent)]
    Tags(#[from] ReadoutError),
    /// The capture's messages cannot be replayed.
    #[error(transparent)]
    Replay(#[from] ReplayError),
    /// The fitted constants make no possible lens.
    #[error("the lens: {0}")]
    Lens(#[from] LensError),
    /// The fitted size is that of no field.
    #[error("the field: {0}")]
    Field(#[from] FieldError),
    /// A file of the result cannot be written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What went wrong.
        source: std::io::Error,
    },
    /// The log of refined tags cannot be written.
    #[error(transparent)]
    Write(#[from] TagLogError),
}

/// Number of passes: lines are measured around the recorded tags first, then around the refined poses.
const PASSES: usize = 2;
/// Standard deviations of position (metres) and rotation (radians) with which lines are searched, for each pass.
const REACH: [(f64, f64); PASSES] = [(0.02, 0.008), (0.006, 0.003)];
/// Most line places of one frame. A field has two thousand at most, and those a few pixels apart tell the same.
const MAX_PLACES: usize = 400;
/// Most frames of one capture: an hour at 30 Hz, with all their places 3 GB.
const MAX_FRAMES: usize = 108_000;
/// A constant counts as observed if its standard deviation is below this share of the prior's.
const OBSERVED: f64 = 0.5;
/// Systematic error of all lines together, pixels, whatever their number: paint, light, a lens that is no polynomial. No
/// constant is known better than what moves lines by this much.
const SYSTEMATIC_PX: f64 = 0.08;

/// Refines the tags of a capture. `progress` gets the number of frames looked at and the number of all frames, both over
/// all passes.
pub fn refine(
    capture: &Path,
    model: &Model,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<OfflineRefinement, RefineError> {
    let FittedWalk { info, tags, frames, smoothed, losses } = fit(capture, model, &REACH, progress)?;
    let constants = smoothed.constants;
    let optical_from_link = Isometry::link_from_optical().inverse();
    let known: HashMap<i64, (Isometry, Matrix6<f64>)> = (frames.iter())
        .zip(smoothed.map_from_optical.iter().zip(&smoothed.covariances))
        .map(|(frame, (pose, covariance))| (frame.stamp_ns, (*pose * optical_from_link, *covariance)))
        .collect();
    let stamps_ns = frames.iter().map(|frame| frame.stamp_ns).collect();
    let held_out_px = held_out_rms_px(frames, &info.lens, model)?;
    let refined = tags.iter().map(|tag| match known.get(&tag.header.stamp.to_nanoseconds()) {
        Some((pose, covariance)) if tag.valid => retagged(tag, pose, covariance),
        _ => tag.clone(),
    });
    Ok(OfflineRefinement {
        refined: refined.collect(),
        tags,
        lens: constants.lens(&info.lens),
        stamps_ns,
        smoothed,
        held_out_px,
        info,
        losses,
    })
}

/// A capture's frames with their lines, and the poses and constants that fit them best.
pub struct FittedWalk {
    /// The capture's `session.json`.
    pub info: SessionInfo,
    /// The recorded tags.
    pub tags: Vec<FrameTag>,
    /// Frames with a valid tag, in order of time.
    pub frames: Vec<Frame>,
    /// The fit of all frames.
    pub smoothed: Smoothed,
    /// Parts of the capture that could not be read.
    pub losses: Vec<Loss>,
}

/// Fits a capture as [`refine`] does, for those who judge the fit. `progress` is that of [`refine`].
///
/// # Errors
///
/// Those of [`refine`].
pub fn fitted_walk(
    capture: &Path,
    model: &Model,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<FittedWalk, RefineError> {
    fit(capture, model, &REACH, progress)
}

/// Fits a capture. Each pass searches lines around the poses of the pass before it, within standard deviations of position
/// (metres) and rotation (radians).
pub(super) fn fit(
    capture: &Path,
    model: &Model,
    reaches: &[(f64, f64)],
    progress: &mut dyn FnMut(u64, u64),
) -> Result<FittedWalk, RefineError> {
    if !capture.join(SESSION_FILE).is_file() {
        return Err(RefineError::NotACapture(capture.to_owned()));
    }
    let info = read_info(capture)?;
    let Readout { found: tags, mut losses, .. } = read_tags(capture)?;
    let valid = tags.iter().filter(|tag| tag.valid);
    let mut poses: HashMap<i64, Isometry> = valid
        .map(|tag| {
            let map_from_link = Isometry::from(tag.pose.pose);
            (tag.header.stamp.to_nanoseconds(), map_from_link * Isometry::link_from_optical())
        })
        .collect();
    let tagged = poses.clone();
    let mut constants = Constants::default();
    let mut done: Option<(Vec<Frame>, Smoothed)> = None;
    for (pass, reach) in reaches.iter().enumerate() {
        let measured = measure_lines(capture, &info, &constants, &poses, *reach, &mut |frame, frames| {
            progress(pass as u64 * frames + frame, reaches.len() as u64 * frames);
        })?;
        let (mut frames, more) = measured;
        if pass == 0 {
            losses.extend(more.into_iter().filter(|loss| !losses.contains(loss)).collect::<Vec<_>>());
        }
        // Later passes search lines around refined poses, but the pose as tagged stays the recorded one.
        frames.iter_mut().for_each(|frame| frame.map_from_optical = tagged[&frame.stamp_ns]);
        if frames.iter().all(|frame| frame.places.is_empty()) {
            return Err(RefineError::NoFrames(capture.to_owned()));
        }
        let smoothed = smooth(&frames, &info.lens, model)?;
        poses = frames.iter().zip(&smoothed.map_from_optical).map(|(frame, pose)| (frame.stamp_ns, *pose)).collect();
        constants = smoothed.constants;
        done = Some((frames, smoothed));
    }
    let (frames, smoothed) = done.ok_or_else(|| RefineError::NoFrames(capture.to_owned()))?;
    Ok(FittedWalk { info, tags, frames, smoothed, losses })
}

/// All frames with a valid tag, with the lines measured around `poses`, and the losses of the capture.
///
/// `poses` are those of `camera_optical_frame` in `map` by stamp; the last pair are the standard deviations to search with.
fn measure_lines(
    capture: &Path,
    info: &SessionInfo,
    found: &Constants,
    poses: &HashMap<i64, Isometry>,
    (metres, radians): (f64, f64),
    progress: &mut dyn FnMut(u64, u64),
) -> Result<(Vec<Frame>, Vec<Loss>), RefineError> {
    let OpenLog { setup, mut messages, checkpoint, frames: count, lost, .. } =
        open_input::log(capture, &info.settings)?;
    let mut assembler = setup.assembler(checkpoint.map(|checkpoint| checkpoint.synchroniser), false);
    let projector = Projector::new(&Lens::new(found.lens(&info.lens))?);
    let FieldDimensions { length_m, width_m, .. } = *setup.field.dimensions();
    let size_m = [length_m + found.field_m.x, width_m + found.field_m.y];
    let field = Field::new(setup.field.dimensions().clone().of_size(size_m))?;
    let (points, by_size) = (LinePoints::new(&field), SizeDerivative::new(&field));
    let off = Miscalibration { readout_s: found.readout_s, ..Miscalibration::NONE };
    let square = |sigma: f64| sigma * sigma;
    let [m, r] = [metres, radians].map(square);
    let covariance = Matrix6::from_diagonal(&Vector6::new(m, m, m, r, r, r));
    let (mut seen, mut sights, mut frames, mut number): (Observations, Vec<LineMeasurement>, Vec<Frame>, u64) =
        Default::default();
    let mut before: Option<(i64, Isometry, Picture)> = None;
    let mut take = |frame: SensorFrame, frames: &mut Vec<Frame>| {
        number += 1;
        progress(number, count);
        let Some(pose) = poses.get(&frame.stamp_ns).filter(|_| frames.len() < MAX_FRAMES) else { return };
        let (mut places, mut overlap) = (Vec::new(), None);
        let twist = frame.robot.camera_twist.unwrap_or_default();
        if let (Ok(place), Ok(picture)) =
            (&frame.robot.place, decode_picture(&frame.message, setup.perception.vision.lens()))
        {
            let body = setup.perception.body(frame.robot.head);
            setup.perception.vision.look_again(&picture, &place.footprint_from_optical, body, &mut seen);
            let eye = CameraModel { projector: &projector, off: &off, twist: &twist };
            measure(&points, &seen.image, eye, pose, &covariance, &mut sights);
            let every = sights.len().div_ceil(MAX_PLACES).max(1);
            places.extend(sights.iter().step_by(every).filter_map(|sight| {
                let [longer, wider] = by_size.at(sight.point.truncate()).map(|by| by.extend(0.0));
                let place = Place::new(sight, &eye, pose, [longer, wider])?;
                // The fit counts the field's size from what was believed.
                let point = place.point - longer * found.field_m.x - wider * found.field_m.y;
                Some(Place { point, ..place })
            }));
            let here = Look { picture: &picture, map_from_optical: *pose };
            overlap = before.as_ref().map(|(before_ns, before_pose, before_picture)| {
                let earlier = Look { picture: before_picture, map_from_optical: *before_pose };
                let hides = |pixel| body.is_some_and(|body| body.hides(pixel));
                Overlap { before_ns: *before_ns, matches: matches(&projector, &earlier, &here, hides) }
            });
            before = Some((frame.stamp_ns, *pose, picture));
        }
        frames.push(Frame {
            stamp_ns: frame.stamp_ns,
            map_from_optical: *pose,
            footprint_from_optical: frame.robot.place.ok().map(|place| place.footprint_from_optical),
            odometry: frame.robot.odometry,
            turned_rad: frame.robot.turned_rad,
            twist,
            turn_is_measured: frame.robot.turn_is_measured,
            places,
            overlap,
        });
    };
    // Messages that cannot be read were reported when the capture was made.
    for frame in assembler.frames_of(messages.by_ref()) {
        take(frame.map_err(ReplayError::from)?, &mut frames);
    }
    frames.sort_by_key(|frame| frame.stamp_ns);
    frames.dedup_by_key(|frame| frame.stamp_ns);
    let mut losses = lost;
    messages.damage().iter().for_each(|(file, damage)| Loss::of_damage(file, damage).join(&mut losses));
    Ok((frames, losses))
}

/// The tag with a refined pose and its covariance.
fn retagged(tag: &FrameTag, map_from_link: &Isometry, covariance: &Matrix6<f64>) -> FrameTag {
    let euler = map_from_link.euler();
    let mut tag = FrameTag { yaw: euler.yaw, pitch: euler.pitch, roll: euler.roll, refined: true, ..tag.clone() };
    tag.pose.pose = Pose::from(*map_from_link);
    tag.mirror_pose = Pose::from(map_from_link.mirrored());
    for row in 0..6 {
        (0..6).for_each(|column| tag.pose.covariance[6 * row + column] = covariance[(row, column)]);
    }
    tag
}

/// The constants that a fit with the default model found, with their uncertainties. `lens` is that with the fitted constants.
pub fn refined_constants(smoothed: &Smoothed, lens: &LensParameters) -> Vec<RefinedConstant> {
    let Smoothed { constants, believed, known, .. } = smoothed;
    let values = constants.values();
    let height_m = smoothed.map_from_optical.first().map_or(0.0, |pose| pose.translation.z.abs());
    // The change of each constant that moves lines by one pixel. Focal length, k1 and tilts are shares of the focal length,
    // the centre is in pixels; the height counts for ground seen at 45 degrees, the readout time for a camera that turns by
    // one radian per second.
    let a_pixel = 1.0 / lens.fx;
    let systematic = [a_pixel, 1.0, 1.0, a_pixel, a_pixel, a_pixel, height_m * a_pixel, a_pixel];
    let found = systematic.iter().enumerate().map(|(i, systematic)| RefinedConstant {
        name: NAMES[i].0.to_owned(),
        unit: NAMES[i].1.to_owned(),
        value: values[i],
        believed: believed[i],
        known: libm::hypot(known[i], SYSTEMATIC_PX * systematic),
        observable: known[i] < OBSERVED * believed[i],
    });
    found.collect()
}

impl OfflineRefinement {
    /// The lens, the constants with their uncertainties, and the residuals, as they are stored beside the refined tags.
    pub fn info(&self) -> RefinedInfo {
        RefinedInfo {
            lens: self.lens.clone(),
            constants: refined_constants(&self.smoothed, &self.lens),
            frames: self.smoothed.map_from_optical.len(),
            rms_px: self.smoothed.rms_px,
            held_out_px: self.held_out_px,
        }
    }

    /// Writes the refined tags into the capture's folder `refined`, in place of earlier ones, and returns the folder.
    ///
    /// Recorded files are not touched. The tags get their name last, so that a half-written folder is never read.
    pub fn write(&self, capture: &Path) -> Result<PathBuf, RefineError> {
        let folder = capture.join(REFINED_FOLDER);
        let failed = |path: &Path| {
            let path = path.to_owned();
            move |source| RefineError::Io { path, source }
        };
        fs::create_dir_all(&folder).map_err(failed(&folder))?;
        let active = folder.join(format!("{REFINED_TAGS}.active"));
        write_tag_log(&active, &self.refined)?;
        let path = folder.join(REFINED_TAGS);
        let info = serde_json::to_vec_pretty(&self.info()).map_err(|error| failed(&folder)(error.into()))?;
        // The tags of an earlier run are removed first: they must not stand beside the lens of this one.
        match fs::remove_file(&path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(failed(&path)(error)),
            _ => {}
        }
        write_atomically(&folder.join(REFINED_INFO), &info)?;
        fs::rename(&active, &path).map_err(failed(&path))?;
        Ok(folder)
    }
}
