//! Checks whether a robot's lens and mount are still as calibrated, by a short recording in which it looks around.
//!
//! All frames are fitted at once ([`realitysim_localization::smoothing`]), as in a calibration, but the lens is believed to be
//! nearly right and the field to be as stated, so that half a minute is enough.

use std::path::PathBuf;

use thiserror::Error;

use super::calibrated_lens::NEEDED;
use super::error::ReplayError;
use super::offline_refinement::{FittedWalk, RefineError, fit};
use super::replay::{ReplayOptions, replay};
use super::walk_calibration;
use realitysim_localization::smoothing::{CONSTANTS, Constants, Model, NAMES};
use realitysim_recording::{Loss, ReadoutError, RecordingError, SESSION_FILE, SessionInfo, read_info, read_tags};

/// What a recording tells of the calibration that it was tagged with.
pub struct CalibrationCheck {
    /// Description of the capture, with the settings, lens and field that its tags were made with.
    pub info: SessionInfo,
    /// Number of frames that took part.
    pub frames: usize,
    /// Corrections of what the capture was tagged with.
    pub corrections: Constants,
    /// The constants that can change between two matches, in the order of [`NAMES`].
    pub constants: Vec<CheckedConstant>,
    /// Parts of the recording that could not be read.
    pub losses: Vec<Loss>,
}

/// A part of the camera that is checked by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CameraPart {
    /// Tilt of the mount.
    Tilt,
    /// Height above the ground.
    Height,
    /// Focal length and centre of the lens.
    Lens,
    /// Delay of the stamps.
    Clock,
}

/// A constant of lens, mount or clock, compared with its calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CheckedConstant {
    /// What it is a constant of.
    pub part: CameraPart,
    /// Its index in [`NAMES`].
    index: usize,
    /// Deviation from the calibration, in the unit of [`NAMES`].
    pub deviation: f64,
    /// Standard deviation of `deviation`.
    pub sigma: f64,
}

/// What is known of a constant since it was calibrated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Drift {
    /// It is as calibrated, within what moves a line by a pixel or a tag by a centimetre.
    None,
    /// It is not as calibrated.
    Changed,
    /// The recording does not tell: what it shows is too little, or too near to what matters.
    Unknown,
}

/// Why a recording says nothing of the calibration.
#[derive(Debug, Error)]
pub enum CheckError {
    /// The recording cannot be fitted.
    #[error(transparent)]
    Refine(#[from] RefineError),
    /// The recording cannot be tagged.
    #[error(transparent)]
    Replay(#[from] ReplayError),
    /// The capture cannot be read.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The capture's tags cannot be read.
    #[error(transparent)]
    Tags(#[from] ReadoutError),
    /// Too few frames have a valid tag.
    #[error("{}: only {valid} of {frames} frames could be placed, and {} are needed{}", recording.display(), needed(*frames), because(.why))]
    Unplaced {
        /// The recording.
        recording: PathBuf,
        /// Frames with a valid tag.
        valid: u64,
        /// All frames with a tag.
        frames: u64,
        /// What a replay of the recording says about it.
        why: Vec<String>,
    },
}

/// Fewest frames with a valid tag, however short the recording is.
const MIN_VALID: u64 = 20;
/// A constant has changed if it deviates by more than this many standard deviations, and by more than matters.
const CHANGED_SIGMAS: f64 = 3.0;
/// Standard deviations with which lines are searched in each pass, metres and radians, so that a mount that moved by a degree is found.
const REACHES: [(f64, f64); 3] = [(0.06, 0.03), (0.02, 0.008), (0.006, 0.003)];
/// Standard deviations before the fit, in the order of [`NAMES`]: a lens that was touched at most, a mount that was hit, the clock of
/// another driver. The curve of a lens does not change, nor does the readout of a sensor; the field is as stated.
const BELIEVED: [f64; CONSTANTS] = [0.02, 5.0, 5.0, 0.0, 0.06, 0.06, 0.05, 0.0, 0.0, 0.0, 0.0, 0.02, 0.1, 0.0, 0.0];
/// The constants that are checked, by their index in [`NAMES`]. Odometry is fitted as well, since it takes part in the walk, but it depends
/// on gait and carpet.
const CHECKED: [(CameraPart, usize); 7] = [
    (CameraPart::Lens, 0),
    (CameraPart::Lens, 1),
    (CameraPart::Lens, 2),
    (CameraPart::Tilt, 4),
    (CameraPart::Tilt, 5),
    (CameraPart::Height, 6),
    (CameraPart::Clock, 11),
];

/// Checks the calibration by `options.source`, a log or a capture; `options.captures` is a folder for what is made on the way.
///
/// A capture is checked against the settings that it was recorded with, a log against `options.settings`. `progress` gets the frames
/// done and all frames of the present step.
pub fn check_calibration(
    options: &ReplayOptions,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<CalibrationCheck, CheckError> {
    let (session, mut unread) = placed(options, progress)?;
    let model = Model { tag_m: 0.3, tag_rad: 0.1, constants: BELIEVED, ..Model::default() };
    let FittedWalk { info, frames, smoothed, losses, .. } = fit(&session, &model, &REACHES, progress)?;
    let values = smoothed.constants.values();
    let constant =
        |(part, index)| CheckedConstant { part, index, deviation: values[index], sigma: smoothed.known[index] };
    let constants = CHECKED.map(constant).to_vec();
    unread.extend(losses);
    let corrections = smoothed.constants;
    Ok(CalibrationCheck { info, frames: frames.len(), corrections, constants, losses: unread })
}

/// The capture itself, or one made of the log, with enough valid tags, and what could not be read of the log.
fn placed(options: &ReplayOptions, progress: &mut dyn FnMut(u64, u64)) -> Result<(PathBuf, Vec<Loss>), CheckError> {
    let source = &options.source;
    let mut options = options.clone();
    if source.join(SESSION_FILE).is_file() {
        let tags = read_tags(source)?.found;
        let valid = tags.iter().filter(|tag| tag.valid).count() as u64;
        if is_enough(valid, tags.len() as u64) {
            return Ok((source.clone(), Vec::new()));
        }
        // Only a replay looks for the cause.
        options.settings = read_info(source)?.settings;
    }
    let report = replay(&options, &mut |done, all| progress(done, all.unwrap_or(done)))?;
    if is_enough(report.valid, report.tagged) {
        let unread = report.unread();
        return Ok((report.session, unread));
    }
    let (valid, frames) = (report.valid, report.tagged);
    Err(CheckError::Unplaced { recording: source.clone(), valid, frames, why: report.warnings })
}

fn is_enough(valid: u64, frames: u64) -> bool {
    valid >= needed(frames)
}

fn needed(frames: u64) -> u64 {
    MIN_VALID.max(walk_calibration::needed(frames))
}

fn because(why: &[String]) -> String {
    why.iter().map(|warning| format!("\n{warning}")).collect()
}

impl CheckedConstant {
    /// Whether it is still as calibrated.
    pub fn drift(&self) -> Drift {
        let matters = NEEDED[self.index];
        if self.deviation.abs() > matters.max(CHANGED_SIGMAS * self.sigma) {
            Drift::Changed
        } else if self.deviation.abs() > matters || self.sigma > matters {
            Drift::Unknown
        } else {
            Drift::None
        }
    }

    /// Name and unit.
    pub fn name(&self) -> (&'static str, &'static str) {
        NAMES[self.index]
    }
}

impl CalibrationCheck {
    /// The constants compared with those of an earlier recording in place of the calibration. Both were tagged with the same lens and mount.
    #[must_use]
    pub fn since(&self, earlier: &Self) -> Vec<CheckedConstant> {
        let of_both = self.constants.iter().zip(&earlier.constants);
        let change = |(now, then): (&CheckedConstant, &CheckedConstant)| CheckedConstant {
            deviation: now.deviation - then.deviation,
            sigma: libm::hypot(now.sigma, then.sigma),
            ..*now
        };
        of_both.map(change).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drift(deviation: f64, sigma: f64) -> Drift {
        CheckedConstant { part: CameraPart::Tilt, index: 4, deviation, sigma }.drift()
    }

    #[test]
    fn a_small_deviation_counts_only_if_it_is_known_well() {
        assert_eq!(drift(0.001, 0.0005), Drift::None);
        assert_eq!(drift(-0.014, 0.001), Drift::Changed);
        assert_eq!(drift(0.014, 0.005), Drift::Unknown);
        assert_eq!(drift(0.001, 0.01), Drift::Unknown);
        // Twice what matters, but less than three standard deviations.
        assert_eq!(drift(0.007, 0.0034), Drift::Unknown);
    }
}
