//! The rules of capturing: the newest frame counts, everything else is counted, and an error is a beginning anew.

use std::io;
use std::time::Duration;

use serde::Serialize;

use super::PixelFormat;
use super::driver::{CameraError, CameraOptions, Driver, Negotiated};
use super::jpeg::is_whole;

/// Which clock a frame's stamp is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum StampClock {
    StartOfExposure,
    EndOfFrame,
    /// The driver's stamps are of no use: when the frame was taken from it.
    Arrival,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    pub data: Vec<u8>,
    /// Monotonic.
    pub stamp_ns: i64,
    pub clock: StampClock,
    pub sequence: u32,
}

/// Why frames that the camera made are not delivered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Drop {
    /// The camera or its driver had no buffer: a gap in its numbers.
    Camera,
    /// A newer one was there already.
    Skipped,
    /// Cut off, or said to be damaged by the driver.
    Torn,
    /// More than `max_rate_hz`.
    Rate,
}

impl Drop {
    /// In counts and logs.
    pub fn cause(self) -> &'static str {
        match self {
            Self::Camera => "camera",
            Self::Skipped => "skipped",
            Self::Torn => "torn",
            Self::Rate => "rate",
        }
    }
}

#[derive(Debug)]
pub enum CaptureEvent {
    Opened(Negotiated),
    Frame(Frame),
    /// Could not be opened, or was lost; it is tried again after `retry_in`.
    Lost {
        error: CameraError,
        retry_in: Duration,
    },
    Dropped(Drop, u64),
}

#[derive(Clone, Debug)]
pub struct CaptureRules {
    pub options: CameraOptions,
    /// None: every frame.
    pub max_rate_hz: Option<f64>,
}

const FIRST_RETRY: Duration = Duration::from_millis(100);
const MAX_RETRY: Duration = Duration::from_secs(2);
/// So long a wait for one frame: a stop is noticed then.
const WAIT: Duration = Duration::from_millis(100);
/// A camera that sends nothing for so long (or five frames, if that is longer) is opened anew.
const STALL_NS: i64 = 1_000_000_000;
/// Buffers that can be full at once: no driver has more.
const MAX_BUFFERS: usize = 32;
/// Room kept for frames to come.
const MAX_SPARE: usize = 4;
/// A stamp farther from its arrival is of another clock.
const MAX_AGE_NS: i64 = 10_000_000_000;
/// Drivers that compute the end of a frame from its start may deliver it before: by less than a frame.
const MAX_AHEAD_NS: i64 = 100_000_000;

pub struct Capture<D> {
    driver: D,
    rules: CaptureRules,
    open: Option<Open>,
    retry: Duration,
    /// Not before.
    retry_at_ns: i64,
    /// Of the last frame that was delivered: `max_rate_hz` holds over a new beginning.
    delivered_ns: Option<i64>,
    spare: Spare,
}

/// Room for frames: a steady stream needs no new memory.
#[derive(Default)]
struct Spare(Vec<Vec<u8>>);

struct Open {
    negotiated: Negotiated,
    last_sequence: Option<u32>,
    /// Of the last frame that had one of use: none before it can be of the next.
    last_stamp_ns: Option<i64>,
    heard_ns: i64,
}

impl<D: Driver> Capture<D> {
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

    /// The room of a frame that is not needed any more.
    pub fn give_back(&mut self, data: Vec<u8>) {
        self.spare.put(data);
    }

    /// Waits a little for what comes next. `now_ns` reads the monotonic clock.
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
            // A signal is no fault.
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

    /// How long nothing has to be done, while the camera is away.
    pub fn idle(&self, now_ns: i64) -> Duration {
        match self.open {
            Some(_) => Duration::ZERO,
            None => Duration::from_nanos(self.retry_at_ns.saturating_sub(now_ns).clamp(0, 100_000_000) as u64),
        }
    }

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

    fn lose(&mut self, error: CameraError, now_ns: i64, tell: &mut impl FnMut(CaptureEvent)) {
        self.driver.close();
        self.open = None;
        self.retry_at_ns = now_ns.saturating_add(self.retry.as_nanos() as i64);
        tell(CaptureEvent::Lost { error, retry_in: self.retry });
        self.retry = (self.retry * 2).min(MAX_RETRY);
    }

    fn deliver(&mut self, frame: Frame, tell: &mut impl FnMut(CaptureEvent)) {
        // A frame, not an opened device, shows that the camera works.
        self.retry = FIRST_RETRY;
        if let (Some(rate), Some(last_ns)) = (self.rules.max_rate_hz, self.delivered_ns) {
            // A tenth of leeway: stamps are not exact, and a rate of 10 must not become 7.5 of a camera's 30.
            let least_ns = (0.9e9 / rate) as i64;
            if (0..least_ns).contains(&frame.stamp_ns.saturating_sub(last_ns)) {
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

/// The newest whole frame of those that are there, the others being counted; and the error that came behind it, if one did.
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
        // Some drivers number the first frames twice, and a camera that was reset begins anew: no gap of 4 billion.
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

fn is_complete(data: &[u8], negotiated: &Negotiated) -> bool {
    match negotiated.format.frame_bytes(negotiated.stride, negotiated.height) {
        Some(bytes) => data.len() >= bytes,
        None => negotiated.format == PixelFormat::Mjpeg && is_whole(data),
    }
}
