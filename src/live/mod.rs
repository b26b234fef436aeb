//! The agent on a robot: devices in, the same pipeline as a replay's, a capture out.

mod control;
mod control_clients;
mod devices;
mod event_loop;
mod messages;
mod notifications;
mod port_events;
mod rates;
mod session_control;
mod status;
mod watchdog;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crossbeam_channel::{Receiver, bounded};
use serde_json::{Value, json};
use thiserror::Error;

pub use control::{ask, poses};
pub use status::Status;

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
use event_loop::Agent;
use session_control::setup;

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
    #[error("{path}: {source} (--socket PATH makes it elsewhere)")]
    Socket { path: PathBuf, source: std::io::Error },
    #[error(transparent)]
    Agent(#[from] AgentError),
}

/// Repaired sessions that are told of.
const MAX_REPAIRS_TOLD: usize = 64;

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

/// A flag that is set by SIGINT and SIGTERM.
pub fn stop_flag() -> std::io::Result<Arc<AtomicBool>> {
    let (stop, again) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        // A second one ends at once.
        signal_hook::flag::register_conditional_default(signal, Arc::clone(&again))?;
        signal_hook::flag::register(signal, Arc::clone(&stop))?;
    }
    let stopped = Arc::clone(&stop);
    std::thread::spawn(move || {
        while !stopped.load(Ordering::Relaxed) {
            std::thread::sleep(ONE_WISH / 4);
        }
        std::thread::sleep(ONE_WISH);
        again.store(true, Ordering::Relaxed);
    });
    Ok(stop)
}

/// Signals within this time are one: `timeout` and a terminal may send theirs to the process and to its group.
const ONE_WISH: Duration = Duration::from_millis(200);
