//! Receives frames from another process that has the camera and shares it. docs/reference/formats.md describes the format.

use std::collections::BTreeMap;
use std::io::{self, Read};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};

use crate::stale_socket::clear_away;

use super::{BufferInfo, CameraError, CameraOptions, Driver, Negotiated, PixelFormat};

/// The recorder's end of the socket, as a camera.
#[derive(Default)]
pub struct SocketCamera {
    listener: Option<UnixListener>,
    sender: Option<UnixStream>,
    /// Bytes of at most one frame, and what came with its last bytes.
    buffer: Vec<u8>,
}

/// Prefix of the name of such a device.
pub const SCHEME: &str = "unix:";
/// First bytes of each frame.
const MAGIC: &[u8; 4] = b"RSF1";
/// Length of a frame's header, bytes: magic, length, sequence, stamp.
const HEAD_BYTES: usize = 20;
/// Largest frame, bytes; a larger one is an error.
const MAX_FRAME_BYTES: usize = 32 << 20;
/// Largest number of bytes read at once.
const READ_BYTES: usize = 1 << 18;

impl Driver for SocketCamera {
    fn open(&mut self, wanted: &CameraOptions) -> Result<Negotiated, CameraError> {
        let failed = |source| CameraError::of_io(&wanted.device, source);
        if self.listener.is_none() {
            let path = Path::new(wanted.device.strip_prefix(SCHEME).unwrap_or(&wanted.device));
            let device = || wanted.device.clone();
            if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty() && !folder.is_dir()) {
                return Err(CameraError::NoFolder { device: device(), folder: folder.display().to_string() });
            }
            clear_away(path).map_err(|_| CameraError::NoSocket { device: device() })?;
            let listener = UnixListener::bind(path).map_err(|source| match source.kind() {
                io::ErrorKind::PermissionDenied => CameraError::Io { device: device(), source },
                _ => failed(source),
            })?;
            listener.set_nonblocking(true).map_err(failed)?;
            self.listener = Some(listener);
        }
        Ok(Negotiated {
            card: "another process".to_owned(),
            bus: wanted.device.clone(),
            format: PixelFormat::Mjpeg,
            width: wanted.width,
            height: wanted.height,
            stride: 0,
            rate_hz: None,
            controls: BTreeMap::new(),
            refused: wanted.controls.keys().map(|name| format!("{name}: the sender sets it")).collect(),
        })
    }

    fn wait(&mut self, timeout: Duration) -> io::Result<bool> {
        if self.frame_bytes()?.is_some_and(|bytes| self.buffer.len() >= bytes) {
            return Ok(true);
        }
        let Some(listener) = &self.listener else { return Err(io::ErrorKind::NotConnected.into()) };
        let patience = Timespec {
            tv_sec: timeout.as_secs().try_into().unwrap_or(i64::MAX),
            tv_nsec: timeout.subsec_nanos().into(),
        };
        match &mut self.sender {
            None => {
                poll(&mut [PollFd::new(listener, PollFlags::IN)], Some(&patience))?;
                match listener.accept() {
                    Ok((sender, _)) => {
                        sender.set_nonblocking(true)?;
                        self.sender = Some(sender);
                    }
                    Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                    Err(error) => return Err(error),
                }
            }
            Some(sender) => {
                poll(&mut [PollFd::new(&*sender, PollFlags::IN)], Some(&patience))?;
                let before = self.buffer.len();
                self.buffer.resize(before + READ_BYTES, 0);
                let read = sender.read(&mut self.buffer[before..]);
                self.buffer.truncate(before + read.as_ref().copied().unwrap_or(0));
                match read {
                    // A sender that hangs up is treated like a camera that is unplugged.
                    Ok(0) => return Err(rustix::io::Errno::NODEV.into()),
                    Ok(_) => {}
                    Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                    Err(error) => return Err(error),
                }
            }
        }
        Ok(self.frame_bytes()?.is_some_and(|bytes| self.buffer.len() >= bytes))
    }

    fn take(&mut self, into: &mut Vec<u8>) -> io::Result<BufferInfo> {
        let bytes = self.frame_bytes()?.ok_or(io::ErrorKind::WouldBlock)?;
        let number = |at: usize| u32::from_le_bytes([0, 1, 2, 3].map(|i| self.buffer[at + i]));
        let sequence = number(8);
        let stamp_ns = (i64::from(number(16)) << 32) | i64::from(number(12));
        into.clear();
        into.extend_from_slice(&self.buffer[HEAD_BYTES..bytes]);
        self.buffer.drain(..bytes);
        let is_monotonic = stamp_ns != 0;
        Ok(BufferInfo { sequence, stamp_ns, is_monotonic, is_start_of_exposure: true, is_damaged: false })
    }

    /// Hangs up on the sender. The socket stays, so that the sender may come again.
    fn close(&mut self) {
        self.sender = None;
        self.buffer.clear();
    }
}

impl SocketCamera {
    /// Returns the length of the next frame with its header, bytes; `None` until the header is there.
    fn frame_bytes(&self) -> io::Result<Option<usize>> {
        let Some(head) = self.buffer.get(..HEAD_BYTES) else { return Ok(None) };
        let bytes = u32::from_le_bytes([head[4], head[5], head[6], head[7]]) as usize;
        if &head[..4] != MAGIC || bytes > MAX_FRAME_BYTES {
            let what = "what the sender writes is no frame: each begins with RSF1 and its length";
            return Err(io::Error::new(io::ErrorKind::InvalidData, what));
        }
        Ok(Some(HEAD_BYTES + bytes))
    }
}
