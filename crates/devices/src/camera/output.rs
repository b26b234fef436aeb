//! Writes frames to a V4L2 device: v4l2loopback, or the output of a driver that has one.
//!
//! The stream of the crate `v4l` queues one buffer at a time, with which some drivers never begin, and cannot set a stamp.
//! Therefore this module makes the kernel's calls itself.

// The ioctls of Video4Linux need it.
#![allow(unsafe_code)]

use std::io;

use v4l::buffer::Type;
use v4l::memory::Memory;
use v4l::v4l_sys::{timeval, v4l2_buffer, v4l2_requestbuffers};
use v4l::v4l2::{self, vidioc};
use v4l::video::Output as _;
use v4l::{Device, FourCC};

use super::republish::Sink;
use super::{BufferInfo, Negotiated};

/// A V4L2 device that frames are written to.
pub struct OutputDevice {
    path: String,
    open: Option<Output>,
}

impl OutputDevice {
    /// Creates the output; the device is opened with the first frame.
    pub fn new(path: &str) -> Self {
        Self { path: path.to_owned(), open: None }
    }

    /// Adds the path of the device to an error, and says what the device is not.
    fn with_path(&self, error: &io::Error) -> io::Error {
        let path = &self.path;
        match error.raw_os_error() {
            Some(code) if code == rustix::io::Errno::NOTTY.raw_os_error() => io::Error::other(format!(
                "{path} is no video device that takes frames (docs/howto/robot.md: v4l2loopback)"
            )),
            _ => io::Error::new(error.kind(), format!("{path}: {error}")),
        }
    }
}

impl Sink for OutputDevice {
    fn open(&mut self, format: &Negotiated) -> io::Result<()> {
        self.open = Some(Output::open(&self.path, format).map_err(|error| self.with_path(&error))?);
        Ok(())
    }

    fn write(&mut self, data: &[u8], info: &BufferInfo) -> io::Result<bool> {
        let written = self.open.as_mut().map_or(Ok(false), |output| output.write(data, info));
        written.map_err(|error| self.with_path(&error))
    }

    fn close(&mut self) {
        self.open = None;
    }
}

/// Number of buffers, that of v4l2loopback. Some drivers need at least two. A loopback device overwrites buffers in turn even while
/// readers use them; the more there are, the later that happens.
const BUFFERS: u32 = 8;

/// An open device with its mapped buffers.
struct Output {
    device: Device,
    mapped: Vec<&'static mut [u8]>,
    /// Number of buffers that have been queued at least once.
    fresh: usize,
    /// The buffer that was queued last.
    newest: u32,
    is_streaming: bool,
}

impl Output {
    /// Opens a device in the camera's own format and size.
    fn open(path: &str, camera: &Negotiated) -> io::Result<Self> {
        let device = Device::with_path(path)?;
        let mut code = [b' '; 4];
        code.copy_from_slice(camera.format.fourcc().as_bytes());
        let mut wanted = v4l::Format::new(camera.width, camera.height, FourCC::new(&code));
        wanted.stride = camera.stride;
        let got = device.set_format(&wanted)?;
        if (got.width, got.height, got.fourcc) != (wanted.width, wanted.height, wanted.fourcc) {
            return Err(io::Error::other(format!(
                "takes {} {} x {} in place of the camera's {} {} x {}",
                got.fourcc, got.width, got.height, wanted.fourcc, wanted.width, wanted.height
            )));
        }
        let mut output = Self { device, mapped: Vec::new(), fresh: 0, newest: 0, is_streaming: false };
        output.map()?;
        Ok(output)
    }

    /// Maps the device's buffers into memory.
    fn map(&mut self) -> io::Result<()> {
        // SAFETY: a plain C struct of numbers, for which zero is a value.
        let mut request: v4l2_requestbuffers = unsafe { core::mem::zeroed() };
        (request.count, request.type_, request.memory) = (BUFFERS, Type::VideoOutput as u32, Memory::Mmap as u32);
        self.request(vidioc::VIDIOC_REQBUFS, &mut request)?;
        for index in 0..request.count {
            let mut buffer = buffer(index);
            self.request(vidioc::VIDIOC_QUERYBUF, &mut buffer)?;
            let length = buffer.length as usize;
            // SAFETY: offset and length are the driver's own for this buffer; the mapping lives until `drop`, and nobody else
            // of this program has it.
            self.mapped.push(unsafe {
                let start = v4l2::mmap(
                    core::ptr::null_mut(),
                    length,
                    READ_WRITE,
                    SHARED,
                    self.device.handle().fd(),
                    buffer.m.offset.into(),
                )?;
                core::slice::from_raw_parts_mut(start.cast::<u8>(), length)
            });
        }
        Ok(())
    }

    /// Writes a frame with its stamp. Returns false if no buffer is free, because readers are slower than the camera.
    fn write(&mut self, data: &[u8], info: &BufferInfo) -> io::Result<bool> {
        let Some(mut buffer) = self.free_buffer()? else { return Ok(false) };
        let place = self.mapped.get_mut(buffer.index as usize).ok_or(io::ErrorKind::InvalidData)?;
        let length = data.len().min(place.len());
        place[..length].copy_from_slice(&data[..length]);
        buffer.bytesused = length as u32;
        buffer.sequence = info.sequence;
        buffer.timestamp =
            timeval { tv_sec: info.stamp_ns / 1_000_000_000, tv_usec: info.stamp_ns % 1_000_000_000 / 1_000 };
        self.request(vidioc::VIDIOC_QBUF, &mut buffer)?;
        self.newest = buffer.index;
        if !self.is_streaming {
            self.request(vidioc::VIDIOC_STREAMON, &mut (Type::VideoOutput as u32))?;
            self.is_streaming = true;
        }
        Ok(true)
    }

    /// Returns the buffer that was written longest ago, or `None` if none is free.
    fn free_buffer(&mut self) -> io::Result<Option<v4l2_buffer>> {
        if self.fresh < self.mapped.len() {
            self.fresh += 1;
            return Ok(Some(buffer(self.fresh as u32 - 1)));
        }
        let mut done = buffer(0);
        match self.request(vidioc::VIDIOC_DQBUF, &mut done) {
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(None),
            asked => asked?,
        }
        if done.index != self.newest {
            return Ok(Some(buffer(done.index)));
        }
        // v4l2loopback up to 0.12 gives back the newest buffer, which its readers are using, but accepts any other one. QUERYBUF gives
        // the index that the device really has: a reader may have asked it for fewer buffers.
        let mut next = buffer((self.newest + 1) % self.mapped.len() as u32);
        self.request(vidioc::VIDIOC_QUERYBUF, &mut next)?;
        Ok(Some(buffer(next.index)))
    }

    /// Makes one request to the kernel.
    fn request<T>(&self, request: vidioc::_IOC_TYPE, what: &mut T) -> io::Result<()> {
        // SAFETY: each request above is given the struct that the kernel's header names for it.
        unsafe { v4l2::ioctl(self.device.handle().fd(), request, core::ptr::from_mut(what).cast()) }
    }
}

impl Drop for Output {
    fn drop(&mut self) {
        // Closing the device stops its stream.
        for mapped in self.mapped.drain(..) {
            // SAFETY: mapped in `map` with this length, and not used any more.
            let _ = unsafe { v4l2::munmap(mapped.as_mut_ptr().cast(), mapped.len()) };
        }
    }
}

/// Returns the kernel's description of the buffer with this index.
fn buffer(index: u32) -> v4l2_buffer {
    // SAFETY: a plain C struct of numbers and a union of them, for which zero is a value.
    let mut buffer: v4l2_buffer = unsafe { core::mem::zeroed() };
    (buffer.index, buffer.type_, buffer.memory) = (index, Type::VideoOutput as u32, Memory::Mmap as u32);
    buffer.field = PROGRESSIVE;
    buffer
}

/// V4L2_FIELD_NONE: whole frames.
const PROGRESSIVE: u32 = 1;
/// PROT_READ | PROT_WRITE and MAP_SHARED.
const READ_WRITE: i32 = 3;
const SHARED: i32 = 1;
