//! Every frame passed on to a device from which other programs read it: v4l2loopback, or any driver with an output.
//!
//! A camera streams to one program only. What is passed on has its bytes and its stamp, whatever is recorded of it.

use std::io;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use super::{BufferInfo, CameraError, CameraOptions, Driver, Negotiated};

/// Where frames go to.
pub trait Sink {
    fn open(&mut self, format: &Negotiated) -> io::Result<()>;
    /// False if it has no room: nobody reads as fast as the camera sends.
    fn write(&mut self, data: &[u8], info: &BufferInfo) -> io::Result<bool>;
    fn close(&mut self);
}

/// A camera whose frames go two ways.
pub struct Republishing<D, S> {
    camera: D,
    sink: S,
    format: Option<Negotiated>,
    is_open: bool,
    /// Frames still to be missed before the sink is tried again.
    pause: u32,
    report: Arc<Republished>,
}

/// What became of the frames. Read from other threads.
#[derive(Debug, Default)]
pub struct Republished {
    passed: AtomicU64,
    missed: AtomicU64,
    lost: Mutex<Option<String>>,
}

/// Frames between two tries to open the sink.
const PAUSE: u32 = 30;

impl<D: Driver, S: Sink> Republishing<D, S> {
    pub fn new(camera: D, sink: S, report: Arc<Republished>) -> Self {
        Self { camera, sink, format: None, is_open: false, pause: 0, report }
    }

    fn pass(&mut self, data: &[u8], info: &BufferInfo) {
        let passed = self.try_to_pass(data, info).unwrap_or_else(|error| {
            self.report.is(Some(error.to_string()));
            self.shut();
            self.pause = PAUSE;
            false
        });
        let count = if passed { &self.report.passed } else { &self.report.missed };
        count.fetch_add(1, Ordering::Relaxed);
    }

    fn try_to_pass(&mut self, data: &[u8], info: &BufferInfo) -> io::Result<bool> {
        let Some(format) = &self.format else { return Ok(false) };
        if self.pause > 0 {
            self.pause -= 1;
            return Ok(false);
        }
        if !self.is_open {
            self.sink.open(format)?;
            self.is_open = true;
            self.report.is(None);
        }
        self.sink.write(data, info)
    }

    fn shut(&mut self) {
        self.sink.close();
        self.is_open = false;
    }
}

impl<D: Driver, S: Sink> Driver for Republishing<D, S> {
    fn open(&mut self, wanted: &CameraOptions) -> Result<Negotiated, CameraError> {
        let negotiated = self.camera.open(wanted)?;
        // Its readers stay when the camera comes back as it was.
        if self.format.as_ref().is_some_and(|format| *format != negotiated) {
            self.shut();
            self.pause = 0;
        }
        self.format = Some(negotiated.clone());
        Ok(negotiated)
    }

    fn wait(&mut self, timeout: Duration) -> io::Result<bool> {
        self.camera.wait(timeout)
    }

    fn take(&mut self, into: &mut Vec<u8>) -> io::Result<BufferInfo> {
        let info = self.camera.take(into)?;
        self.pass(into, &info);
        Ok(info)
    }

    fn close(&mut self) {
        self.camera.close();
    }
}

impl Republished {
    /// Frames passed on.
    pub fn passed(&self) -> u64 {
        self.passed.load(Ordering::Relaxed)
    }

    /// Frames not passed on: the device is not there, or nobody empties it.
    pub fn missed(&self) -> u64 {
        self.missed.load(Ordering::Relaxed)
    }

    /// Why no frame is passed on at the moment.
    pub fn lost(&self) -> Option<String> {
        self.lost.lock().ok()?.clone()
    }

    fn is(&self, lost: Option<String>) {
        if let Ok(mut place) = self.lost.lock() {
            *place = lost;
        }
    }
}
