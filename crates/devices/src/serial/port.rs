//! Opens and reads a serial port, and opens it again when it goes away.

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

/// The port to read.
#[derive(Clone, Debug)]
pub struct PortOptions {
    /// Path of the device.
    pub device: String,
    /// Baud rate, bits per second.
    pub baud: u32,
    /// MAVLink's number of the robot.
    pub system: u8,
    /// Poses to be sent on this port; those that come while it is not open are dropped.
    pub poses: Option<Receiver<Pose>>,
}

/// Why a port cannot be opened, or was lost.
#[derive(Debug, Error)]
pub enum SerialError {
    /// There is no such device.
    #[error("{device}: no such device; present are {present}")]
    Missing {
        /// The device.
        device: String,
        /// The ports that there are.
        present: String,
    },
    /// The user may not open it.
    #[error("{device}: no permission: {}", permission::remedy(Path::new(device), "dialout"))]
    Permission {
        /// The device.
        device: String,
    },
    /// It is something else than a serial port.
    #[error("{device} is no serial port; present are {present}")]
    NoPort {
        /// The device.
        device: String,
        /// The ports that there are.
        present: String,
    },
    /// Another program has it open.
    #[error("{device}: another program has it open")]
    Busy {
        /// The device.
        device: String,
    },
    /// Any other error at opening.
    #[error("{device} at {baud} baud: {source}")]
    Open {
        /// The device.
        device: String,
        /// Baud rate, bits per second.
        baud: u32,
        /// The reason.
        source: serialport::Error,
    },
    /// The open port went away.
    #[error("{device} went away: {source}")]
    Gone {
        /// The device.
        device: String,
        /// What the operating system says.
        source: io::Error,
    },
}

/// What happens to a port.
#[derive(Debug)]
pub enum PortEvent {
    /// It was opened.
    Opened {
        /// Whether the driver could be set to low latency; `None` if it has no such setting.
        low_latency: Option<bool>,
    },
    /// It could not be opened, or went away; it will be opened again.
    Lost(SerialError),
    /// A device measured something.
    Measured(Measured),
    /// The state of the line, once a second, and once more at the end.
    Status(LineStatus),
}

/// Longest wait of a read, and so the longest delay of a stop or a question.
const READ_TIMEOUT: Duration = Duration::from_millis(20);
/// Time until the port is opened again; it doubles with each failure.
const FIRST_RETRY: Duration = Duration::from_millis(100);
/// Longest time between two tries to open the port.
const MAX_RETRY: Duration = Duration::from_secs(2);
/// Time between two reports of the line's state.
const STATUS_EVERY: Duration = Duration::from_secs(1);

/// Reads a port until `stop` is set. `tell` gets every measurement and what happens to the port.
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

/// Reads an open port until `stop` is set or the port fails, and sends what is due.
fn read(
    mut port: TTYPort,
    line: &mut Line,
    poses: Option<&Receiver<Pose>>,
    stop: &AtomicBool,
    tell: &mut impl FnMut(PortEvent),
) -> io::Result<()> {
    let mut buffer = [0; 4096];
    let mut told = Instant::now();
    // Poses of the time when the port was not open are dropped.
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
                // The device takes no questions: its clock is then known from arrivals only.
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

/// Opens the port.
fn open(options: &PortOptions) -> Result<TTYPort, SerialError> {
    let device = options.device.clone();
    serialport::new(device.as_str(), options.baud).timeout(READ_TIMEOUT).open_native().map_err(|source| {
        let exists = Path::new(&device).exists();
        match source.kind() {
            ErrorKind::Io(io::ErrorKind::PermissionDenied) => SerialError::Permission { device },
            _ if !exists => SerialError::Missing { device, present: present() },
            _ if is_not_a_terminal(&device) => SerialError::NoPort { device, present: present() },
            ErrorKind::NoDevice | ErrorKind::Io(io::ErrorKind::ResourceBusy) => SerialError::Busy { device },
            _ => SerialError::Open { device, baud: options.baud, source },
        }
    })
}

/// Returns whether the path is a file, a folder or a device, but no terminal. False if it cannot be opened.
fn is_not_a_terminal(device: &str) -> bool {
    let flags = (rustix::fs::OFlags::NOCTTY | rustix::fs::OFlags::NONBLOCK).bits() as i32;
    let opened = std::fs::OpenOptions::new().read(true).custom_flags(flags).open(device);
    opened.is_ok_and(|file| !file.is_terminal())
}

/// Lists the ports that there are, 16 at most.
fn present() -> String {
    let ports = serialport::available_ports().unwrap_or_default();
    let names: Vec<String> = ports.into_iter().map(|port| port.port_name).take(16).collect();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

/// Returns the time of a byte on the wire, nanoseconds: start bit, eight bits, stop bit.
///
/// It is 0 on USB CDC (ttyACM) and on a pseudoterminal, where the baud rate means nothing.
fn byte_ns(options: &PortOptions) -> i64 {
    let device = std::fs::canonicalize(&options.device).unwrap_or_default();
    let device = device.to_string_lossy();
    if device.contains("ttyACM") || device.contains("/pts/") {
        return 0;
    }
    10_000_000_000 / i64::from(options.baud.max(1))
}

/// Sleeps for a time, or until `stop` is set.
fn pause(time: Duration, stop: &AtomicBool) {
    let end = Instant::now() + time;
    while !stop.load(Ordering::Relaxed) && Instant::now() < end {
        std::thread::sleep(READ_TIMEOUT.min(end.saturating_duration_since(Instant::now())));
    }
}
