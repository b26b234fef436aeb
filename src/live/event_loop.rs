//! The recorder's event loop, between devices and pipeline: takes device events, answers commands, feeds the watchdog.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError};
use glam::DVec2;
use serde_json::json;

use super::control::{Answer, Control, ControlCommand, Order};
use super::devices::{DeviceEvent, Devices};
use super::messages::{Messages, Names};
use super::notifications::Announced;
use super::port_events::PortUpdate;
use super::rates::Meters;
use super::status::{CoverageStatus, RecorderState, Status};
use super::watchdog::{Rounds, Watchdog};
use super::{RecordError, RecordOptions};
use crate::config::Settings;
use crate::devices::host_clock::monotonic_ns;
use crate::devices::mavlink::Content;
use crate::devices::serial::PortEvent;
use crate::geometry::LensParameters;
use crate::localization::Rejection;
use crate::log_input::synchroniser::Expected;
use crate::ros2::mcap_read::LogMessage;
use crate::ros2::messages::{CompressedImageView, FrameTag};
use crate::tagging::inter_session::IdleOdometry;
use crate::tagging::pipeline::Pipeline;

/// Time for which the ports are heard before the first session begins: clocks settle, and it becomes known what the robot
/// measures.
const INITIAL_LISTENING: Duration = Duration::from_millis(1500);
/// Longest wait for an event, and so for a command.
pub(super) const TICK: Duration = Duration::from_millis(50);

/// State of the live recorder.
pub(super) struct LiveRecorder<'a> {
    pub(super) options: &'a RecordOptions,
    pub(super) lens: LensParameters,
    /// UTC minus monotonic clock, nanoseconds.
    pub(super) clock_ns: i64,
    pub(super) devices: Devices,
    pub(super) control: Control,
    pub(super) names: Names,
    pub(super) messages: Messages,
    pub(super) session: Option<Pipeline>,
    /// Follows odometry between the end of one session and the start of the next.
    pub(super) between: Option<IdleOdometry>,
    /// Half extent of the carpet, metres, known once a session has begun.
    pub(super) carpet_half_m: Option<DVec2>,
    /// Whether any session has begun, even if it has ended since.
    pub(super) had_session: bool,
    pub(super) tags: Option<Receiver<FrameTag>>,
    pub(super) heard: Expected,
    pub(super) status: Status,
    pub(super) meters: Meters,
    pub(super) last_log_ns: i64,
    pub(super) status_logged_ns: i64,
    pub(super) watchdog: Watchdog,
    pub(super) announced: Announced,
    /// Messages about the repair of earlier sessions, sent as they are repaired.
    pub(super) repairs: Receiver<String>,
}

impl<'a> LiveRecorder<'a> {
    pub(super) fn new(
        options: &'a RecordOptions,
        lens: LensParameters,
        clock_ns: i64,
        devices: Devices,
        control: Control,
        repairs: Receiver<String>,
    ) -> Self {
        let Settings { topics, frames, head, .. } = options.settings.clone();
        Self {
            options,
            lens,
            clock_ns,
            devices,
            control,
            names: Names { topics, frames, head },
            messages: Messages::default(),
            session: None,
            between: None,
            carpet_half_m: None,
            had_session: false,
            tags: None,
            heard: Expected::default(),
            status: Status::default(),
            meters: Meters::default(),
            last_log_ns: i64::MIN,
            status_logged_ns: i64::MIN,
            watchdog: Watchdog::default(),
            announced: Announced::default(),
            repairs,
        }
    }

    /// Records until `stop`. Ends the session also when an error occurs.
    pub(super) fn run(
        &mut self,
        events: &Receiver<DeviceEvent>,
        stop: &AtomicBool,
        say: &mut dyn FnMut(&str),
    ) -> Result<(), RecordError> {
        let listened = Instant::now();
        let listen = if self.options.settings.serial.ports.is_empty() { Duration::ZERO } else { INITIAL_LISTENING };
        while listened.elapsed() < listen && !stop.load(Ordering::Relaxed) {
            self.step(events, say)?;
        }
        let wanted = self.status.state == RecorderState::Listening && !stop.load(Ordering::Relaxed);
        let began = if wanted { self.begin_session(say) } else { Ok(()) };
        let went_on = began.and_then(|()| {
            // Notifies systemd; without a supervisor that asked for it this does nothing.
            let _ = sd_notify::notify(&[sd_notify::NotifyState::Ready]);
            while !stop.load(Ordering::Relaxed) {
                self.step(events, say)?;
                self.feed_watchdog();
            }
            Ok(())
        });
        let _ = sd_notify::notify(&[sd_notify::NotifyState::Stopping]);
        self.end_session(say);
        went_on
    }

    /// Handles the next device event, or a tick without one, then commands, tags and status.
    fn step(&mut self, events: &Receiver<DeviceEvent>, say: &mut dyn FnMut(&str)) -> Result<(), RecordError> {
        match events.recv_timeout(TICK) {
            Ok(event) => self.handle_event(event, say)?,
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => std::thread::sleep(TICK),
        }
        while let Ok(order) = self.control.orders.try_recv() {
            self.handle_command(order, say)?;
        }
        self.forward_tags();
        self.announce_recorder_changes(say);
        for said in self.repairs.try_iter() {
            say(&said);
            self.status.repaired.push(said);
        }
        self.log_status()
    }

    /// Passes new tags to `poses` clients, status, meters and serial ports.
    pub(super) fn forward_tags(&mut self) {
        for tag in self.tags.iter().flat_map(Receiver::try_iter) {
            self.control.tell(&tag);
            self.status.set_last_tag(&tag);
            if tag.reason != Rejection::NoFrame.as_str() {
                self.meters.note_tag(&tag);
            }
            self.devices.send_tag(&tag, self.clock_ns);
        }
    }

    fn handle_event(&mut self, event: DeviceEvent, say: &mut dyn FnMut(&str)) -> Result<(), RecordError> {
        match event {
            DeviceEvent::CameraOpened(camera) => {
                for why in &camera.refused {
                    say(&format!("camera control {why}"));
                }
                say(&format!(
                    "camera: {} {} {} x {}",
                    camera.card,
                    camera.format.fourcc(),
                    camera.width,
                    camera.height
                ));
                self.status.camera = Some(camera);
                self.status.camera_lost = None;
            }
            DeviceEvent::CameraLost { cause, said } => {
                say(&format!("{said}; it is tried again"));
                self.status.camera_lost = Some(cause.to_owned());
                self.log_event("camera", cause, &said)?;
            }
            DeviceEvent::Dropped { cause, count } => {
                if let Some(session) = &mut self.session {
                    session.drop_frames(cause, count)?;
                }
            }
            DeviceEvent::Frame { message, clock } => {
                self.devices.waiting.fetch_sub(1, Ordering::Relaxed);
                if self.status.camera_lost.take().is_some() {
                    say("camera: frames again");
                    self.log_event("camera", "recovered", "frames again")?;
                }
                self.status.stamp_clock = Some(clock);
                self.log(message)?;
            }
            DeviceEvent::Port { device, event } => self.handle_port_event(&device, event, say)?,
        }
        Ok(())
    }

    fn handle_port_event(
        &mut self,
        device: &str,
        event: PortEvent,
        say: &mut dyn FnMut(&str),
    ) -> Result<(), RecordError> {
        match event {
            PortEvent::Opened { low_latency } => {
                if low_latency == Some(false) {
                    say(&format!("{device}: its driver holds bytes back, and may not be told otherwise (udev rules)"));
                }
                self.status.port(device).set_closed(None);
            }
            PortEvent::Lost(error) => {
                let said = error.to_string();
                if self.status.port(device).set_closed(Some(said.clone())) {
                    say(&format!("{said}; it is tried again"));
                    self.log_event("serial", "lost", &said)?;
                }
            }
            PortEvent::Status(line) => {
                for PortUpdate { event, said } in self.status.port(device).update(line) {
                    say(&format!("{device}: {said}"));
                    self.log_event("serial", event, &format!("{device}: {said}"))?;
                }
            }
            PortEvent::Measured(measured) => {
                self.heard.imu |= matches!(measured.content, Content::Attitude(_));
                self.heard.joints |= matches!(measured.content, Content::Head(_));
                if self.session.is_some() || self.between.is_some() {
                    let stamp_ns = measured.stamp_ns.saturating_add(self.clock_ns);
                    if let Some(message) = self.messages.measured(stamp_ns, &measured.content, &self.names) {
                        self.log(message)?;
                    }
                }
            }
        }
        Ok(())
    }

    fn handle_command(&mut self, order: Order, say: &mut dyn FnMut(&str)) -> Result<(), RecordError> {
        let done = match order.what {
            ControlCommand::Frame(known) => {
                let _ = order.answer.try_send(self.latest_frame(known));
                return Ok(());
            }
            ControlCommand::Status => {
                self.refresh_status();
                self.status.coverage = self.session.as_ref().map(|session| CoverageStatus::from(session.coverage()));
                Ok(json!(self.status))
            }
            ControlCommand::Mark(_) if self.session.is_none() => {
                Ok(json!({ "error": "nothing is being recorded: the mark has no place" }))
            }
            ControlCommand::Mark(text) => self.log_event("mark", "mark", &text).map(|()| json!({ "marked": text })),
            ControlCommand::Place(place) => self.take_announced_pose(&place),
            ControlCommand::Start => self.begin_session(say).map(|()| json!({ "state": self.status.state })),
            ControlCommand::Stop => {
                self.end_session(say);
                let Status { state, session, unfinished, .. } = &self.status;
                Ok(json!({ "state": state, "session": session, "unfinished": unfinished }))
            }
        };
        let answer = match &done {
            Ok(value) => value.clone(),
            Err(error) => json!({ "error": error.to_string() }),
        };
        let _ = order.answer.try_send(answer.into());
        done.map(|_| ())
    }

    /// The latest frame of the session with its tag, field and lens. Its image is sent as the camera made it, and not encoded here.
    fn latest_frame(&self, known: Option<u64>) -> Answer {
        let Some((session, (message, tag))) =
            self.session.as_ref().and_then(|session| Some((session, session.latest()?)))
        else {
            return json!({ "error": "there is no frame yet" }).into();
        };
        if known == Some(tag.sequence) {
            return json!({ "unchanged": true }).into();
        }
        let image = CompressedImageView::decode(&message.data).map(|view| view.data.to_vec()).unwrap_or_default();
        let line = json!({ "bytes": image.len(), "tag": tag, "field": session.field(), "lens": self.lens });
        Answer { line, bytes: image }
    }

    /// Gives the message the present time and passes it to the session, or to the odometry between sessions. Log times
    /// never decrease.
    pub(super) fn log(&mut self, mut message: LogMessage) -> Result<(), RecordError> {
        let now_ns = (self.clock_ns + monotonic_ns()).max(self.last_log_ns);
        self.last_log_ns = now_ns;
        (message.log_time_ns, message.publish_time_ns) = (now_ns, now_ns);
        match (&mut self.session, &mut self.between) {
            (Some(session), _) => session.take(message)?,
            (None, Some(between)) => between.take(&message),
            (None, None) => {}
        }
        Ok(())
    }

    /// Feeds systemd's watchdog if the camera's thread and the recorder's go on. This thread goes on if it gets here.
    fn feed_watchdog(&mut self) {
        let camera = self.devices.rounds.load(Ordering::Relaxed);
        let recorder = self.session.as_ref().and_then(Pipeline::recorder_rounds);
        if self.watchdog.check_progress(Rounds { camera, recorder }, Instant::now()) {
            let _ = sd_notify::notify(&[sd_notify::NotifyState::Watchdog]);
        }
    }

    /// UTC in nanoseconds.
    pub(super) fn now_ns(&self) -> i64 {
        self.clock_ns.saturating_add(monotonic_ns())
    }
}
