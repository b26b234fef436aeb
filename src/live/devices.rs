//! Threads that read the devices: one for the camera, one for each serial port.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;

use crossbeam_channel::{Sender, TrySendError};
use glam::{DQuat, DVec3};

use super::messages::Messages;
use crate::config::Settings;
use crate::devices::camera::{
    CameraError, CameraOptions, Capture, CaptureEvent, CaptureRules, Driver, Frame, ImageMessage, Negotiated,
    Republished, StampClock, driver_of, image_message,
};
use crate::devices::host_clock::monotonic_ns;
use crate::devices::serial::{PortEvent, PortOptions, Pose, run};
use crate::geometry::Isometry;
use crate::ros2::mcap_read::LogMessage;
use crate::ros2::messages::{FrameTag, Header};

/// Something that a device thread reports to the event loop.
pub enum DeviceEvent {
    CameraOpened(Negotiated),
    CameraLost {
        cause: &'static str,
        said: String,
    },
    /// Frames that the camera made and that were dropped on the way.
    Dropped {
        cause: &'static str,
        count: u64,
    },
    Frame {
        message: LogMessage,
        clock: StampClock,
    },
    Port {
        device: String,
        event: PortEvent,
    },
}

/// Events that can wait between the devices and the event loop: one second of measurements at 1 kHz.
const MAX_EVENTS: usize = 1024;
/// Frames among them. With more, the event loop is behind and the newest frames are dropped.
const MAX_FRAMES: u64 = 16;

/// Poses that can wait for a serial port; a slower port misses some.
const MAX_POSES: usize = 4;

/// Channel from the device threads to the event loop.
pub fn channel() -> (Sender<DeviceEvent>, crossbeam_channel::Receiver<DeviceEvent>) {
    crossbeam_channel::bounded(MAX_EVENTS)
}

/// Handles of the device threads.
pub struct Devices {
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
    /// Rounds of the camera's thread. The watchdog notices when the count stands still.
    pub rounds: Arc<AtomicU64>,
    /// Frames that were sent and not yet taken by the event loop.
    pub waiting: Arc<AtomicU64>,
    /// Counts and state of the frames that are passed on to another video device.
    pub republished: Arc<Republished>,
    /// Senders to the ports that want poses.
    poses: Vec<Sender<Pose>>,
}

impl Devices {
    /// Starts all device threads. `size` is the lens's width and height in pixels, `clock_ns` is UTC minus monotonic clock, nanoseconds.
    pub fn start(settings: &Settings, size: (u32, u32), clock_ns: i64, events: &Sender<DeviceEvent>) -> Self {
        let (stop, rounds, waiting) = (Arc::new(AtomicBool::new(false)), Arc::default(), Arc::default());
        let (mut threads, mut poses) = (Vec::new(), Vec::new());
        for port in &settings.serial.ports {
            let wanted = port.poses.then(|| crossbeam_channel::bounded(MAX_POSES));
            let (send, receive) = wanted.map_or((None, None), |(send, receive)| (Some(send), Some(receive)));
            poses.extend(send);
            let options = PortOptions {
                device: port.device.clone(),
                baud: port.baud,
                system: settings.serial.system_id,
                poses: receive,
            };
            let (stop, events) = (Arc::clone(&stop), events.clone());
            threads.push(std::thread::spawn(move || {
                run(&options, &stop, |event| {
                    // Measurements are small and must not be lost: the port's thread waits for room in the channel.
                    let _ = events.send(DeviceEvent::Port { device: options.device.clone(), event });
                });
            }));
        }
        let camera = CameraThread {
            settings: settings.clone(),
            clock_ns,
            stop: Arc::clone(&stop),
            rounds: Arc::clone(&rounds),
            waiting: Arc::clone(&waiting),
            events: events.clone(),
            republished: Arc::default(),
        };
        let republished = Arc::clone(&camera.republished);
        threads.push(std::thread::spawn(move || camera.run(size)));
        Self { stop, threads, rounds, waiting, republished, poses }
    }

    /// Sends a valid tag to the ports that want poses; a port whose queue is full misses it.
    pub fn send_tag(&self, tag: &FrameTag, utc_offset_ns: i64) {
        if self.poses.is_empty() || !tag.valid {
            return;
        }
        let (p, q) = (&tag.pose.pose.position, &tag.pose.pose.orientation);
        let pose = Pose {
            stamp_ns: tag.header.stamp.to_nanoseconds().saturating_sub(utc_offset_ns),
            map_from_camera_link: Isometry::new(DQuat::from_xyzw(q.x, q.y, q.z, q.w), DVec3::new(p.x, p.y, p.z)),
            covariance: tag.pose.covariance,
        };
        for port in &self.poses {
            let _ = port.try_send(pose.clone());
        }
    }

    /// Asks all threads to end.
    pub fn stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    /// Waits for the threads. Call it after [`stop`](Self::stop), while the events are still being taken or after their
    /// receiver is dropped.
    pub fn join(self) {
        for thread in self.threads {
            // A thread that panicked has already printed its message.
            let _ = thread.join();
        }
    }
}

struct CameraThread {
    settings: Settings,
    /// UTC minus monotonic clock, nanoseconds.
    clock_ns: i64,
    stop: Arc<AtomicBool>,
    rounds: Arc<AtomicU64>,
    waiting: Arc<AtomicU64>,
    events: Sender<DeviceEvent>,
    republished: Arc<Republished>,
}

impl CameraThread {
    fn run(self, size: (u32, u32)) {
        let capture = &self.settings.capture;
        let options = CameraOptions::new(capture, size);
        let max_rate_hz = (capture.max_rate_hz > 0.0).then_some(capture.max_rate_hz);
        let rules = CaptureRules { options, max_rate_hz };
        let republish = capture.republish.as_deref().map(|device| (device, Arc::clone(&self.republished)));
        match driver_of(&rules.options.device, republish) {
            Ok(driver) => self.capture_frames(Capture::new(driver, rules)),
            Err(error) => self.report_lost(&error),
        }
    }

    fn capture_frames(self, mut capture: Capture<Box<dyn Driver>>) {
        let (mut messages, mut negotiated, mut done) = (Messages::default(), None, Vec::new());
        let mut last: Option<&'static str> = None;
        while !self.stop.load(Ordering::Relaxed) {
            self.rounds.fetch_add(1, Ordering::Relaxed);
            std::thread::sleep(capture.idle(monotonic_ns()));
            capture.step(monotonic_ns, |event| match event {
                CaptureEvent::Opened(camera) => {
                    if negotiated.as_ref() != Some(&camera) {
                        self.send_event(DeviceEvent::CameraOpened(camera.clone()));
                    }
                    negotiated = Some(camera);
                }
                CaptureEvent::Lost { error, .. } => {
                    // Each cause is reported once, not at every retry.
                    if last.replace(error.cause()) != Some(error.cause()) {
                        self.report_lost(&error);
                    }
                }
                CaptureEvent::Dropped(drop, count) => {
                    self.send_event(DeviceEvent::Dropped { cause: drop.cause(), count });
                }
                CaptureEvent::Frame(frame) => {
                    last = None;
                    if let Some(camera) = &negotiated {
                        done.extend(self.deliver(frame, camera, &mut messages));
                    }
                }
            });
            done.drain(..).for_each(|data| capture.give_back(data));
        }
    }

    fn report_lost(&self, error: &CameraError) {
        self.send_event(DeviceEvent::CameraLost { cause: error.cause(), said: error.to_string() });
    }

    /// Turns a frame into a message and sends it. Returns the frame's buffer, if there is one to be used again.
    fn deliver(&self, frame: Frame, camera: &Negotiated, messages: &mut Messages) -> Option<Vec<u8>> {
        if self.waiting.load(Ordering::Relaxed) >= MAX_FRAMES {
            self.send_event(DeviceEvent::Dropped { cause: "queue", count: 1 });
            return Some(frame.data);
        }
        let capture = &self.settings.capture;
        let delay_ns = (capture.delay_ms * 1e6) as i64;
        let clock = frame.clock;
        let stamp_ns = frame.stamp_ns.saturating_add(self.clock_ns).saturating_sub(delay_ns);
        let header = Header::at(stamp_ns, &self.settings.frames.camera_optical);
        let quality = (capture.jpeg_quality > 0).then_some(capture.jpeg_quality);
        let topic = self.settings.topics.image.as_str();
        let (message, room) = match image_message(frame, camera, quality, header) {
            Ok(ImageMessage::Compressed(image)) => (messages.message(topic, false, &image), image.data),
            Ok(ImageMessage::Raw(image)) => (messages.message(topic, false, &image), image.data),
            Err(_) => {
                self.send_event(DeviceEvent::Dropped { cause: "encode", count: 1 });
                return None;
            }
        };
        self.waiting.fetch_add(1, Ordering::Relaxed);
        self.send_event(DeviceEvent::Frame { message, clock });
        Some(room)
    }

    /// Sends an event, waiting while the channel is full.
    fn send_event(&self, event: DeviceEvent) {
        // A full channel means that the event loop is behind by a second. Waiting here makes the camera count its own
        // drops.
        let mut event = event;
        while let Err(TrySendError::Full(back)) = self.events.try_send(event) {
            if self.stop.load(Ordering::Relaxed) {
                return;
            }
            event = back;
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
    }
}
