//! The agent on a robot: devices in, the same pipeline as a replay's, a capture out.

mod control;
mod devices;
mod messages;
mod meters;
mod status;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError, bounded};
use serde_json::{Value, json};
use thiserror::Error;

pub use control::{ask, poses};
pub use status::Status;

use super::error::AgentError;
use super::pipeline::{Pipeline, Recorded, Recording};
use super::prelude::Prelude;
use super::setup::{Setup, SetupError};
use super::state::{Start, last_state};
use super::warnings::AttitudeSource;
use crate::config::{ConfigError, Settings, load_lens};
use crate::geometry::{LensError, LensParameters, Pose2};
use crate::recording::storage::Disk;
use crate::recording::{LiveInfo, RecorderStatus, Stopped, Writing, repair, robot_id, session_holding, sessions_of};
use crate::ros2::mcap_read::LogMessage;
use crate::ros2::messages::{CameraInfo, FrameTag, TFMessage};
use crate::sensors::host_clock::{monotonic_ns, utc_offset_ns};
use crate::sensors::intake::{self, Input};
use crate::sensors::mavlink::Content;
use crate::sensors::scene::{camera_info_of, header};
use crate::sensors::serial::PortEvent;
use crate::sensors::synchroniser::{Expected, Synchroniser, SynchroniserState};
use control::{Ask, Control, Order};
use devices::{DeviceEvent, Devices, channel};
use messages::{Messages, Names, initial_pose, transforms};
use meters::Meters;
use status::{CoverageStatus, PassedOn};

#[derive(Clone, Debug)]
pub struct RecordOptions {
    pub captures: PathBuf,
    pub settings: Settings,
    /// Pose of `base_footprint` at the start.
    pub initial: Option<Pose2>,
    pub threads: usize,
    /// Go on from the state that the last agent left behind.
    pub warm_start: bool,
    /// Where questions and orders come in.
    pub socket: PathBuf,
}

#[derive(Debug, Error)]
pub enum RecordError {
    #[error("mount.torso_height_m is not set: `record` must know where the camera is (docs/hardware.md)")]
    NoMount,
    #[error("camera.lens is not set: `record` must know the camera's lens and size (docs/hardware.md)")]
    NoLens,
    #[error("{captures}: the folder belongs to the capture {session}: name another with --output")]
    IntoCapture { captures: PathBuf, session: PathBuf },
    #[error(transparent)]
    Config(#[from] ConfigError),
    #[error("camera.fov_deg: {0}")]
    Fov(#[from] LensError),
    #[error(transparent)]
    Setup(#[from] SetupError),
    #[error("{path}: {source}")]
    Socket { path: PathBuf, source: std::io::Error },
    #[error(transparent)]
    Agent(#[from] AgentError),
}

/// So long the ports are listened to before a session begins: clocks settle, and what the robot measures is known.
const LISTEN: Duration = Duration::from_millis(1500);
/// The longest that nothing is done.
const TICK: Duration = Duration::from_millis(50);
const STATUS_EVERY_NS: i64 = 1_000_000_000;
/// Repaired sessions that are told of.
const MAX_REPAIRS_TOLD: usize = 64;
/// Tags between the pipeline and whoever wants poses.
const MAX_TAGS: usize = 256;

/// Records until `stop`; `say` gets what people want to know as it happens.
pub fn record(options: &RecordOptions, stop: &AtomicBool, say: &mut dyn FnMut(&str)) -> Result<Value, RecordError> {
    if let Some(session) = session_holding(&options.captures) {
        return Err(RecordError::IntoCapture { captures: options.captures.clone(), session });
    }
    let lens = lens(&options.settings)?;
    let clock_ns = utc_offset_ns();
    let (send, events) = channel();
    let control = Control::listen(&options.socket)
        .map_err(|source| RecordError::Socket { path: options.socket.clone(), source })?;
    // What cannot be right is refused before a device is touched.
    setup(options, &lens, clock_ns + monotonic_ns(), Expected::default())?;
    let repairs = repair_in_the_background(&options.captures);
    let devices = Devices::start(&options.settings, (lens.width, lens.height), clock_ns, &send);
    drop(send);
    let mut agent = Agent::new(options, lens, clock_ns, devices, control, repairs);
    let recorded = agent.run(&events, stop, say);
    let Agent { devices, mut status, .. } = agent;
    devices.stop();
    // Their last words are not recorded any more: the session is whole.
    drop(events);
    devices.join();
    recorded?;
    status.state = "ended";
    Ok(json!(status))
}

struct Agent<'a> {
    options: &'a RecordOptions,
    lens: LensParameters,
    /// UTC minus monotonic clock.
    clock_ns: i64,
    devices: Devices,
    control: Control,
    names: Names,
    messages: Messages,
    session: Option<Pipeline>,
    tags: Option<Receiver<FrameTag>>,
    heard: Expected,
    status: Status,
    meters: Meters,
    last_log_ns: i64,
    noted_ns: i64,
    fed_rounds: u64,
    told: Told,
    /// What was left of earlier sessions, as it is found.
    repairs: Receiver<String>,
}

/// What people have heard of the recorder, and when.
#[derive(Default)]
struct Told {
    at: Option<Instant>,
    recorder: RecorderStatus,
}

impl<'a> Agent<'a> {
    fn new(
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
            tags: None,
            heard: Expected::default(),
            status: Status::default(),
            meters: Meters::default(),
            last_log_ns: i64::MIN,
            noted_ns: i64::MIN,
            fed_rounds: 0,
            told: Told::default(),
            repairs,
        }
    }

    fn run(
        &mut self,
        events: &Receiver<DeviceEvent>,
        stop: &AtomicBool,
        say: &mut dyn FnMut(&str),
    ) -> Result<(), RecordError> {
        let listened = Instant::now();
        while listened.elapsed() < LISTEN && !stop.load(Ordering::Relaxed) {
            self.step(events, say)?;
        }
        let began = self.begin(say);
        let went_on = began.and_then(|()| {
            // Only a supervisor that asked for it is told.
            let _ = sd_notify::notify(&[sd_notify::NotifyState::Ready]);
            while !stop.load(Ordering::Relaxed) {
                self.step(events, say)?;
                self.feed_watchdog();
            }
            Ok(())
        });
        let _ = sd_notify::notify(&[sd_notify::NotifyState::Stopping]);
        self.end(say);
        went_on
    }

    /// Whatever comes next, or the tick.
    fn step(&mut self, events: &Receiver<DeviceEvent>, say: &mut dyn FnMut(&str)) -> Result<(), RecordError> {
        match events.recv_timeout(TICK) {
            Ok(event) => self.take(event, say)?,
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => std::thread::sleep(TICK),
        }
        while let Ok(order) = self.control.orders.try_recv() {
            self.obey(order, say)?;
        }
        if let Some(tags) = &self.tags {
            for tag in tags.try_iter() {
                self.control.tell(&tag);
                self.status.tagged(&tag);
                self.meters.tagged(&tag);
                self.devices.send(&tag, self.clock_ns);
            }
        }
        self.tell_of_the_recorder(say);
        for said in self.repairs.try_iter() {
            say(&said);
            self.status.repaired.push(said);
        }
        self.note_status()
    }

    fn take(&mut self, event: DeviceEvent, say: &mut dyn FnMut(&str)) -> Result<(), RecordError> {
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
                self.status.camera = json!(camera);
                self.status.camera_lost = None;
            }
            DeviceEvent::CameraLost { cause, said } => {
                say(&format!("{said}; it is tried again"));
                self.status.camera_lost = Some(cause);
                self.note("camera", cause, &said)?;
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
                    self.note("camera", "recovered", "frames again")?;
                }
                self.status.stamp_clock = Some(clock);
                self.log(message)?;
            }
            DeviceEvent::Port { device, event } => self.take_port(&device, event, say)?,
        }
        Ok(())
    }

    fn take_port(&mut self, device: &str, event: PortEvent, say: &mut dyn FnMut(&str)) -> Result<(), RecordError> {
        match event {
            PortEvent::Opened { low_latency } => {
                if low_latency == Some(false) {
                    say(&format!("{device}: its driver holds bytes back, and may not be told otherwise (udev rules)"));
                }
                self.status.port_is(device, None);
            }
            PortEvent::Lost(error) => {
                let said = error.to_string();
                if self.status.port_is(device, Some(said.clone())) {
                    say(&format!("{said}; it is tried again"));
                    self.note("serial", "lost", &said)?;
                }
            }
            PortEvent::Status(line) => self.status.line_is(device, line),
            PortEvent::Measured(measured) => {
                self.heard.imu |= matches!(measured.content, Content::Attitude(_));
                self.heard.joints |= matches!(measured.content, Content::Head(_));
                if self.session.is_some() {
                    let stamp_ns = measured.stamp_ns.saturating_add(self.clock_ns);
                    if let Some(message) = self.messages.measured(stamp_ns, &measured.content, &self.names) {
                        self.log(message)?;
                    }
                }
            }
        }
        Ok(())
    }

    /// A session begins: what does not change comes first.
    fn begin(&mut self, say: &mut dyn FnMut(&str)) -> Result<(), RecordError> {
        if self.session.is_some() {
            return Ok(());
        }
        let now_ns = self.now_ns();
        let (setup, constants) = setup(self.options, &self.lens, now_ns, self.heard)?;
        let warm = if self.options.warm_start { last_state(&self.options.captures) } else { Ok(None) };
        let warm = warm.unwrap_or_else(|error| {
            say(&format!("{error}; the filter begins without it"));
            None
        });
        let (send, tags) = bounded(MAX_TAGS);
        let bytes_per_s = self.options.settings.capture.bytes_per_s((self.lens.width, self.lens.height));
        let recording = Recording {
            captures: self.options.captures.clone(),
            source: None,
            threads: self.options.threads,
            live: Some(LiveInfo {
                robot_id: Some(robot_id()),
                utc_offset_ns: self.clock_ns,
                camera_delay_ns: (self.options.settings.capture.delay_ms * 1e6) as i64,
                camera: self.status.camera.clone(),
            }),
            tags: Some(send),
            writing: Writing::Behind { bytes_per_s },
        };
        self.session = Some(Pipeline::new(setup, Start { warm, ..Start::default() }, recording));
        self.tags = Some(tags);
        self.status.state = "recording";
        let [transforms, info] = constants;
        self.log(transforms)?;
        self.log(info)?;
        if let Some(initial) = &self.options.initial {
            let message = initial_pose(now_ns, initial, &self.names.frames);
            let message = self.messages.message(&self.names.topics.initial_pose.clone(), false, &message);
            self.log(message)?;
        }
        self.told = Told::default();
        Ok(())
    }

    /// Where it is recorded, and what the disk does, as soon as it is known.
    fn tell_of_the_recorder(&mut self, say: &mut dyn FnMut(&str)) {
        if self.told.at.is_some_and(|at| at.elapsed() < TICK) {
            return;
        }
        let Some((_, recorder)) = self.session.as_ref().and_then(Pipeline::recorder) else { return };
        if let (None, Some(folder)) = (&self.told.recorder.session, &recorder.session) {
            say(&format!("recording {}", folder.display()));
        }
        let before = &self.told.recorder;
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
        self.told = Told { at: Some(Instant::now()), recorder };
    }

    /// The session becomes a whole capture, as far as the disk lets it: what it does not, `repair` does later.
    fn end(&mut self, say: &mut dyn FnMut(&str)) {
        self.refresh();
        let Some(session) = self.session.take() else { return };
        let (recorded, ended) = session.finish();
        if let Some(Recorded { session, counts, recorder, warnings, .. }) = recorded {
            for warning in warnings {
                say(&format!("warning: {warning}"));
            }
            say(&format!("recorded {}", session.display()));
            self.status.session = Some(session);
            self.status.counts = counts;
            self.status.recorder = recorder;
        }
        if let Err(error) = ended {
            say(&format!(
                "the session is not whole: {error}; the next start or `realitysim sessions repair` finishes it"
            ));
            self.status.unfinished = Some(error.to_string());
        }
        self.status.state = "stopped";
    }

    fn obey(&mut self, order: Order, say: &mut dyn FnMut(&str)) -> Result<(), RecordError> {
        let done = match order.what {
            Ask::Status => {
                self.refresh();
                let grid = self.session.as_ref().map(|session| session.coverage().clone());
                self.status.coverage = grid.map(|grid| CoverageStatus { map: grid.text(), grid });
                Ok(json!(self.status))
            }
            Ask::Mark(text) => self.note("mark", "mark", &text).map(|()| json!({ "marked": text })),
            Ask::Start => self.begin(say).map(|()| json!({ "state": self.status.state })),
            Ask::Stop => {
                self.end(say);
                let Status { state, session, unfinished, .. } = &self.status;
                Ok(json!({ "state": state, "session": session, "unfinished": unfinished }))
            }
        };
        let answer = match &done {
            Ok(value) => value.clone(),
            Err(error) => json!({ "error": error.to_string() }),
        };
        let _ = order.answer.try_send(answer);
        done.map(|_| ())
    }

    /// With the time at which it is taken: log times never go back.
    fn log(&mut self, mut message: LogMessage) -> Result<(), RecordError> {
        let Some(session) = &mut self.session else { return Ok(()) };
        let now_ns = (self.clock_ns + monotonic_ns()).max(self.last_log_ns);
        self.last_log_ns = now_ns;
        (message.log_time_ns, message.publish_time_ns) = (now_ns, now_ns);
        Ok(session.take(message)?)
    }

    fn note(&mut self, about: &str, what: &str, said: &str) -> Result<(), RecordError> {
        let report = status::note(self.now_ns(), &self.options.settings.robot, about, what, said);
        self.write_report(&report)
    }

    fn note_status(&mut self) -> Result<(), RecordError> {
        let now_ns = self.now_ns();
        if now_ns.saturating_sub(self.noted_ns) < STATUS_EVERY_NS {
            return Ok(());
        }
        self.noted_ns = now_ns;
        self.refresh();
        self.meters.counted(now_ns, &self.status.counts);
        let report = self.status.diagnostics(now_ns, &self.options.settings.robot);
        self.write_report(&report)
    }

    fn write_report(&mut self, report: &crate::ros2::messages::DiagnosticArray) -> Result<(), RecordError> {
        let log_time_ns = self.now_ns().max(self.last_log_ns);
        self.last_log_ns = log_time_ns;
        match &mut self.session {
            Some(session) => Ok(session.note(log_time_ns, report)?),
            None => Ok(()),
        }
    }

    fn refresh(&mut self) {
        if let Some((counts, recorder)) = self.session.as_ref().and_then(Pipeline::recorder) {
            self.status.session.clone_from(&recorder.session);
            (self.status.counts, self.status.recorder) = (counts, recorder);
        }
        let status = &mut self.status;
        status.camera_waiting = self.devices.waiting.load(Ordering::Relaxed);
        status.rates = self.meters.rates();
        status.budget = self.meters.budget(self.options.settings.filter.budget_ms);
        status.validity = self.meters.validity();
        let republished = &self.devices.republished;
        status.republished = self.options.settings.capture.republish.as_ref().map(|device| PassedOn {
            device: device.clone(),
            passed: republished.passed(),
            missed: republished.missed(),
            lost: republished.lost(),
        });
    }

    /// The camera's thread goes round, and this one, which writes, does too.
    fn feed_watchdog(&mut self) {
        let rounds = self.devices.rounds.load(Ordering::Relaxed);
        if rounds != self.fed_rounds {
            self.fed_rounds = rounds;
            let _ = sd_notify::notify(&[sd_notify::NotifyState::Watchdog]);
        }
    }

    fn now_ns(&self) -> i64 {
        self.clock_ns.saturating_add(monotonic_ns())
    }
}

fn lens(settings: &Settings) -> Result<LensParameters, RecordError> {
    let file = settings.camera.lens.as_ref().ok_or(RecordError::NoLens)?;
    Ok(load_lens(file)?.lens.parameters().clone())
}

/// What a crash has left of earlier sessions is finished beside the recording, which does not wait for it.
fn repair_in_the_background(captures: &Path) -> Receiver<String> {
    let (send, repairs) = bounded(MAX_REPAIRS_TOLD);
    // Those that are there before this one begins.
    let sessions = sessions_of(&Disk, captures);
    std::thread::spawn(move || {
        for session in sessions {
            let said = match repair(&Disk, &session) {
                Ok(repaired) if repaired.in_use || repaired.changed_nothing() => continue,
                Ok(repaired) => repaired.to_string(),
                Err(error) => format!("an earlier session is not whole, and cannot be repaired: {error}"),
            };
            // Who has no time to hear it can ask `sessions repair`.
            let _ = send.try_send(said);
        }
    });
    repairs
}

/// As the prelude of a log that begins with these constants, which come along.
fn setup(
    options: &RecordOptions,
    lens: &LensParameters,
    now_ns: i64,
    expected: Expected,
) -> Result<(Setup, [LogMessage; 2]), RecordError> {
    let settings = &options.settings;
    let height = settings.mount.torso_height_m.ok_or(RecordError::NoMount)?;
    let topics = settings.topics.clone();
    let constants: TFMessage = transforms(now_ns, height, &settings.mount, &settings.frames);
    let info: CameraInfo = camera_info_of(lens, header(now_ns, &settings.frames.camera_optical));
    let mut messages = Messages::default();
    let constants = messages.message(&topics.tf_static, true, &constants);
    let calibration = messages.message(&topics.camera_info, true, &info);
    let mut synchroniser = Synchroniser::new(settings.frames.clone(), SynchroniserState::default());
    if let Ok(input @ Input::Transforms { .. }) = intake::read(&constants, &topics, &settings.head) {
        synchroniser.push(&constants, input);
    }
    synchroniser.check_mount(false).map_err(SetupError::from)?;
    let attitude = AttitudeSource { topic: topics.imu.clone(), all: vec![topics.imu.clone()] };
    let prelude =
        Prelude { topics, camera_info: Some(info), synchroniser: synchroniser.state().clone(), expected, attitude };
    Ok((Setup::new(settings.clone(), prelude)?, [constants, calibration]))
}

/// A flag that is set by SIGINT and SIGTERM.
pub fn stop_flag() -> std::io::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        // A second one ends at once.
        signal_hook::flag::register_conditional_default(signal, Arc::clone(&stop))?;
        signal_hook::flag::register(signal, Arc::clone(&stop))?;
    }
    Ok(stop)
}
