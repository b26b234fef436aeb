//! Passes every frame on to a device from which other programs read: v4l2loopback, or any driver with an output.
//!
//! A camera streams to one program only. Frames are passed on with their bytes and stamps, whether they are recorded or not.

use std::io;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use super::{BufferInfo, CameraError, CameraOptions, Driver, Negotiated};

/// A device that frames are passed on to.
pub trait Sink {
    /// Opens it for frames of this format.
    fn open(&mut self, format: &Negotiated) -> io::Result<()>;
    /// Writes a frame. Returns false if there is no room, because readers are slower than the camera.
    fn write(&mut self, data: &[u8], info: &BufferInfo) -> io::Result<bool>;
    /// Closes it.
    fn close(&mut self);
}

/// A camera whose frames also go to a [`Sink`].
pub struct Republishing<D, S> {
    camera: D,
    sink: S,
    format: Option<Negotiated>,
    is_open: bool,
    /// Number of frames that are not passed on before the sink is opened again.
    pause: u32,
    report: Arc<Republished>,
}

/// Counts of frames that were passed on. Other threads may read it.
#[derive(Debug, Default)]
pub struct Republished {
    passed: AtomicU64,
    missed: AtomicU64,
    lost: Mutex<Option<String>>,
}

/// Number of frames between two tries to open the sink.
const PAUSE: u32 = 30;

impl<D: Driver, S: Sink> Republishing<D, S> {
    /// Creates a camera whose frames are passed on to `sink` and counted in `report`.
    pub fn new(camera: D, sink: S, report: Arc<Republished>) -> Self {
        Self { camera, sink, format: None, is_open: false, pause: 0, report }
    }

    /// Passes a frame on, if that is possible, and counts it.
    fn pass_on(&mut self, data: &[u8], info: &BufferInfo) {
        let passed = self.try_pass_on(data, info).unwrap_or_else(|error| {
            self.report.set_lost(Some(error.to_string()));
            self.close_sink();
            self.pause = PAUSE;
            false
        });
        let count = if passed { &self.report.passed } else { &self.report.missed };
        count.fetch_add(1, Ordering::Relaxed);
    }

    /// Passes a frame on, opening the sink if necessary. Returns false if it was not passed on.
    fn try_pass_on(&mut self, data: &[u8], info: &BufferInfo) -> io::Result<bool> {
        let Some(format) = &self.format else { return Ok(false) };
        if self.pause > 0 {
            self.pause -= 1;
            return Ok(false);
        }
        if !self.is_open {
            self.sink.open(format)?;
            self.is_open = true;
            self.report.set_lost(None);
        }
        self.sink.write(data, info)
    }

    fn close_sink(&mut self) {
        self.sink.close();
        self.is_open = false;
    }
}

impl<D: Driver, S: Sink> Driver for Republishing<D, S> {
    fn open(&mut self, wanted: &CameraOptions) -> Result<Negotiated, CameraError> {
        let negotiated = self.camera.open(wanted)?;
        // The sink stays open for its readers if the camera comes back with the same format.
        if self.format.as_ref().is_some_and(|format| *format != negotiated) {
            self.close_sink();
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
        self.pass_on(into, &info);
        Ok(info)
    }

    fn close(&mut self) {
        self.camera.close();
    }
}

impl Republished {
    /// Returns the number of frames passed on.
    pub fn passed(&self) -> u64 {
        self.passed.load(Ordering::Relaxed)
    }

    /// Returns the number of frames not passed on, because the device is missing or its readers are too slow.
    pub fn missed(&self) -> u64 {
        self.missed.load(Ordering::Relaxed)
    }

    /// Returns why no frame is passed on at the moment; `None` if frames are.
    pub fn lost(&self) -> Option<String> {
        self.lost.lock().ok()?.clone()
    }

    fn set_lost(&self, lost: Option<String>) {
        if let Ok(mut place) = self.lost.lock() {
            *place = lost;
        }
    }
}
