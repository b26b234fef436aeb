//! Load test of the recorder: a synthetic stream in real time shows whether it keeps up, and at what cost.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use glam::DVec2;
use rustix::time::{ClockId, clock_gettime};
use serde::Serialize;

use crate::config::{Settings, load_lens};
use crate::devices::host_clock::utc_offset_ns;
use crate::geometry::{FieldDimensions, Pose2, PoseGrid};
use crate::recording::storage::Disk;
use crate::recording::{
    Counts, Ended, FORMAT_VERSION, RecorderStatus, RecordingError, SegmentState, SessionId, SessionInfo, SessionWriter,
    Thinning, Writing,
};
use crate::ros2::mcap_read::{Channel, LogMessage};
use crate::ros2::mcap_write::{Durability, channel_metadata};
use crate::ros2::messages::{CompressedImage, FrameTag, Header, Imu, Message};
use crate::ros2::topics;
use crate::tagging::error::AgentError;

/// What a load test records, and for how long.
#[derive(Clone, Debug)]
pub struct SoakOptions {
    pub captures: PathBuf,
    pub settings: Settings,
    pub duration: Duration,
    pub frames_per_s: u32,
    pub frame_bytes: usize,
    pub imu_per_s: u32,
}

/// Result of a load test.
#[derive(Clone, Debug, Serialize)]
pub struct SoakReport {
    pub session: PathBuf,
    pub seconds: f64,
    pub counts: Counts,
    pub bytes_per_s: f64,
    /// Processor time divided by the test's duration. It includes the making of the stream.
    pub core_share: f64,
    pub recorder: RecorderStatus,
}

/// Size of a filter state, as a checkpoint holds it.
const STATE_BYTES: usize = 64 << 10;
/// How often `each` is called.
const STATUS_INTERVAL: Duration = Duration::from_millis(100);

/// Records synthetic frames, measurements and tags in real time. `each` gets the recorder's state now and then.
pub fn soak(options: &SoakOptions, each: &mut dyn FnMut(&RecorderStatus)) -> Result<SoakReport, AgentError> {
    let start_ns = utc_offset_ns() + crate::devices::host_clock::monotonic_ns();
    let (name, info) = info(options, start_ns)?;
    let mut stream = Stream::new(options, start_ns, &info.field);
    let bytes_per_s = u64::from(options.frames_per_s) * options.frame_bytes as u64;
    let writing = Writing::Behind { bytes_per_s };
    let mut session =
        SessionWriter::create(Arc::new(Disk), &options.captures, &name, &info, segment_state(start_ns), writing)?;
    let (began, used) = (Instant::now(), processor_time());
    let mut told = began;
    while began.elapsed() < options.duration {
        let due = stream.next_due();
        std::thread::sleep(due.saturating_sub(began.elapsed()));
        let now_ns = start_ns + began.elapsed().as_nanos() as i64;
        if session.is_segment_full(now_ns) {
            session.next_segment(segment_state(now_ns))?;
        }
        stream.write_due(began.elapsed(), &mut session)?;
        if told.elapsed() >= STATUS_INTERVAL {
            told = Instant::now();
            each(&session.status());
        }
    }
    let seconds = began.elapsed().as_secs_f64();
    let core_share = processor_time().saturating_sub(used).as_secs_f64() / seconds;
    let Ended { folder, counts, status: recorder } = session.finish();
    each(&recorder);
    let session = folder?;
    Ok(SoakReport { session, seconds, counts, bytes_per_s: stream.bytes as f64 / seconds, core_share, recorder })
}

fn segment_state(log_time_ns: i64) -> SegmentState {
    SegmentState { log_time_ns, name: topics::CHECKPOINT_ATTACHMENT, state: vec![0x5a; STATE_BYTES] }
}

fn processor_time() -> Duration {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    Duration::new(time.tv_sec.unsigned_abs(), time.tv_nsec.unsigned_abs() as u32)
}

fn info(options: &SoakOptions, start_ns: i64) -> Result<(String, SessionInfo), AgentError> {
    let settings = options.settings.clone();
    let unusable =
        |error: &dyn std::fmt::Display| RecordingError::io(&options.captures, std::io::Error::other(error.to_string()));
    let started = jiff::Timestamp::from_nanosecond(i128::from(start_ns)).unwrap_or_default();
    let info = SessionInfo {
        format: FORMAT_VERSION,
        id: Some(SessionId::new().as_str().to_owned()),
        software: concat!("realitysim ", env!("CARGO_PKG_VERSION")).to_owned(),
        robot: settings.robot.clone(),
        started: started.to_string(),
        source: Some("soak".to_owned()),
        field: settings.field_dimensions().map_err(|error| unusable(&error))?,
        lens: load_lens("fisheye-640").map_err(|error| unusable(&error))?.lens.parameters().clone(),
        body_masks: Vec::new(),
        live: None,
        settings,
    };
    Ok((format!("{}-soak", started.strftime("%Y-%m-%dT%H-%M-%SZ")), info))
}

/// Pose on a circle of 2 m radius, once around in half a minute.
fn circle_pose(time: Duration) -> Pose2 {
    let angle = time.as_secs_f64() * std::f64::consts::TAU / 30.0;
    Pose2::new(2.0 * angle.cos(), 2.0 * angle.sin(), angle + std::f64::consts::FRAC_PI_2)
}

/// The synthetic messages and their times.
struct Stream {
    start_ns: i64,
    frame_every: Duration,
    imu_every: Option<Duration>,
    frames: u32,
    measurements: u32,
    image: CompressedImage,
    topics: [Arc<Channel>; 2],
    map: String,
    thinning: Thinning,
    bytes: u64,
}

impl Stream {
    fn new(options: &SoakOptions, start_ns: i64, field: &FieldDimensions) -> Self {
        let topics = &options.settings.topics;
        let volatile = || channel_metadata(Durability::Volatile);
        let thinning = options.settings.recording.thinning.clone();
        let half = DVec2::new(field.length_m, field.width_m) / 2.0;
        let grid = PoseGrid::new(half, thinning.cell_m, usize::from(thinning.headings));
        // Bytes of high entropy, which compress as badly as a JPEG.
        let data =
            (0..options.frame_bytes as u64).map(|i| (i.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 56) as u8).collect();
        let header = Header::at(start_ns, &options.settings.frames.camera_optical);
        Self {
            start_ns,
            frame_every: Duration::from_secs(1) / options.frames_per_s.max(1),
            imu_every: (options.imu_per_s > 0).then(|| Duration::from_secs(1) / options.imu_per_s),
            frames: 0,
            measurements: 0,
            image: CompressedImage { header, format: "jpeg".to_owned(), data },
            topics: [
                Arc::new(Channel::of::<CompressedImage>(1, &topics.image, volatile())),
                Arc::new(Channel::of::<Imu>(2, &topics.imu, volatile())),
            ],
            map: options.settings.frames.map.clone(),
            thinning: Thinning::new(thinning, grid),
            bytes: 0,
        }
    }

    fn next_due(&self) -> Duration {
        let frame = self.frame_every * self.frames;
        self.imu_every.map_or(frame, |every| frame.min(every * self.measurements))
    }

    fn write_due(&mut self, now: Duration, session: &mut SessionWriter) -> Result<(), RecordingError> {
        while let Some(every) = self.imu_every.filter(|every| *every * self.measurements <= now) {
            let at_ns = self.start_ns + (every * self.measurements).as_nanos() as i64;
            let imu = Imu { header: Header::at(at_ns, "base_link"), ..Imu::default() };
            self.pass(1, at_ns, imu.encode(), session)?;
            self.measurements += 1;
        }
        while self.frame_every * self.frames <= now {
            let at_ns = self.start_ns + (self.frame_every * self.frames).as_nanos() as i64;
            let stamp = Header::at(at_ns, "");
            self.image.header.stamp = stamp.stamp;
            let pose = circle_pose(self.frame_every * self.frames);
            if self.thinning.keeps(at_ns, Some(&pose.to_isometry()), 0.0) {
                self.pass(0, at_ns, self.image.encode(), session)?;
            } else {
                session.thin_frame()?;
            }
            let mut tag =
                FrameTag { header: stamp, sequence: u64::from(self.frames), valid: true, ..FrameTag::default() };
            (tag.pose.pose.position.x, tag.pose.pose.position.y) = (pose.x, pose.y);
            session.tag(at_ns, &self.map, &tag)?;
            self.frames += 1;
        }
        Ok(())
    }

    fn pass(
        &mut self,
        topic: usize,
        at_ns: i64,
        data: Vec<u8>,
        session: &mut SessionWriter,
    ) -> Result<(), RecordingError> {
        self.bytes += data.len() as u64;
        let channel = Arc::clone(&self.topics[topic]);
        let sequence = self.frames;
        let message = LogMessage { channel, sequence, log_time_ns: at_ns, publish_time_ns: at_ns, data };
        session.pass(&message, topic == 0, false)
    }
}
