//! What is asked of the kernel.

use std::collections::BTreeMap;
use std::io;
use std::path::Path;
use std::time::Duration;

use serde::Serialize;
use thiserror::Error;

use crate::permission;
use realitysim_config::CaptureSettings;

/// Formats that can be recorded, best first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum PixelFormat {
    Mjpeg,
    Yuyv,
    Nv12,
    Grey,
    BayerRggb,
    BayerBggr,
    BayerGbrg,
    BayerGrbg,
}

impl PixelFormat {
    pub const ALL: [Self; 8] = [
        Self::Mjpeg,
        Self::Yuyv,
        Self::Nv12,
        Self::Grey,
        Self::BayerRggb,
        Self::BayerBggr,
        Self::BayerGbrg,
        Self::BayerGrbg,
    ];

    /// As in `videodev2.h`.
    pub fn fourcc(self) -> &'static str {
        match self {
            Self::Mjpeg => "MJPG",
            Self::Yuyv => "YUYV",
            Self::Nv12 => "NV12",
            Self::Grey => "GREY",
            Self::BayerRggb => "RGGB",
            Self::BayerBggr => "BA81",
            Self::BayerGbrg => "GBRG",
            Self::BayerGrbg => "GRBG",
        }
    }

    pub fn of_fourcc(fourcc: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.fourcc() == fourcc)
    }

    /// Of a whole frame with this many bytes a row; none of a compressed one.
    pub fn frame_bytes(self, stride: u32, height: u32) -> Option<usize> {
        let (stride, height) = (stride as usize, height as usize);
        match self {
            Self::Mjpeg => None,
            Self::Nv12 => Some(stride * height + stride * height.div_ceil(2)),
            _ => Some(stride * height),
        }
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct CameraOptions {
    pub device: String,
    /// Exactly: the lens was calibrated at this size.
    pub width: u32,
    pub height: u32,
    /// None: the first of [`PixelFormat::ALL`] that the camera has.
    pub format: Option<PixelFormat>,
    pub rate_hz: f64,
    /// By their names as `v4l2-ctl --list-ctrls` shows them.
    pub controls: BTreeMap<String, i64>,
}

impl CameraOptions {
    /// As configured, for a lens of this size.
    pub fn new(capture: &CaptureSettings, (width, height): (u32, u32)) -> Self {
        Self {
            device: capture.device.clone(),
            width,
            height,
            format: capture.format.as_deref().and_then(PixelFormat::of_fourcc),
            rate_hz: capture.rate_hz,
            controls: capture.controls.clone(),
        }
    }
}

/// What the camera agreed to, read back.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Negotiated {
    pub card: String,
    pub bus: String,
    pub format: PixelFormat,
    pub width: u32,
    pub height: u32,
    /// Bytes a row, where the format has rows.
    pub stride: u32,
    /// None where the driver does not say.
    pub rate_hz: Option<f64>,
    pub controls: BTreeMap<String, i64>,
    /// Controls that it does not have or did not take, and why.
    pub refused: Vec<String>,
}

/// Of one filled buffer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BufferInfo {
    pub sequence: u32,
    pub stamp_ns: i64,
    /// The stamp is of CLOCK_MONOTONIC.
    pub is_monotonic: bool,
    /// The stamp is of the start of the exposure, not of the end of the frame.
    pub is_start_of_exposure: bool,
    /// The driver says that the pixels are damaged.
    pub is_damaged: bool,
}

#[derive(Debug, Error)]
pub enum CameraError {
    #[error("{device}: no such camera; present are {present}")]
    Missing { device: String, present: String },
    #[error("{device}: no permission: {}", permission::remedy(Path::new(device), "video"))]
    Permission { device: String },
    #[error("{device}: another program streams from it; a camera streams to one program only")]
    Busy { device: String },
    #[error("{device} has no {wanted}; it offers {offers}")]
    Format { device: String, wanted: String, offers: String },
    #[error("{device} is no camera that streams; present are {present}")]
    NoCapture { device: String, present: String },
    #[error("{device}: there is no folder {folder} for the socket: make it, or name another")]
    NoFolder { device: String, folder: String },
    #[error("{device}: something is there that is no socket: it is left alone; name another place")]
    NoSocket { device: String },
    #[error("{device}: this program was built without the feature v4l2")]
    NotBuilt { device: String },
    #[error("{device} went away")]
    Unplugged { device: String },
    #[error("{device} is open and sends nothing")]
    Stalled { device: String },
    #[error("{device}: {source}")]
    Io { device: String, source: io::Error },
}

impl CameraError {
    /// In counts and logs.
    pub fn cause(&self) -> &'static str {
        match self {
            Self::Missing { .. } => "missing",
            Self::Permission { .. } => "no_permission",
            Self::Busy { .. } => "busy",
            Self::Format { .. } => "format",
            Self::NoCapture { .. } => "no_capture",
            Self::NoFolder { .. } => "no_folder",
            Self::NoSocket { .. } => "no_socket",
            Self::NotBuilt { .. } => "not_built",
            Self::Unplugged { .. } => "unplugged",
            Self::Stalled { .. } => "stalled",
            Self::Io { .. } => "io",
        }
    }

    /// What the kernel means by an error of an open device.
    pub fn of_io(device: &str, source: io::Error) -> Self {
        let device = device.to_owned();
        if source.kind() == io::ErrorKind::TimedOut {
            return Self::Stalled { device };
        }
        match source.raw_os_error().map(rustix::io::Errno::from_raw_os_error) {
            Some(rustix::io::Errno::NODEV | rustix::io::Errno::NXIO) => Self::Unplugged { device },
            Some(rustix::io::Errno::BUSY | rustix::io::Errno::ADDRINUSE) => Self::Busy { device },
            Some(rustix::io::Errno::ACCESS | rustix::io::Errno::PERM) => Self::Permission { device },
            _ => Self::Io { device, source },
        }
    }
}

/// One camera. Calls come in the order open, (wait, take)*, close, and again.
pub trait Driver {
    /// Opens, negotiates, sets the controls and starts the stream.
    fn open(&mut self, wanted: &CameraOptions) -> Result<Negotiated, CameraError>;
    /// Whether a filled buffer is there before the time is over.
    fn wait(&mut self, timeout: Duration) -> io::Result<bool>;
    /// The oldest filled buffer's used bytes, in place of what `into` holds.
    fn take(&mut self, into: &mut Vec<u8>) -> io::Result<BufferInfo>;
    /// Never fails: there may be nothing left to close.
    fn close(&mut self);
}

impl<D: Driver + ?Sized> Driver for Box<D> {
    fn open(&mut self, wanted: &CameraOptions) -> Result<Negotiated, CameraError> {
        (**self).open(wanted)
    }

    fn wait(&mut self, timeout: Duration) -> io::Result<bool> {
        (**self).wait(timeout)
    }

    fn take(&mut self, into: &mut Vec<u8>) -> io::Result<BufferInfo> {
        (**self).take(into)
    }

    fn close(&mut self) {
        (**self).close();
    }
}
