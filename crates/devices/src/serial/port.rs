//! The rim: a port that is opened, read, and opened again when it goes away.

use std::io::{self, IsTerminal, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crossbeam_channel::Receiver;
use serialport::{ErrorKind, TTYPort};
use thiserror::Error;

use super::latency::lower_latency;
use super::line::{Line, LineStatus, Measured, Pose};
use crate::host_clock::monotonic_ns;
use crate::permission;

#[derive(Clone, Debug)]
pub struct PortOptions {
    pub device: String,
    pub baud: u32,
    /// MAVLink's number of the robot.
    pub system: u8,
    /// Poses that are to be sent on this port; what comes while it is not open is left out.
    pub poses: Option<Receiver<Pose>>,
}

#[derive(Debug, Error)]
pub enum SerialError {
    #[error("{device}: no such device; present are {present}")]
    Missing { device: String, present: String },
    #[error("{device}: no permission: {}", permission::remedy(Path::new(device), "dialout"))]
    Permission { device: String },
    #[error("{device} is no serial port; present are {present}")]
    NoPort { device: String, present: String },
    #[error("{device}: another program has it open")]
    Busy { device: String },
    #[error("{device} at {baud} baud: {source}")]
    Open { device: String, baud: u32, source: serialport::Error },
    #[error("{device} went away: {source}")]
    Gone { device: String, source: io::Error },
}

#[derive(Debug)]
pub enum PortEvent {
    /// Whether the driver's own waiting could be turned off, where it has such a thing.
    Opened {
        low_latency: Option<bool>,
    },
    /// Could not be opened, or went away; it is tried again.
    Lost(SerialError),
    Measured(Measured),
    /// Once a second, and once more at the end.
    Status(LineStatus),
}

/// How long a read waits: so late a stop is noticed at most, and a question sent.
const READ_TIMEOUT: Duration = Duration::from_millis(20);
const FIRST_RETRY: Duration = Duration::from_millis(100);
const MAX_RETRY: Duration = Duration::from_secs(2);
const STATUS_EVERY: Duration = Duration::from_secs(1);

/// Until `stop`: every measurement of the port, and what becomes of the port.
pub fn run(options: &PortOptions, stop: &AtomicBool, mut tell: impl FnMut(PortEvent)) {
    let mut line = Line::new(options.system, byte_ns(options));
    let mut retry = FIRST_RETRY;
    while !stop.load(Ordering::Relaxed) {
        match open(options) {
            Ok(port) => {
                tell(PortEvent::Opened { low_latency: lower_latency(&port, &options.device) });
                retry = FIRST_RETRY;
                let ended = read(port, &mut line, options.poses.as_ref(), stop, &mut tell);
                line.interrupted();
                if let Err(source) = ended {
                    tell(PortEvent::Lost(SerialError::Gone { device: options.device.clone(), source }));
                }
            }
            Err(error) => tell(PortEvent::Lost(error)),
        }
        pause(retry, stop);
        retry = (retry * 2).min(MAX_RETRY);
    }
    tell(PortEvent::Status(line.status()));
}

fn read(
    mut port: TTYPort,
    line: &mut Line,
    poses: Option<&Receiver<Pose>>,
    stop: &AtomicBool,
    tell: &mut impl FnMut(PortEvent),
) -> io::Result<()> {
    let mut buffer = [0; 4096];
    let mut told = Instant::now();
    // Of a time when nobody could be told.
    poses.into_iter().flat_map(Receiver::try_iter).for_each(drop);
    while !stop.load(Ordering::Relaxed) {
        match port.read(&mut buffer) {
            Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(count) => line.push(&buffer[..count], monotonic_ns(), |measured| tell(PortEvent::Measured(measured))),
            Err(error) if matches!(error.kind(), io::ErrorKind::TimedOut | io::ErrorKind::Interrupted) => {}
            Err(error) => return Err(error),
        }
        let mut due = line.due(monotonic_ns());
        for pose in poses.into_iter().flat_map(Receiver::try_iter) {
            due.extend(line.pose(&pose));
        }
        if !due.is_empty() {
            match port.write_all(&due) {
                // Nobody takes our questions: the arrivals must do.
                Err(error) if error.kind() == io::ErrorKind::TimedOut => line.was_not_taken(),
                written => written?,
            }
        }
        if told.elapsed() >= STATUS_EVERY {
            told = Instant::now();
            tell(PortEvent::Status(line.status()));
        }
    }
    Ok(())
}

fn open(options: &PortOptions) -> Result<TTYPort, SerialError> {
    let device = options.device.clone();
    serialport::new(device.as_str(), options.baud).timeout(READ_TIMEOUT).open_native().map_err(|source| {
        let exists = Path::new(&device).exists();
        match source.kind() {
            ErrorKind::Io(io::ErrorKind::PermissionDenied) => SerialError::Permission { device },
            _ if !exists => SerialError::Missing { device, present: present() },
            _ if is_another_thing(&device) => SerialError::NoPort { device, present: present() },
            ErrorKind::NoDevice | ErrorKind::Io(io::ErrorKind::ResourceBusy) => SerialError::Busy { device },
            _ => SerialError::Open { device, baud: options.baud, source },
        }
    })
}

/// A file, a folder or a device that is no terminal. A port that cannot be opened may be one.
fn is_another_thing(device: &str) -> bool {
    let flags = (rustix::fs::OFlags::NOCTTY | rustix::fs::OFlags::NONBLOCK).bits() as i32;
    let opened = std::fs::OpenOptions::new().read(true).custom_flags(flags).open(device);
    opened.is_ok_and(|file| !file.is_terminal())
}

fn present() -> String {
    let ports = serialport::available_ports().unwrap_or_default();
    let names: Vec<String> = ports.into_iter().map(|port| port.port_name).take(16).collect();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

/// Start, eight bits, stop. On USB with a protocol of its own and on a pty the baud rate means nothing.
fn byte_ns(options: &PortOptions) -> i64 {
    let device = std::fs::canonicalize(&options.device).unwrap_or_default();
    let device = device.to_string_lossy();
    if device.contains("ttyACM") || device.contains("/pts/") {
        return 0;
    }
    10_000_000_000 / i64::from(options.baud.max(1))
}

fn pause(time: Duration, stop: &AtomicBool) {
    let end = Instant::now() + time;
    while !stop.load(Ordering::Relaxed) && Instant::now() < end {
        std::thread::sleep(READ_TIMEOUT.min(end.saturating_duration_since(Instant::now())));
    }
}
