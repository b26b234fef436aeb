//! Estimates the delay of the camera's stamps against its exposures, from a recording in which head or body turned.

use std::path::{Path, PathBuf};

use glam::{DQuat, DVec3};
use serde::Serialize;
use thiserror::Error;

use crate::config::Settings;
use crate::devices::clock::{DelayError, Turn, estimate};
use crate::geometry::Lens;
use crate::log_input::decode;
use crate::log_input::measurement::{self, Measurement};
use crate::recording::read_info;
use crate::tagging::error::ReplayError;
use crate::tagging::open_input::{self, OpenLog};
use crate::vision::Turning;

/// Result of `realitysim doctor --estimate-delay`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DelayReport {
    pub log: PathBuf,
    /// Pairs of frames between which the camera turned.
    pub turns: usize,
    /// Delay that was subtracted from the stamps when this was recorded, milliseconds.
    pub configured_ms: f64,
    /// Value that `capture.delay_ms` should have.
    pub delay_ms: f64,
    /// Two standard deviations, milliseconds.
    pub uncertainty_ms: f64,
    pub correlation: f64,
}

/// Why no delay could be estimated.
#[derive(Debug, Error)]
pub enum DelayReportError {
    #[error("{captures}: no capture in it: record one while head or body turns left and right")]
    NoCapture { captures: PathBuf },
    #[error(transparent)]
    Log(#[from] ReplayError),
    #[error("{log}: {source}")]
    Delay { log: PathBuf, source: DelayError },
}

/// Longest time between two frames: over a longer one, a turn says too little of when it happened.
const MAX_BETWEEN_NS: i64 = 150_000_000;
/// Longest time between two attitudes that are interpolated.
const MAX_GAP_NS: i64 = 100_000_000;
/// Frames that are looked at: a minute and a half at 30 a second.
const MAX_FRAMES: usize = 2700;

/// Estimates the delay from a log or capture; in a folder of captures, from the newest.
pub fn estimate_delay(path: &Path, settings: &Settings) -> Result<DelayReport, DelayReportError> {
    let log = newest_capture(path)?;
    let configured_ns = read_info(&log).ok().and_then(|info| info.live).map_or(0, |live| live.camera_delay_ns) as f64;
    let opened = open_input::log(&log, settings)?;
    let rotations = Rotations::of(opened)?;
    let found = estimate(&rotations.turns, |from, to| rotations.carrier_turn(from, to))
        .map_err(|source| DelayReportError::Delay { log: log.clone(), source })?;
    Ok(DelayReport {
        log,
        turns: found.turns,
        configured_ms: configured_ns * 1e-6,
        delay_ms: (configured_ns + found.delay_ns as f64) * 1e-6,
        uncertainty_ms: found.uncertainty_ns as f64 * 1e-6,
        correlation: found.correlation,
    })
}

/// The log or capture itself; of a folder of captures the newest.
pub fn newest_capture(path: &Path) -> Result<PathBuf, DelayReportError> {
    if path.is_file() || path.join("session.json").is_file() {
        return Ok(path.to_owned());
    }
    let entries = std::fs::read_dir(path).into_iter().flatten().filter_map(Result::ok).map(|entry| entry.path());
    // The names begin with the time.
    let newest = entries.filter(|folder| folder.join("session.json").is_file()).max();
    newest.ok_or_else(|| DelayReportError::NoCapture { captures: path.to_owned() })
}

/// Rotations in a recording: between frames, of the body, and of the head.
#[derive(Default)]
struct Rotations {
    turns: Vec<Turn>,
    attitudes: Vec<(i64, DQuat)>,
    heads: Vec<(i64, DQuat)>,
}

impl Rotations {
    fn of(opened: OpenLog) -> Result<Self, ReplayError> {
        let OpenLog { setup, messages, .. } = opened;
        let mut rotations = Self::default();
        let Ok(lens) = Lens::new(setup.lens.clone()) else { return Ok(rotations) };
        let turning = Turning::new(&lens);
        let size = [lens.width() as usize, lens.height() as usize];
        let (mut last, mut frames) = (None, 0);
        for message in messages {
            let message = message?;
            match measurement::read(&message, &setup.topics, &setup.settings.head) {
                Ok(Measurement::Imu { stamp_ns, orientation: Some(orientation), .. }) => {
                    rotations.attitudes.push((stamp_ns, orientation));
                }
                Ok(Measurement::Joints { stamp_ns, pan, tilt }) => {
                    let head = DQuat::from_rotation_z(pan.unwrap_or(0.0)) * DQuat::from_rotation_y(tilt.unwrap_or(0.0));
                    rotations.heads.push((stamp_ns, head));
                }
                Ok(Measurement::Frame { stamp_ns, .. }) if frames < MAX_FRAMES => {
                    frames += 1;
                    let now = decode::picture_of_size(&message, size).ok().and_then(|picture| turning.small(&picture));
                    if let (Some((from_ns, before)), Some(now)) = (&last, &now)
                        && (1..=MAX_BETWEEN_NS).contains(&(stamp_ns - from_ns))
                        && let Some(turn) = turning.between(before, now)
                    {
                        rotations.turns.push(Turn { from_ns: *from_ns, to_ns: stamp_ns, angle: turn.length() });
                    }
                    last = now.map(|now| (stamp_ns, now));
                }
                _ => {}
            }
        }
        rotations.attitudes.sort_by_key(|(ns, _)| *ns);
        rotations.heads.sort_by_key(|(ns, _)| *ns);
        Ok(rotations)
    }

    /// Angle in radians that the camera's carrier turned between two times. Without joint states the head counts as still.
    fn carrier_turn(&self, from_ns: i64, to_ns: i64) -> Option<f64> {
        let carried = |ns: i64| {
            let head = if self.heads.is_empty() { DQuat::IDENTITY } else { interpolate(&self.heads, ns)? };
            Some(interpolate(&self.attitudes, ns)? * head)
        };
        let turn: DVec3 = (carried(from_ns)?.conjugate() * carried(to_ns)?).to_scaled_axis();
        Some(turn.length())
    }
}

/// Interpolated rotation at a time; `None` outside the samples or in a gap longer than `MAX_GAP_NS`.
fn interpolate(samples: &[(i64, DQuat)], ns: i64) -> Option<DQuat> {
    let after = samples.partition_point(|(sample_ns, _)| *sample_ns < ns);
    let (b_ns, b) = samples.get(after)?;
    let (a_ns, a) = samples.get(after.checked_sub(1)?)?;
    let between = b_ns - a_ns;
    (between <= MAX_GAP_NS).then(|| a.slerp(*b, (ns - a_ns) as f64 / between.max(1) as f64))
}
