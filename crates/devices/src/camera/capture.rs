//! The rules of capturing: the newest frame is delivered, all others are counted, and after an error the camera is opened again.

use std::io;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::PixelFormat;
use super::driver::{CameraError, CameraOptions, Driver, Negotiated};
use super::jpeg::is_whole;

/// The event that a frame's stamp is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StampClock {
    /// The start of the exposure, stamped by the driver.
    StartOfExposure,
    /// The end of the frame, stamped by the driver.
    EndOfFrame,
    /// The moment at which the frame was taken from the driver, because the driver's stamp is of no use.
    Arrival,
}

/// One frame of a camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Its bytes, in the format that was negotiated.
    pub data: Vec<u8>,
    /// Its stamp by the monotonic clock, nanoseconds.
    pub stamp_ns: i64,
    /// The event that the stamp is of.
    pub clock: StampClock,
    /// Its number, given by the driver.
    pub sequence: u32,
}

/// Why a frame of the camera is not delivered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Drop {
    /// The camera or its driver had no free buffer: there is a gap in its numbers.
    Camera,
    /// A newer frame was there already.
    Skipped,
    /// The frame is incomplete, or the driver says that it is damaged.
    Torn,
    /// The frame came sooner than `max_rate_hz` allows.
    Rate,
}

impl Drop {
    /// Returns the word for this reason in counts and logs.
    pub fn cause(self) -> &'static str {
        match self {
            Self::Camera => "camera",
            Self::Skipped => "skipped",
            Self::Torn => "torn",
            Self::Rate => "rate",
        }
    }
}

/// What happens to a camera.
#[derive(Debug)]
pub enum CaptureEvent {
    /// It was opened.
    Opened(Negotiated),
    /// It delivered a frame.
    Frame(Frame),
    /// It could not be opened, or was lost.
    Lost {
        /// The reason.
        error: CameraError,
        /// Time after which it is opened again.
        retry_in: Duration,
    },
    /// This many frames were not delivered, for this reason.
    Dropped(Drop, u64),
}

/// What to capture.
#[derive(Clone, Debug)]
pub struct CaptureRules {
    /// The camera and what is wanted of it.
    pub options: CameraOptions,
    /// Largest rate of delivered frames, Hz; `None` for every frame.
    pub max_rate_hz: Option<f64>,
}

/// Time until a lost camera is opened again; it doubles with each failure.
const FIRST_RETRY: Duration = Duration::from_millis(100);
/// Longest time between two tries to open a camera.
const MAX_RETRY: Duration = Duration::from_secs(2);
/// Longest wait for one frame in a step, so that the caller notices a stop in time.
const WAIT: Duration = Duration::from_millis(100);
/// Time without a frame, nanoseconds, after which a camera is opened again; five frames, if that is longer.
const STALL_NS: i64 = 1_000_000_000;
/// Largest number of buffers looked through for the newest frame: no driver has more.
const MAX_BUFFERS: usize = 32;
/// Largest number of buffers kept for frames to come.
const MAX_SPARE: usize = 4;
/// Largest age of a frame at its arrival, nanoseconds. An older stamp is of another clock.
const MAX_AGE_NS: i64 = 10_000_000_000;
/// Largest time by which a stamp may be later than the arrival, nanoseconds. Drivers that compute the end of a frame from its start
/// may deliver the frame before that end, by less than a frame.
const MAX_AHEAD_NS: i64 = 100_000_000;

/// Captures the frames of one camera.
///
/// The caller calls [`step`](Self::step) again and again, and waits for [`idle`](Self::idle) in between.
pub struct Capture<D> {
    driver: D,
    rules: CaptureRules,
    open: Option<Open>,
    /// Time until the next try, if opening fails.
    retry: Duration,
    /// Time before which the camera is not opened.
    retry_at_ns: i64,
    /// Stamp of the last frame that was delivered; kept when the camera is opened again, so that `max_rate_hz` still holds.
    delivered_ns: Option<i64>,
    spare: Spare,
}

/// Buffers for frames, so that a steady stream needs no new memory.
#[derive(Default)]
struct Spare(Vec<Vec<u8>>);

/// State of an open camera.
struct Open {
    negotiated: Negotiated,
    last_sequence: Option<u32>,
    /// The last stamp of the driver that was used; the next one must be later.
    last_stamp_ns: Option<i64>,
    /// Time at which a frame last came.
    heard_ns: i64,
}

impl<D: Driver> Capture<D> {
    /// Creates a capture whose camera is opened with the first step.
    pub fn new(driver: D, rules: CaptureRules) -> Self {
        Self {
            driver,
            rules,
            open: None,
            retry: FIRST_RETRY,
            retry_at_ns: i64::MIN,
            delivered_ns: None,
            spare: Spare::default(),
        }
    }

    /// Takes back the buffer of a frame that is not needed any more.
    pub fn give_back(&mut self, data: Vec<u8>) {
        self.spare.put(data);
    }

    /// Opens the camera, or waits up to 100 ms for a frame. `now_ns` reads the monotonic clock; `tell` gets what happens.
    pub fn step(&mut self, now_ns: impl Fn() -> i64, mut tell: impl FnMut(CaptureEvent)) {
        let Some(open) = &mut self.open else {
            self.open(now_ns(), &mut tell);
            return;
        };
        let rate_hz = open.negotiated.rate_hz.unwrap_or(self.rules.options.rate_hz);
        let period_ns = if rate_hz > 0.0 { (5e9 / rate_hz) as i64 } else { 0 };
        let patience_ns = STALL_NS.max(period_ns);
        let (frame, failed) = newest(&mut self.driver, open, &mut self.spare, &now_ns, &mut tell);
        let silent_ns = now_ns().saturating_sub(open.heard_ns);
        let device = self.rules.options.device.as_str();
        let error = match failed {
            // An interruption by a signal is no fault.
            Some(error) if error.kind() == io::ErrorKind::Interrupted => None,
            Some(error) => Some(CameraError::of_io(device, error)),
            None if silent_ns > patience_ns => Some(CameraError::Stalled { device: device.to_owned() }),
            None => None,
        };
        if let Some(frame) = frame {
            self.deliver(frame, &mut tell);
        }
        if let Some(error) = error {
            self.lose(error, now_ns(), &mut tell);
        }
    }

    /// Returns how long the caller may sleep while the camera is away; zero while it is open.
    pub fn idle(&self, now_ns: i64) -> Duration {
        match self.open {
            Some(_) => Duration::ZERO,
            None => Duration::from_nanos(self.retry_at_ns.saturating_sub(now_ns).clamp(0, 100_000_000) as u64),
        }
    }

    /// Tries to open the camera, if it is time.
    fn open(&mut self, now_ns: i64, tell: &mut impl FnMut(CaptureEvent)) {
        if now_ns < self.retry_at_ns {
            return;
        }
        match self.driver.open(&self.rules.options) {
            Ok(negotiated) => {
                tell(CaptureEvent::Opened(negotiated.clone()));
                self.open = Some(Open { negotiated, last_sequence: None, last_stamp_ns: None, heard_ns: now_ns });
            }
            Err(error) => self.lose(error, now_ns, tell),
        }
    }

    /// Closes the camera after an error, and sets the time of the next try.
    fn lose(&mut self, error: CameraError, now_ns: i64, tell: &mut impl FnMut(CaptureEvent)) {
        self.driver.close();
        self.open = None;
        self.retry_at_ns = now_ns.saturating_add(self.retry.as_nanos() as i64);
        tell(CaptureEvent::Lost { error, retry_in: self.retry });
        self.retry = (self.retry * 2).min(MAX_RETRY);
    }

    /// Delivers a frame, unless it is over the rate.
    fn deliver(&mut self, frame: Frame, tell: &mut impl FnMut(CaptureEvent)) {
        // Only a frame shows that the camera works; that it opens does not.
        self.retry = FIRST_RETRY;
        if let (Some(rate), Some(last_ns)) = (self.rules.max_rate_hz, self.delivered_ns) {
            // A tenth of leeway, because stamps are not exact: 10 Hz of a camera's 30 Hz must not become 7.5 Hz.
            let min_ns = (0.9e9 / rate) as i64;
            if (0..min_ns).contains(&frame.stamp_ns.saturating_sub(last_ns)) {
                tell(CaptureEvent::Dropped(Drop::Rate, 1));
                self.spare.put(frame.data);
                return;
            }
        }
        self.delivered_ns = Some(frame.stamp_ns);
        tell(CaptureEvent::Frame(frame));
    }
}

impl Spare {
    fn put(&mut self, data: Vec<u8>) {
        if self.0.len() < MAX_SPARE {
            self.0.push(data);
        }
    }

    fn take(&mut self) -> Vec<u8> {
        self.0.pop().unwrap_or_default()
    }
}

/// Returns the newest whole frame of those that are ready, and the error that came after it, if there is one.
///
/// The other frames are reported as dropped.
fn newest(
    driver: &mut impl Driver,
    open: &mut Open,
    spare: &mut Spare,
    now_ns: impl Fn() -> i64,
    tell: &mut impl FnMut(CaptureEvent),
) -> (Option<Frame>, Option<io::Error>) {
    let mut best: Option<Frame> = None;
    let mut wait = WAIT;
    for _ in 0..MAX_BUFFERS {
        let mut data = spare.take();
        let taken = driver.wait(wait).and_then(|ready| ready.then(|| driver.take(&mut data)).transpose());
        let info = match taken {
            Ok(Some(info)) => info,
            Ok(None) => {
                spare.put(data);
                break;
            }
            Err(error) => return (best, Some(error)),
        };
        wait = Duration::ZERO;
        let arrived_ns = now_ns();
        open.heard_ns = arrived_ns;
        let gap = open.last_sequence.map_or(0, |last| info.sequence.wrapping_sub(last).saturating_sub(1));
        // A number that repeats or begins anew is no gap: some drivers give the first numbers twice, and cameras are reset.
        if gap > 0 && gap < u32::MAX / 2 {
            tell(CaptureEvent::Dropped(Drop::Camera, u64::from(gap)));
        }
        open.last_sequence = Some(info.sequence);
        if info.is_damaged || !is_complete(&data, &open.negotiated) {
            tell(CaptureEvent::Dropped(Drop::Torn, 1));
            spare.put(data);
            continue;
        }
        let age_ns = arrived_ns.saturating_sub(info.stamp_ns);
        let is_later = open.last_stamp_ns.is_none_or(|last| info.stamp_ns > last);
        let (stamp_ns, clock) = match info.is_monotonic && is_later && (-MAX_AHEAD_NS..MAX_AGE_NS).contains(&age_ns) {
            true if info.is_start_of_exposure => (info.stamp_ns, StampClock::StartOfExposure),
            true => (info.stamp_ns, StampClock::EndOfFrame),
            false => (arrived_ns, StampClock::Arrival),
        };
        if clock != StampClock::Arrival {
            open.last_stamp_ns = Some(stamp_ns);
        }
        if let Some(older) = best.replace(Frame { data, stamp_ns, clock, sequence: info.sequence }) {
            tell(CaptureEvent::Dropped(Drop::Skipped, 1));
            spare.put(older.data);
        }
    }
    (best, None)
}

/// Returns whether all bytes of a frame are there.
fn is_complete(data: &[u8], negotiated: &Negotiated) -> bool {
    match negotiated.format.frame_bytes(negotiated.stride, negotiated.height) {
        Some(bytes) => data.len() >= bytes,
        None => negotiated.format == PixelFormat::Mjpeg && is_whole(data),
    }
}
