//! What a watched recorder sees, over the WebSocket protocol of Foxglove: for Foxglove and Lichtblick.
//!
//! Topics and messages are those of `export --to foxglove`. Viewers only read: nothing that they send reaches the recorder. The topics
//! stay while the robot is away, and `/diagnostics` says why it is. All times are those of the robot's clock, so that images,
//! transforms and status lie on one line of time.

use std::collections::BTreeMap;
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime};

use foxglove::{Context, FoxgloveError, PartialMetadata, RawChannel, Schema, WebSocketServerHandle};

use super::remote::{RemoteRecorder, WatchedRecorder};
use super::viewer_connections::ViewerConnections;
use super::watched_frame::WatchedFrame;
use crate::ros2::messages::{
    CameraInfo, CompressedImage, DiagnosticArray, DiagnosticStatus, FrameTag, Header, ImageAnnotations, KeyValue,
    MarkerArray, Message, PoseWithCovarianceStamped, TFMessage,
};
use crate::ros2::topics::{CAMERA_TF, DIAGNOSTICS, DIAGNOSTICS_PREFIX, FRAME_TAG, POSE};
use crate::viewer_messages::{
    CAMERA_INFO, FIELD_LINES, IMAGE_LINES, MessageSink, at_tagged_camera, field_markers, put_tag,
};

/// A server of the protocol. Dropping it ends it.
#[derive(Debug)]
pub struct ViewerServer {
    /// Where viewers connect; they are passed on to the server.
    connections: ViewerConnections,
    server: Option<WebSocketServerHandle>,
    /// Its channels end with it.
    _context: Arc<Context>,
    stop: Arc<AtomicBool>,
    publisher: Option<JoinHandle<()>>,
}

/// Messages that wait for a slow viewer: some five frames. It misses the oldest beyond, so that a thin link carries fewer.
const MAX_MESSAGES_BEHIND: usize = 32;
/// Time between two looks for a new frame.
const TICK: Duration = Duration::from_millis(50);
/// Time between two repetitions of status and field, which a viewer that came later has not seen.
const REPEAT_EVERY: Duration = Duration::from_secs(1);

impl ViewerServer {
    /// Begins to serve on an address; port 0 takes a free one. Images go to `image_topic`.
    pub fn start(robot: Arc<RemoteRecorder>, listen: SocketAddr, image_topic: &str) -> Result<Self, FoxgloveError> {
        let context = Context::new();
        let channels = Channels::open(&context, image_topic)?;
        let loopback = Ipv4Addr::LOCALHOST;
        let server = context.websocket_server().name("realitysim live").bind(loopback.to_string(), 0);
        let server = server.message_backlog_size(MAX_MESSAGES_BEHIND).start_blocking()?;
        let behind = SocketAddr::from((loopback, server.port()));
        let connections = ViewerConnections::listen(listen, behind).map_err(FoxgloveError::Bind)?;
        let stop = Arc::<AtomicBool>::default();
        let is_over = Arc::clone(&stop);
        let publish = move || publish(&robot, channels, &is_over);
        let publisher = std::thread::Builder::new().name("viewers".to_owned()).spawn(publish);
        let publisher = Some(publisher.map_err(FoxgloveError::Bind)?);
        Ok(Self { connections, server: Some(server), _context: context, stop, publisher })
    }

    /// Returns where it listens.
    pub fn address(&self) -> SocketAddr {
        self.connections.address()
    }
}

impl Drop for ViewerServer {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(publisher) = self.publisher.take() {
            let _ = publisher.join();
        }
        if let Some(server) = self.server.take() {
            server.stop().wait_blocking();
        }
    }
}

/// Sends each new frame, and status and field again and again, until it is told to stop.
fn publish(robot: &RemoteRecorder, mut channels: Channels, stop: &AtomicBool) {
    let mut shown: Option<Arc<WatchedFrame>> = None;
    let mut repeated: Option<Instant> = None;
    while !stop.load(Ordering::Relaxed) {
        let watched = robot.watched(channels.wants_frames());
        // A message that cannot be sent is missed, as by a viewer that is slow.
        if let Some(frame) = &watched.frame
            && !shown.as_ref().is_some_and(|shown| Arc::ptr_eq(shown, frame))
        {
            shown = Some(Arc::clone(frame));
            let _ = channels.put_frame(frame);
        }
        if repeated.is_none_or(|at| at.elapsed() >= REPEAT_EVERY) {
            repeated = Some(Instant::now());
            let _ = channels.put_status(&watched);
        }
        std::thread::sleep(TICK);
    }
}

/// The topics, by name.
struct Channels {
    topics: BTreeMap<String, Arc<RawChannel>>,
    image_topic: String,
}

impl Channels {
    fn open(context: &Arc<Context>, image_topic: &str) -> Result<Self, FoxgloveError> {
        let mut channels = Self { topics: BTreeMap::new(), image_topic: image_topic.to_owned() };
        channels.add::<CompressedImage>(context, image_topic)?;
        channels.add::<CameraInfo>(context, CAMERA_INFO)?;
        channels.add::<ImageAnnotations>(context, IMAGE_LINES)?;
        channels.add::<TFMessage>(context, CAMERA_TF)?;
        channels.add::<PoseWithCovarianceStamped>(context, POSE)?;
        channels.add::<FrameTag>(context, FRAME_TAG)?;
        channels.add::<MarkerArray>(context, FIELD_LINES)?;
        channels.add::<DiagnosticArray>(context, DIAGNOSTICS)?;
        Ok(channels)
    }

    fn add<M: Message>(&mut self, context: &Arc<Context>, topic: &str) -> Result<(), FoxgloveError> {
        let schema = Schema::new(M::TYPE, "ros2msg", M::DEFINITION.as_bytes());
        let channel = context.channel_builder(topic).message_encoding("cdr").schema(schema).build_raw()?;
        self.topics.insert(topic.to_owned(), channel);
        Ok(())
    }

    /// Whether somebody has subscribed to anything but the status, for which no frame is needed.
    fn wants_frames(&self) -> bool {
        self.topics.iter().any(|(topic, channel)| topic != DIAGNOSTICS && channel.has_sinks())
    }

    fn put_frame(&mut self, frame: &WatchedFrame) -> anyhow::Result<()> {
        let WatchedFrame { tag, lens, field, picture, .. } = frame;
        let time_ns = tag.header.stamp.to_nanoseconds();
        if !picture.is_empty() {
            let format = if picture.starts_with(b"\x89PNG") { "png" } else { "jpeg" }.to_owned();
            let image = CompressedImage { header: at_tagged_camera(&tag.header), format, data: picture.clone() };
            let topic = self.image_topic.clone();
            self.put(&topic, time_ns, &image)?;
        }
        put_tag(self, time_ns, tag, lens, field)
    }

    fn put_status(&mut self, watched: &WatchedRecorder) -> anyhow::Result<()> {
        let now_ns = robot_time_ns(watched);
        if let Some(frame) = &watched.frame {
            let header = Header::at(now_ns, &frame.tag.header.frame_id);
            self.put(FIELD_LINES, now_ns, &field_markers(&frame.field, header))?;
        }
        self.put(DIAGNOSTICS, now_ns, &status_message(watched, now_ns))
    }
}

impl MessageSink for Channels {
    fn put<M: Message>(&mut self, topic: &str, time_ns: i64, message: &M) -> anyhow::Result<()> {
        if let Some(channel) = self.topics.get(topic).filter(|channel| channel.has_sinks()) {
            let log_time = u64::try_from(time_ns).unwrap_or(0);
            channel.log_with_meta(&message.encode(), PartialMetadata::with_log_time(log_time));
        }
        Ok(())
    }
}

/// The time on the robot's clock, as far as its latest frame tells; this machine's before the first.
fn robot_time_ns(watched: &WatchedRecorder) -> i64 {
    let since = |at: SystemTime| at.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let (from_ns, past) = match &watched.frame {
        Some(frame) => (frame.tag.header.stamp.to_nanoseconds(), frame.came.elapsed()),
        None => (0, since(SystemTime::now())),
    };
    from_ns.saturating_add(i64::try_from(past.as_nanos()).unwrap_or(i64::MAX))
}

/// The recorder's status as the panel for diagnostics shows it: a line of it is a value.
fn status_message(watched: &WatchedRecorder, now_ns: i64) -> DiagnosticArray {
    let value = |line: &String| {
        let (key, value) = line.split_once(": ").unwrap_or(("", line));
        KeyValue { key: key.to_owned(), value: value.to_owned() }
    };
    let (level, message) = match (watched.connected, watched.why.as_str()) {
        (true, "") => (DiagnosticStatus::OK, watched.words.first().map_or("", String::as_str)),
        (true, why) => (DiagnosticStatus::WARN, why),
        (false, why) => (DiagnosticStatus::ERROR, why),
    };
    let status = DiagnosticStatus {
        level,
        name: format!("{DIAGNOSTICS_PREFIX}live"),
        message: message.to_owned(),
        hardware_id: watched.robot.clone(),
        values: watched.words.iter().map(value).collect(),
    };
    DiagnosticArray { header: Header::at(now_ns, ""), status: vec![status] }
}
