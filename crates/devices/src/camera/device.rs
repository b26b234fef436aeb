//! Drives a Video4Linux camera through the crate `v4l`, whose pitfalls are dealt with here.
//!
//! After a time-out or an error `next()` queues a buffer that is still queued, so it is called only when a buffer is ready, and a
//! stream that failed is not used again. The buffers are longer than what the camera wrote, so `bytesused` counts. `Drop` panics
//! when the kernel refuses to stop the stream, so such a stream is closed by its descriptor.

// The ioctls of Video4Linux need it.
#![allow(unsafe_code)]

use std::collections::BTreeMap;
use std::io;
use std::os::fd::{FromRawFd, OwnedFd};
use std::path::Path;
use std::time::Duration;

use v4l::buffer::{Flags, Type};
use v4l::capability::Flags as Capability;
use v4l::control::{Control, Value};
use v4l::io::mmap::Stream;
use v4l::io::traits::{CaptureStream, Stream as _};
use v4l::video::Capture;
use v4l::video::capture::Parameters;
use v4l::{Device, FourCC, Fraction};

use super::{BufferInfo, CameraError, CameraOptions, Driver, Negotiated, PixelFormat};

/// A Video4Linux camera.
#[derive(Default)]
pub struct V4l2 {
    open: Option<(Device, Stream<'static>)>,
    /// Whether a frame was asked for, which starts the stream.
    is_streaming: bool,
}

/// Number of buffers. One is in use by the recorder; the other three give it 100 ms at 30 frames a second.
const BUFFERS: u32 = 4;
/// Longest wait for the first frame of a stream. Later waits happen in [`Driver::wait`].
const FIRST_FRAME: Duration = Duration::from_secs(2);

impl Driver for V4l2 {
    fn open(&mut self, wanted: &CameraOptions) -> Result<Negotiated, CameraError> {
        let failed = |source| CameraError::of_io(&wanted.device, source);
        let no_capture = || CameraError::NoCapture { device: wanted.device.clone(), present: present() };
        let device = Device::with_path(&wanted.device).map_err(|source| match source.kind() {
            io::ErrorKind::NotFound => CameraError::Missing { device: wanted.device.clone(), present: present() },
            io::ErrorKind::IsADirectory => no_capture(),
            _ => failed(source),
        })?;
        let capabilities = device
            .query_caps()
            .ok()
            .filter(|known| known.capabilities.contains(Capability::VIDEO_CAPTURE | Capability::STREAMING))
            .ok_or_else(no_capture)?;
        let (format, negotiated) = negotiate(&device, wanted)?;
        let rate_hz = set_rate(&device, wanted.rate_hz);
        let (controls, refused) = set_controls(&device, wanted);
        // Asking for buffers fails if another program has them. The first `next()` starts the stream.
        let mut stream = Stream::with_buffers(&device, Type::VideoCapture, BUFFERS).map_err(failed)?;
        stream.set_timeout(FIRST_FRAME);
        self.open = Some((device, stream));
        self.is_streaming = false;
        Ok(Negotiated {
            card: capabilities.card,
            bus: capabilities.bus,
            format,
            width: negotiated.width,
            height: negotiated.height,
            stride: negotiated.stride,
            rate_hz,
            controls,
            refused,
        })
    }

    fn wait(&mut self, timeout: Duration) -> io::Result<bool> {
        let Some((_, stream)) = &self.open else { return Err(closed()) };
        // A stream that has not started cannot be polled: some drivers report an error, v4l2loopback never reports a frame.
        if !self.is_streaming {
            return Ok(true);
        }
        let milliseconds = i32::try_from(timeout.as_millis()).unwrap_or(i32::MAX);
        // An error makes the stream ready, too; taking the frame then returns it.
        Ok(stream.handle().poll(POLLIN, milliseconds)? > 0)
    }

    fn take(&mut self, into: &mut Vec<u8>) -> io::Result<BufferInfo> {
        let Some((_, stream)) = &mut self.open else { return Err(closed()) };
        self.is_streaming = true;
        let (bytes, meta) = stream.next()?;
        into.clear();
        into.extend_from_slice(&bytes[..bytes.len().min(meta.bytesused as usize)]);
        let stamp_ns = meta.timestamp.sec * 1_000_000_000 + meta.timestamp.usec * 1_000;
        Ok(BufferInfo {
            sequence: meta.sequence,
            stamp_ns,
            is_monotonic: meta.flags & Flags::TIMESTAMP_MASK == Flags::TIMESTAMP_MONOTONIC,
            is_start_of_exposure: meta.flags & Flags::TSTAMP_SRC_MASK == Flags::TSTAMP_SRC_SOE,
            is_damaged: meta.flags.contains(Flags::ERROR),
        })
    }

    fn close(&mut self) {
        let Some((device, mut stream)) = self.open.take() else { return };
        match stream.stop() {
            Ok(()) => drop(stream),
            Err(error) if error.raw_os_error() == Some(rustix::io::Errno::NODEV.raw_os_error()) => drop(stream),
            Err(_) => {
                let descriptor = device.handle().fd();
                std::mem::forget(stream);
                std::mem::forget(device);
                // SAFETY: stream and device, which shared the descriptor, were forgotten above, so nothing else closes it.
                // The buffers stay mapped, which costs a few megabytes for each such fault.
                drop(unsafe { OwnedFd::from_raw_fd(descriptor) });
            }
        }
    }
}

impl core::ops::Drop for V4l2 {
    fn drop(&mut self) {
        self.close();
    }
}

/// Bit of poll(2): there is something to read.
const POLLIN: i16 = 1;

/// Error of a camera that is not open.
fn closed() -> io::Error {
    io::Error::from(io::ErrorKind::NotConnected)
}

/// Sets the wanted size in the best format that the camera has, and checks what it then states.
fn negotiate(device: &Device, wanted: &CameraOptions) -> Result<(PixelFormat, v4l::Format), CameraError> {
    let failed = |source| CameraError::of_io(&wanted.device, source);
    let offered = device.enum_formats().map_err(failed)?;
    let offered: Vec<String> = offered.into_iter().map(|format| format.fourcc.to_string()).collect();
    let candidates = PixelFormat::ALL
        .into_iter()
        .filter(|format| wanted.format.is_none_or(|only| only == *format))
        .filter(|format| offered.iter().any(|fourcc| fourcc == format.fourcc()));
    let (width, height) = (wanted.width, wanted.height);
    for candidate in candidates {
        let mut code = [b' '; 4];
        code.copy_from_slice(candidate.fourcc().as_bytes());
        // The driver answers with the nearest format that it has.
        let got = device.set_format(&v4l::Format::new(width, height, FourCC::new(&code))).map_err(failed)?;
        if (got.width, got.height, got.fourcc.to_string().as_str()) == (width, height, candidate.fourcc()) {
            return Ok((candidate, got));
        }
    }
    let what = wanted.format.map_or("format that can be recorded", PixelFormat::fourcc);
    Err(CameraError::Format {
        device: wanted.device.clone(),
        wanted: format!("{what} of {width} x {height}, the size of its lens file"),
        offers: offers(&wanted.device),
    })
}

/// Says in a line what the camera offers.
fn offers(device: &str) -> String {
    crate::v4l2::offer(Path::new(device)).map_or_else(|_| "nothing".to_owned(), |offer| offer.summary())
}

/// Sets the frame rate, and returns the one that the driver states, Hz: some drivers keep a rate of their own.
fn set_rate(device: &Device, wanted_hz: f64) -> Option<f64> {
    let interval = Fraction::new(1_000, (wanted_hz * 1_000.0).round().max(1.0) as u32);
    let hertz = |p: Parameters| {
        (p.interval.numerator > 0).then(|| f64::from(p.interval.denominator) / f64::from(p.interval.numerator))
    };
    device.set_params(&Parameters::new(interval)).or_else(|_| Capture::params(device)).ok().and_then(hertz)
}

/// Sets the controls. Returns the values that the camera then states, and what it refused, with the reasons.
fn set_controls(device: &Device, wanted: &CameraOptions) -> (BTreeMap<String, i64>, Vec<String>) {
    let known = device.query_controls().unwrap_or_default();
    let find = |name: &str| known.iter().find(|control| control_name(&control.name) == name);
    let mut refused = Vec::new();
    // All are set twice, since one may depend on another: an exposure can be set only while the automatic exposure is off.
    for last in [false, true] {
        for (name, value) in &wanted.controls {
            let result = match find(name) {
                Some(control) => {
                    device.set_control(Control { id: control.id, value: Value::Integer(*value) }).map_err(|error| {
                        format!("{name} = {value}: {error} (from {} to {})", control.minimum, control.maximum)
                    })
                }
                None => Err(format!("{name}: the camera has no such control")),
            };
            if let (true, Err(why)) = (last, result) {
                refused.push(why);
            }
        }
    }
    let read = |name: &String| match device.control(find(name)?.id).ok()?.value {
        Value::Integer(value) => Some((name.clone(), value)),
        Value::Boolean(value) => Some((name.clone(), i64::from(value))),
        _ => None,
    };
    let controls: BTreeMap<String, i64> = wanted.controls.keys().filter_map(read).collect();
    // Some drivers accept a value out of range without an error, and change it to one that they can set.
    refused.extend(
        wanted
            .controls
            .iter()
            .filter_map(|(name, value)| {
                let (control, is) = (find(name)?, controls.get(name)?);
                let said = format!(
                    "{name} = {value}: the camera made it {is} (from {} to {})",
                    control.minimum, control.maximum
                );
                (is != value && !refused.iter().any(|why| why.starts_with(&format!("{name} = ")))).then_some(said)
            })
            .collect::<Vec<_>>(),
    );
    (controls, refused)
}

/// Returns a control's name as v4l2-ctl shows it: `Exposure Time, Absolute` becomes `exposure_time_absolute`.
fn control_name(name: &str) -> String {
    let words = name.split(|c: char| !c.is_ascii_alphanumeric()).filter(|word| !word.is_empty());
    words.map(str::to_ascii_lowercase).collect::<Vec<_>>().join("_")
}

/// Lists the video devices that there are, 16 at most.
fn present() -> String {
    let entries = std::fs::read_dir("/dev").into_iter().flatten().filter_map(Result::ok);
    let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
    let mut cameras: Vec<String> =
        names.filter(|name| name.starts_with("video")).map(|name| format!("/dev/{name}")).collect();
    cameras.sort();
    cameras.truncate(16);
    if cameras.is_empty() { "none".to_owned() } else { cameras.join(", ") }
}
