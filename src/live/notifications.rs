//! Reports of the live recorder: to people, to the log, and to clients that ask for its status.

use std::path::Path;
use std::sync::atomic::Ordering;
use std::time::Instant;

use super::RecordError;
use super::event_loop::{LiveRecorder, TICK};
use super::status::{self, PassedOn};
use crate::recording::{REMOVED, RecorderStatus, Stopped};
use crate::ros2::messages::DiagnosticArray;
use crate::tagging::pipeline::Pipeline;

/// How often the status is written to the log, nanoseconds.
const STATUS_INTERVAL_NS: i64 = 1_000_000_000;

/// Recorder state that people have been told of, and when.
#[derive(Default)]
pub(super) struct Announced {
    at: Option<Instant>,
    recorder: RecorderStatus,
    /// Why frames cannot be passed on to another video device, if they cannot.
    not_passed_on: Option<String>,
}

impl LiveRecorder<'_> {
    /// Tells people of changes in where and whether the session is written, as soon as they are known.
    pub(super) fn announce_recorder_changes(&mut self, say: &mut dyn FnMut(&str)) {
        if self.announced.at.is_some_and(|at| at.elapsed() < TICK) {
            return;
        }
        let Some((_, recorder)) = self.session.as_ref().and_then(Pipeline::recorder) else { return };
        let before = &self.announced.recorder;
        let removed = |status: &RecorderStatus| status.faults.get(REMOVED).copied().unwrap_or_default();
        // Compared by count, since the fault may be mended before anybody looks.
        if removed(&recorder) > removed(before) {
            let session = before.session.as_deref().unwrap_or(Path::new("the session")).display();
            say(&format!("{session} was removed or moved while it was being recorded: its frames count as lost"));
        }
        if let Some(folder) = recorder.session.as_ref().filter(|folder| before.session.as_ref() != Some(folder)) {
            say(&format!("recording {}", folder.display()));
        }
        if recorder.fault != before.fault {
            match &recorder.fault {
                Some(fault) => say(&format!("the disk: {}: {}; it is tried again", fault.cause, fault.said)),
                None => say("the disk: all is written again"),
            }
        }
        if recorder.stopped != before.stopped {
            match &recorder.stopped {
                Some(Stopped { cause, frames_only: true }) => say(&format!("{cause}: frames are not recorded")),
                Some(Stopped { cause, .. }) => say(&format!("{cause}: nothing is recorded")),
                None => say("there is room again: frames are recorded"),
            }
        }
        if recorder.evicted_segments > before.evicted_segments {
            let segments = recorder.evicted_segments - before.evicted_segments;
            say(&format!("{segments} segments that a dev machine has were removed to make room"));
        }
        let not_passed_on = self.devices.republished.lost();
        if not_passed_on != self.announced.not_passed_on {
            match &not_passed_on {
                Some(why) => say(&format!("frames are not passed on: {why}; it is tried again")),
                None => say("frames are passed on again"),
            }
        }
        self.announced = Announced { at: Some(Instant::now()), recorder, not_passed_on };
    }

    /// Writes an event to the log.
    pub(super) fn log_event(&mut self, about: &str, what: &str, said: &str) -> Result<(), RecordError> {
        let report = status::event_report(self.now_ns(), &self.options.settings.robot, about, what, said);
        self.write_report(&report)
    }

    /// Writes the status to the log, once a second.
    pub(super) fn log_status(&mut self) -> Result<(), RecordError> {
        let now_ns = self.now_ns();
        if now_ns.saturating_sub(self.status_logged_ns) < STATUS_INTERVAL_NS {
            return Ok(());
        }
        self.status_logged_ns = now_ns;
        self.refresh_status();
        self.meters.update_rates(now_ns, &self.status.counts);
        let report = self.status.diagnostics(now_ns, &self.options.settings.robot);
        self.write_report(&report)
    }

    fn write_report(&mut self, report: &DiagnosticArray) -> Result<(), RecordError> {
        let log_time_ns = self.now_ns().max(self.last_log_ns);
        self.last_log_ns = log_time_ns;
        match &mut self.session {
            Some(session) => Ok(session.note(log_time_ns, report)?),
            None => Ok(()),
        }
    }

    /// Brings the status up to date with session, devices and meters.
    pub(super) fn refresh_status(&mut self) {
        if let Some((counts, recorder)) = self.session.as_ref().and_then(Pipeline::recorder) {
            self.status.session.clone_from(&recorder.session);
            (self.status.counts, self.status.recorder) = (counts, recorder);
        }
        let status = &mut self.status;
        status.update_age();
        status.camera_waiting = self.devices.waiting.load(Ordering::Relaxed);
        status.rates = self.meters.rates();
        status.budget = self.meters.budget(self.options.settings.filter.budget_ms);
        status.validity = self.meters.validity();
        status.filter = self.meters.filter();
        let republished = &self.devices.republished;
        status.republished = self.options.settings.capture.republish.as_ref().map(|device| PassedOn {
            device: device.clone(),
            passed: republished.passed(),
            missed: republished.missed(),
            lost: republished.lost(),
        });
    }
}
