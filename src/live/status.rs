//! Status of a running recorder, for `realitysim status` and for the log.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Instant;

use serde::Serialize;
use serde_json::Value;

use super::port_events::Port;
use super::rates::{BudgetUse, FilterUse, Rates, Validity};
use crate::devices::camera::StampClock;
use crate::devices::serial::LineStatus;
use crate::geometry::{PoseGrid, longest_axis};
use crate::recording::{Counts, RecorderStatus};
use crate::ros2::messages::{DiagnosticArray, DiagnosticStatus, FrameTag, Header, KeyValue};
use crate::ros2::topics::DIAGNOSTICS_PREFIX;

/// Answer to `realitysim status`, also the result of `realitysim record`.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Status {
    /// `listening` (before the first session), `recording`, `stopped` or `ended`.
    pub state: &'static str,
    pub session: Option<PathBuf>,
    pub counts: Counts,
    pub recorder: RecorderStatus,
    /// Why the last session is not complete.
    pub unfinished: Option<String>,
    /// Sums over the sessions of this process that ended before the present one.
    pub earlier: Earlier,
    /// Messages about sessions of earlier recorders that were repaired.
    pub repaired: Vec<String>,
    /// Format, size and controls that the camera agreed to.
    pub camera: Value,
    /// Cause of the camera's absence, while it is absent.
    pub camera_lost: Option<&'static str>,
    pub stamp_clock: Option<StampClock>,
    /// Rates over the last second.
    pub rates: Rates,
    /// Frames waiting between camera and event loop, at most 16. `recorder` counts those between event loop and disk.
    pub camera_waiting: u64,
    /// Frames passed on to other programs, if that is configured.
    pub republished: Option<PassedOn>,
    pub budget: BudgetUse,
    pub validity: Validity,
    pub filter: FilterUse,
    pub ports: BTreeMap<String, Port>,
    /// Latest tag. While no frames come it is a prediction with `reason` `no_frame`.
    pub last_tag: Option<LastTag>,
    /// Cells of the pose grid that the session has images of.
    pub coverage: Option<CoverageStatus>,
}

/// Sums over earlier sessions of the same process.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Earlier {
    pub sessions: u64,
    pub counts: Counts,
    pub frames_refused: u64,
    /// Sessions that could not be completed.
    pub unfinished: u64,
}

/// Coverage of the pose grid, as numbers and as a map.
#[derive(Clone, Debug, Serialize)]
pub struct CoverageStatus {
    #[serde(flatten)]
    pub grid: PoseGrid,
    /// The field from above, a letter for each cell, made by `PoseGrid::text`.
    pub map: Vec<String>,
}

/// Frames passed on to another video device.
#[derive(Clone, Debug, Serialize)]
pub struct PassedOn {
    pub device: String,
    pub passed: u64,
    /// Frames that nobody read, or for which the device was absent.
    pub missed: u64,
    pub lost: Option<String>,
}

/// Summary of the latest tag.
#[derive(Clone, Debug, Serialize)]
pub struct LastTag {
    pub sequence: u64,
    pub valid: bool,
    pub reason: String,
    /// The mirror pose explains the frame as well.
    pub ambiguous: bool,
    /// Standard deviation of the position along its longer axis, metres.
    pub sigma_m: f64,
    pub x_m: f64,
    pub y_m: f64,
    pub yaw_rad: f64,
    pub elapsed_ms: f64,
    /// Time since the tag came, seconds.
    pub age_s: f64,
    #[serde(skip)]
    came: Instant,
}

impl Status {
    /// Adds the counts of the last session to `earlier` and clears them: at the end the sums show whether anything was
    /// lost.
    pub fn begin_session(&mut self) {
        let earlier = &mut self.earlier;
        earlier.sessions += 1;
        earlier.counts.add(&core::mem::take(&mut self.counts));
        earlier.frames_refused += core::mem::take(&mut self.recorder).frames_refused;
        earlier.unfinished += u64::from(self.unfinished.take().is_some());
        (self.session, self.last_tag) = (None, None);
    }

    /// Updates the age of the latest tag.
    pub fn update_age(&mut self) {
        if let Some(last) = &mut self.last_tag {
            last.age_s = last.came.elapsed().as_secs_f64();
        }
    }

    pub fn set_last_tag(&mut self, tag: &FrameTag) {
        let (position, covariance) = (&tag.pose.pose.position, &tag.pose.covariance);
        self.last_tag = Some(LastTag {
            sequence: tag.sequence,
            valid: tag.valid,
            reason: tag.reason.clone(),
            ambiguous: tag.ambiguous,
            sigma_m: longest_axis(covariance[0], covariance[1], covariance[7]),
            x_m: position.x,
            y_m: position.y,
            yaw_rad: tag.yaw,
            elapsed_ms: tag.elapsed_ms,
            age_s: 0.0,
            came: Instant::now(),
        });
    }

    pub fn port(&mut self, device: &str) -> &mut Port {
        self.ports.entry(device.to_owned()).or_default()
    }

    /// Makes the diagnostics message with counts and clocks of the ports.
    pub fn diagnostics(&self, now_ns: i64, robot: &str) -> DiagnosticArray {
        let status = self.ports.iter().map(|(device, port)| {
            let mut values = Vec::new();
            if let Some(LineStatus { counts, unsent, clocks }) = &port.line {
                let frames = &counts.frames;
                let numbers = [
                    ("messages", frames.frames),
                    ("lost", counts.lost),
                    ("crc_failures", frames.crc_failures),
                    ("bytes_skipped", frames.bytes_skipped),
                    ("unusable", counts.unusable.values().sum()),
                    ("estimate_resets", counts.resets),
                    ("unsent", *unsent),
                ];
                values.extend(numbers.map(|(key, number)| value(key, number)));
                for clock in clocks {
                    let (system, component) = (clock.sender.system, clock.sender.component);
                    let of = |what: &str| format!("{system}.{component}.{what}");
                    values.push(value(&of("offset_ns"), clock.clock.offset_ns));
                    values.push(value(&of("uncertainty_ns"), clock.clock.uncertainty_ns));
                    values.push(value(&of("drift_ppm"), format!("{:.2}", clock.clock.drift_ppm)));
                    values.push(value(&of("restarts"), clock.clock.restarts));
                }
            }
            let wrong = port.problem();
            DiagnosticStatus {
                level: if wrong.is_some() { DiagnosticStatus::WARN } else { DiagnosticStatus::OK },
                name: format!("{DIAGNOSTICS_PREFIX}port {device}"),
                message: wrong.unwrap_or("open").to_owned(),
                hardware_id: robot.to_owned(),
                values,
            }
        });
        DiagnosticArray { header: Header::at(now_ns, ""), status: status.collect() }
    }
}

/// Makes the diagnostics message for one event.
pub fn event_report(now_ns: i64, robot: &str, about: &str, what: &str, said: &str) -> DiagnosticArray {
    let status = DiagnosticStatus {
        level: if matches!(what, "mark" | "recovered") { DiagnosticStatus::OK } else { DiagnosticStatus::WARN },
        name: format!("{DIAGNOSTICS_PREFIX}{about}"),
        message: said.to_owned(),
        hardware_id: robot.to_owned(),
        values: vec![value("event", what)],
    };
    DiagnosticArray { header: Header::at(now_ns, ""), status: vec![status] }
}

fn value(key: &str, value: impl ToString) -> KeyValue {
    KeyValue { key: key.to_owned(), value: value.to_string() }
}
