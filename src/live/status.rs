//! Status of a running recorder, for `realitysim recorder status` and for the log.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Instant;

use serde::{Deserialize, Serialize};

use super::port_events::Port;
use super::rates::{BudgetUse, FilterUse, Rates, Validity};
use crate::devices::camera::{Negotiated, StampClock};
use crate::devices::serial::LineStatus;
use crate::geometry::{PoseGrid, longest_axis};
use crate::recording::{Counts, RecorderStatus};
use crate::ros2::messages::{DiagnosticArray, DiagnosticStatus, FrameTag, Header, KeyValue};
use crate::ros2::topics::DIAGNOSTICS_PREFIX;

/// Answer to `realitysim recorder status`, also the result of `realitysim record`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Status {
    pub state: RecorderState,
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
    pub camera: Option<Negotiated>,
    /// Cause of the camera's absence, while it is absent.
    pub camera_lost: Option<String>,
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

/// What a recorder does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RecorderState {
    /// It hears the ports before its first session.
    #[default]
    Listening,
    /// A session is under way.
    Recording,
    /// The session has ended, and the recorder goes on running.
    Stopped,
    /// The recorder has ended.
    Ended,
}

/// Sums over earlier sessions of the same process.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Earlier {
    pub sessions: u64,
    pub counts: Counts,
    pub frames_refused: u64,
    /// Sessions that could not be completed.
    pub unfinished: u64,
}

/// Coverage of the pose grid, as numbers and as a map.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct CoverageStatus {
    /// Side of a cell, metres.
    pub cell_m: f64,
    /// Headings that are told apart.
    pub sectors: usize,
    pub columns: usize,
    pub rows: usize,
    /// Columns x rows x sectors.
    pub cells: usize,
    /// Cells with at least one image.
    pub filled: usize,
    /// Images whose camera was off the carpet.
    pub outside: usize,
    /// The field from above, a letter for each cell, made by `PoseGrid::text`.
    pub map: Vec<String>,
}

impl From<&PoseGrid> for CoverageStatus {
    fn from(grid: &PoseGrid) -> Self {
        let &PoseGrid { cell_m, sectors, columns, rows, cells, filled, outside, .. } = grid;
        Self { cell_m, sectors, columns, rows, cells, filled, outside, map: grid.text() }
    }
}

/// Frames passed on to another video device.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PassedOn {
    pub device: String,
    pub passed: u64,
    /// Frames that nobody read, or for which the device was absent.
    pub missed: u64,
    pub lost: Option<String>,
}

/// Summary of the latest tag.
#[derive(Clone, Debug, Serialize, Deserialize)]
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
    #[serde(skip, default = "Instant::now")]
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::devices::camera::{Negotiated, PixelFormat};
    use crate::devices::clock::{ClockStatus, Source};
    use crate::devices::mavlink::{PortCounts, Sender, TimeBase};
    use crate::devices::serial::SenderClock;
    use crate::recording::{Fault, Stopped};

    #[test]
    fn a_status_read_from_its_text_says_the_same() {
        let clock = ClockStatus {
            source: Source::Arrivals,
            offset_ns: -5,
            uncertainty_ns: 70_000,
            drift_ppm: 1.5,
            restarts: 2,
            exchanges: 3,
        };
        let line = LineStatus {
            counts: PortCounts { used: [("ODOMETRY".into(), 7)].into(), lost: 3, ..PortCounts::default() },
            unsent: 1,
            clocks: vec![SenderClock { sender: Sender { system: 1, component: 2 }, base: TimeBase::Boot, clock }],
        };
        let mut status = Status {
            state: RecorderState::Recording,
            session: Some("captures/a".into()),
            unfinished: Some("a reason".to_owned()),
            camera: Some(Negotiated {
                card: "a camera".to_owned(),
                bus: "usb-1".to_owned(),
                format: PixelFormat::Nv12,
                width: 640,
                height: 480,
                stride: 640,
                rate_hz: Some(30.0),
                controls: [("exposure".to_owned(), 5)].into(),
                refused: Vec::new(),
            }),
            camera_lost: Some("unplugged".to_owned()),
            stamp_clock: Some(StampClock::EndOfFrame),
            republished: Some(PassedOn { device: "/dev/video9".to_owned(), passed: 5, missed: 1, lost: None }),
            coverage: Some(CoverageStatus::from(&PoseGrid::new(glam::DVec2::new(2.0, 1.0), 0.5, 4))),
            ..Status::default()
        };
        status.recorder.fault = Some(Fault { cause: "disk_full".to_owned(), said: "no space".to_owned() });
        status.recorder.stopped = Some(Stopped { cause: "disk_full".to_owned(), frames_only: true });
        status.port("/dev/ttyUSB0").update(line);
        status.port("/dev/ttyUSB1").set_closed(Some("gone".to_owned()));
        status.set_last_tag(&FrameTag { sequence: 4, valid: true, ..FrameTag::default() });
        let text = serde_json::to_value(&status).expect("a status is JSON");
        let read: Status = serde_json::from_value(text.clone()).expect("a status");
        assert_eq!(serde_json::to_value(&read).expect("JSON"), text);
        // A recorder of another version may say less, at any depth.
        let little = serde_json::json!({
            "state": "stopped", "recorder": { "frames_synced": 5 }, "earlier": { "sessions": 1 }, "rates": {}, "budget": {},
            "validity": {}, "filter": {}, "ports": { "/dev/ttyUSB0": { "line": { "counts": { "lost": 3, "frames": {} } } } },
        });
        let little: Status = serde_json::from_value(little).expect("a status");
        assert_eq!((little.state, little.recorder.frames_synced), (RecorderState::Stopped, 5));
    }
}
