//! The interface between the rules of capturing and a camera: options, what was negotiated, errors, and the driver itself.

use std::collections::BTreeMap;
use std::io;
use std::path::Path;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::permission;
use realitysim_config::CaptureSettings;

/// Pixel formats that can be recorded, best first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PixelFormat {
    /// A JPEG for each frame.
    Mjpeg,
    /// Two pixels in four bytes: Y U Y V.
    Yuyv,
    /// A plane of Y, then one of U V pairs for each two by two pixels.
    Nv12,
    /// Gray, 8 bits.
    Grey,
    /// Bayer mosaic, 8 bits, whose first two rows begin with R G and G B.
    BayerRggb,
    /// Bayer mosaic, 8 bits, whose first two rows begin with B G and G R.
    BayerBggr,
    /// Bayer mosaic, 8 bits, whose first two rows begin with G B and R G.
    BayerGbrg,
    /// Bayer mosaic, 8 bits, whose first two rows begin with G R and B G.
    BayerGrbg,
}

impl PixelFormat {
    /// All formats, best first.
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

    /// Returns the four-character code of the format in `videodev2.h`.
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

    /// Returns the format with this four-character code, if it can be recorded.
    pub fn of_fourcc(fourcc: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.fourcc() == fourcc)
    }

    /// Returns the size of a whole frame with rows of `stride` bytes, bytes; `None` for a compressed format.
    pub fn frame_bytes(self, stride: u32, height: u32) -> Option<usize> {
        let (stride, height) = (stride as usize, height as usize);
        match self {
            Self::Mjpeg => None,
            Self::Nv12 => Some(stride * height + stride * height.div_ceil(2)),
            _ => Some(stride * height),
        }
    }
}

/// What is wanted of a camera.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraOptions {
    /// Path of the device, or `unix:PATH`.
    pub device: String,
    /// Exact width, pixels: the lens was calibrated at this size.
    pub width: u32,
    /// Exact height, pixels.
    pub height: u32,
    /// Pixel format; `None` for the first of [`PixelFormat::ALL`] that the camera has.
    pub format: Option<PixelFormat>,
    /// Frame rate, Hz.
    pub rate_hz: f64,
    /// Values of the controls, by their names as `v4l2-ctl --list-ctrls` shows them.
    pub controls: BTreeMap<String, i64>,
}

impl CameraOptions {
    /// Takes the options from the settings, for a lens of this width and height, pixels.
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

/// What a camera has agreed to, read back from it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Negotiated {
    /// Name of the camera.
    pub card: String,
    /// Where it is connected, for example a USB port.
    pub bus: String,
    /// Pixel format.
    pub format: PixelFormat,
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Length of a row, bytes, if the format has rows.
    pub stride: u32,
    /// Frame rate, Hz; `None` if the driver does not state it.
    pub rate_hz: Option<f64>,
    /// Values of the wanted controls.
    pub controls: BTreeMap<String, i64>,
    /// Controls that the camera does not have or did not take, and why.
    pub refused: Vec<String>,
}

/// What the driver says about one filled buffer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BufferInfo {
    /// Number of the frame.
    pub sequence: u32,
    /// Stamp of the frame, nanoseconds.
    pub stamp_ns: i64,
    /// Whether the stamp is of CLOCK_MONOTONIC.
    pub is_monotonic: bool,
    /// Whether the stamp is of the start of the exposure, not of the end of the frame.
    pub is_start_of_exposure: bool,
    /// Whether the driver says that the pixels are damaged.
    pub is_damaged: bool,
}

/// Why a camera cannot be opened, or was lost.
#[derive(Debug, Error)]
pub enum CameraError {
    /// There is no such device.
    #[error("{device}: no such camera; present are {present}")]
    Missing {
        /// The device.
        device: String,
        /// The devices that there are.
        present: String,
    },
    /// The user may not open it.
    #[error("{device}: no permission: {}", permission::remedy(Path::new(device), "video"))]
    Permission {
        /// The device.
        device: String,
    },
    /// Another program uses it.
    #[error("{device}: another program streams from it; a camera streams to one program only")]
    Busy {
        /// The device.
        device: String,
    },
    /// The camera does not have the wanted format or size.
    #[error("{device} has no {wanted}; it offers {offers}")]
    Format {
        /// The device.
        device: String,
        /// What is wanted.
        wanted: String,
        /// What the camera offers.
        offers: String,
    },
    /// The device cannot capture.
    #[error("{device} is no camera that streams; present are {present}")]
    NoCapture {
        /// The device.
        device: String,
        /// The devices that there are.
        present: String,
    },
    /// The folder of the socket does not exist.
    #[error("{device}: there is no folder {folder} for the socket: make it, or name another")]
    NoFolder {
        /// The device.
        device: String,
        /// The folder.
        folder: String,
    },
    /// Something else is in the place of the socket.
    #[error("{device}: something is there that is no socket: it is left alone; name another place")]
    NoSocket {
        /// The device.
        device: String,
    },
    /// The program was built without the feature `v4l2`.
    #[error("{device}: this program was built without the feature v4l2")]
    NotBuilt {
        /// The device.
        device: String,
    },
    /// The device was unplugged, or its sender has hung up.
    #[error("{device} went away")]
    Unplugged {
        /// The device.
        device: String,
    },
    /// The open camera sends no frames.
    #[error("{device} is open and sends nothing")]
    Stalled {
        /// The device.
        device: String,
    },
    /// Any other error of the operating system.
    #[error("{device}: {source}")]
    Io {
        /// The device.
        device: String,
        /// What the operating system says.
        source: io::Error,
    },
}

impl CameraError {
    /// Returns the word for this error in counts and logs.
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

    /// Interprets an error that the kernel gave for a device.
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

/// The driver of one camera. It is called in the order open, (wait, take)*, close, and so on again.
pub trait Driver {
    /// Opens the camera, negotiates the format, sets the controls and starts the stream.
    fn open(&mut self, wanted: &CameraOptions) -> Result<Negotiated, CameraError>;
    /// Waits for a filled buffer. Returns false if there is none within the time.
    fn wait(&mut self, timeout: Duration) -> io::Result<bool>;
    /// Takes the oldest filled buffer: its used bytes replace the content of `into`.
    fn take(&mut self, into: &mut Vec<u8>) -> io::Result<BufferInfo>;
    /// Closes the camera. This never fails, since the device may be gone.
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
