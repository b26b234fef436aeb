//! Live recorder of a robot: reads devices, runs the same pipeline as a replay, writes a capture.

mod control;
mod control_clients;
mod devices;
mod event_loop;
mod messages;
mod notifications;
mod port_events;
mod rates;
mod remote;
mod session_control;
mod status;
#[cfg(feature = "live")]
mod viewer_connections;
#[cfg(feature = "live")]
mod viewer_server;
mod watchdog;
mod watched_frame;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crossbeam_channel::{Receiver, bounded};
use thiserror::Error;

pub use control::{ask, poses};
pub use port_events::Port;
pub use remote::{RemoteRecorder, RemoteSocket, WatchedRecorder};
pub use status::{LastTag, RecorderState, Status};
#[cfg(feature = "live")]
pub use viewer_server::ViewerServer;
pub use watched_frame::WatchedFrame;

use crate::config::{ConfigError, Settings, load_lens};
use crate::devices::host_clock::{monotonic_ns, utc_offset_ns};
use crate::geometry::{LensError, LensParameters, Pose2};
use crate::log_input::synchroniser::Expected;
use crate::recording::storage::Disk;
use crate::recording::{repair, session_holding, sessions_of};
use crate::tagging::error::AgentError;
use crate::tagging::setup::SetupError;
use control::Control;
use devices::{Devices, channel};
use event_loop::LiveRecorder;
use session_control::setup;

/// What `realitysim record` is asked to do.
#[derive(Clone, Debug)]
pub struct RecordOptions {
    pub captures: PathBuf,
    pub settings: Settings,
    /// Announced pose of `base_footprint` in `map` at the start.
    pub initial: Option<Pose2>,
    pub threads: usize,
    /// Go on from the filter state that the last recorder left behind.
    pub warm_start: bool,
    /// Path of the control socket.
    pub socket: PathBuf,
}

/// Why a recording cannot begin or go on.
#[derive(Debug, Error)]
pub enum RecordError {
    #[error("mount.torso_height_m is not set: `record` must know where the camera is (docs/howto/robot.md)")]
    NoMount,
    #[error("camera.lens is not set: `record` must know the camera's lens and size (docs/howto/robot.md)")]
    NoLens,
    #[error("{captures}: the folder belongs to the capture {session}: name another with --output")]
    IntoCapture { captures: PathBuf, session: PathBuf },
    #[error(transparent)]
    Config(#[from] ConfigError),
    #[error("camera.fov_deg: {0}")]
    Fov(#[from] LensError),
    #[error(transparent)]
    Setup(#[from] SetupError),
    #[error("{path}: {source} (--socket PATH makes it elsewhere)")]
    Socket { path: PathBuf, source: std::io::Error },
    #[error(transparent)]
    Agent(#[from] AgentError),
}

/// Messages about repaired sessions that can wait for the event loop.
const MAX_REPAIRS_TOLD: usize = 64;

/// Records until `stop` and returns the last status. `say` gets messages for people as they come up.
pub fn record(options: &RecordOptions, stop: &AtomicBool, say: &mut dyn FnMut(&str)) -> Result<Status, RecordError> {
    if let Some(session) = session_holding(&options.captures) {
        return Err(RecordError::IntoCapture { captures: options.captures.clone(), session });
    }
    let lens = configured_lens(&options.settings)?;
    let clock_ns = utc_offset_ns();
    let (send, events) = channel();
    let control = Control::listen(&options.socket)
        .map_err(|source| RecordError::Socket { path: options.socket.clone(), source })?;
    // A wrong setup is refused before a device is touched.
    setup(options, &lens, clock_ns + monotonic_ns(), Expected::default())?;
    let repairs = repair_in_the_background(&options.captures);
    let devices = Devices::start(&options.settings, (lens.width, lens.height), clock_ns, &send);
    drop(send);
    let mut recorder = LiveRecorder::new(options, lens, clock_ns, devices, control, repairs);
    let recorded = recorder.run(&events, stop, say);
    let LiveRecorder { devices, mut status, .. } = recorder;
    devices.stop();
    // Events that arrive from here on are not recorded: the session has ended.
    drop(events);
    devices.join();
    recorded?;
    status.state = RecorderState::Ended;
    Ok(status)
}

/// Parameters of the configured lens.
fn configured_lens(settings: &Settings) -> Result<LensParameters, RecordError> {
    let file = settings.camera.lens.as_ref().ok_or(RecordError::NoLens)?;
    Ok(load_lens(file)?.lens.parameters().clone())
}

/// Repairs earlier sessions that a crash left unfinished, in a thread of its own, and returns its messages.
fn repair_in_the_background(captures: &Path) -> Receiver<String> {
    let (send, repairs) = bounded(MAX_REPAIRS_TOLD);
    // Listed here, so that the session about to begin is not among them.
    let sessions = sessions_of(&Disk, captures);
    std::thread::spawn(move || {
        for session in sessions {
            let said = match repair(&Disk, &session) {
                Ok(repaired) if repaired.in_use || repaired.changed_nothing() => continue,
                Ok(repaired) => repaired.to_string(),
                Err(error) => format!("an earlier session is not whole, and cannot be repaired: {error}"),
            };
            // A message that finds no room is dropped; `sessions repair` shows the same.
            let _ = send.try_send(said);
        }
    });
    repairs
}

/// Returns a flag that SIGINT and SIGTERM set. A second signal ends the process at once.
pub fn stop_flag() -> std::io::Result<Arc<AtomicBool>> {
    let (stop, end_at_once) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        // `end_at_once` becomes true some time after the first signal; from then on a signal has its default effect.
        signal_hook::flag::register_conditional_default(signal, Arc::clone(&end_at_once))?;
        signal_hook::flag::register(signal, Arc::clone(&stop))?;
    }
    let stopped = Arc::clone(&stop);
    std::thread::spawn(move || {
        while !stopped.load(Ordering::Relaxed) {
            std::thread::sleep(SIGNAL_GROUPING_TIME / 4);
        }
        std::thread::sleep(SIGNAL_GROUPING_TIME);
        end_at_once.store(true, Ordering::Relaxed);
    });
    Ok(stop)
}

/// Signals within this time count as one: `timeout` and a terminal may send theirs to the process and to its group.
const SIGNAL_GROUPING_TIME: Duration = Duration::from_millis(200);
