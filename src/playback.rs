//! Plays a recording in real time to the devices of a robot, so that the robot's software runs on it unchanged.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use jpeg_encoder::ColorType;
use serde::Serialize;
use serialport::SerialPort;
use thiserror::Error;

use crate::database::{DatabaseError, ImageDatabase, ViewQuery};
use crate::devices::mavlink::RobotSide;
use crate::devices::video_out::{OutputForm, VideoOut, VideoOutError, yuyv};
use crate::geometry::{Isometry, Pose2};
use crate::log_input::log::{self, LogError, LogSource};
use crate::log_input::measurement::{self, Measurement};
use crate::log_input::{decode, encode};
use crate::recording::{RecordingError, SESSION_FILE, captures_within, read_info};
use crate::ros2::mcap_read::Selection;
use crate::ros2::messages::CompressedImageView;
use crate::views::{FAR_M, Method};

/// What to play, and where to.
#[derive(Clone, Debug)]
pub struct PlayOptions {
    pub source: PlaySource,
    pub video: Option<PathBuf>,
    /// Device and baud rate.
    pub serial: Option<(String, u32)>,
    /// Speed relative to the recording.
    pub speed: f64,
    /// MAVLink system number of the robot.
    pub system: u8,
}

/// Where images and motion come from.
#[derive(Clone, Debug)]
pub enum PlaySource {
    Capture(PathBuf),
    /// Seconds and poses of `camera_link` in `map`; the images are views of a database.
    Trajectory {
        poses: Vec<(f64, Isometry)>,
        database: PathBuf,
        settings: crate::config::ViewsSettings,
    },
}

/// Counts of what was played.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Played {
    pub images: u64,
    pub odometry: u64,
    pub attitudes: u64,
    /// Events that could not be written because the device was away, and poses of which no view could be made.
    pub lost: u64,
    /// Events that were played more than `LATE` after their time.
    pub late: u64,
    /// Views with a warning; `doubt` is the first warning.
    pub doubtful: u64,
    pub doubt: Option<String>,
    pub seconds: f64,
}

impl Played {
    fn is_nothing(&self) -> bool {
        [self.images, self.odometry, self.attitudes, self.lost].iter().all(|count| *count == 0)
    }
}

#[derive(Debug, Error)]
pub enum PlayError {
    #[error(transparent)]
    Session(#[from] RecordingError),
    #[error(transparent)]
    Log(#[from] LogError),
    #[error(transparent)]
    Database(#[from] DatabaseError),
    #[error(transparent)]
    Video(#[from] VideoOutError),
    #[error("{device}: {source}")]
    Serial { device: String, source: serialport::Error },
    #[error(
        "{}: no capture, for there is no session.json with it; `realitysim replay LOG -o DIR` makes one of a log{}",
        .0.display(),
        captures_within(.0)
    )]
    NotACapture(PathBuf),
    #[error("{}: nothing in it can be played: {what}", path.display())]
    Nothing { path: PathBuf, what: String },
}

/// An event to be played at its time.
enum Event {
    Image(Vec<u8>),
    Odometry(Pose2),
    Attitude(glam::DQuat, Option<glam::DVec3>),
}

const LATE: Duration = Duration::from_millis(100);
/// Longest sleep, and so the delay until a stop is noticed.
const POLL_INTERVAL: Duration = Duration::from_millis(20);
/// Longer gaps in a recording are cut to this.
const MAX_GAP: Duration = Duration::from_secs(2);
/// Time between two attempts to reopen a device that went away.
const REOPEN_INTERVAL: Duration = Duration::from_millis(500);
const HEARTBEAT_EVERY: Duration = Duration::from_secs(1);
const SERIAL_TIMEOUT: Duration = Duration::from_millis(200);
/// Device time at the start: a device time of 0 means that there is none.
const BOOT_NS: i64 = 1_000_000_000;
const JPEG_QUALITY: u8 = 90;

/// Plays until the end of the source or until `stop`.
pub fn play(options: &PlayOptions, stop: &AtomicBool) -> Result<Played, PlayError> {
    match &options.source {
        PlaySource::Capture(path) => play_capture(options, path, stop),
        PlaySource::Trajectory { poses, database, settings } => {
            let database = ImageDatabase::open(database, settings)?;
            play_trajectory(options, poses, &database, stop)
        }
    }
}

fn play_capture(options: &PlayOptions, path: &Path, stop: &AtomicBool) -> Result<Played, PlayError> {
    let folder = if path.is_dir() { path } else { path.parent().unwrap_or(path) };
    if !folder.join(SESSION_FILE).is_file() {
        return Err(PlayError::NotACapture(path.to_owned()));
    }
    let info = read_info(folder)?;
    let topics = &info.settings.topics;
    let wanted = [topics.image.as_str(), topics.odometry.as_str(), topics.imu.as_str()];
    let messages = LogSource::new(log::files_of(path)?, Selection::topics(wanted));
    let mut player = Player::new(options, [info.lens.width, info.lens.height], stop)?;
    let mut first_ns = None;
    for message in messages {
        let message = message?;
        let since_ns = message.log_time_ns.saturating_sub(*first_ns.get_or_insert(message.log_time_ns));
        let event = match measurement::read(&message, topics, &info.settings.head) {
            Ok(Measurement::Frame { .. }) => image_of(&message).map(Event::Image),
            Ok(Measurement::Odometry { odom_from_footprint, .. }) => Some(Event::Odometry(odom_from_footprint)),
            Ok(Measurement::Imu { orientation: Some(q), turn_rate, .. }) => Some(Event::Attitude(q, turn_rate)),
            Ok(Measurement::LowState { inertial: Some(torso), .. }) => {
                torso.orientation.map(|q| Event::Attitude(q, Some(torso.turn_rate)))
            }
            _ => None,
        };
        if let Some(event) = event
            && !player.play(since_ns, &event, stop)
        {
            break;
        }
    }
    let played = player.played();
    if played.is_nothing() && !stop.load(Ordering::Relaxed) {
        let images = options.video.iter().map(|_| format!("no image on {}", topics.image));
        let steps =
            options.serial.iter().map(|_| format!("no odometry on {}, no attitude on {}", topics.odometry, topics.imu));
        let what = images.chain(steps).collect::<Vec<_>>().join(", ");
        let what = format!("{what}, where its session.json (settings.topics) says that they are");
        return Err(PlayError::Nothing { path: path.to_owned(), what });
    }
    Ok(played)
}

/// Returns the stored JPEG, or one encoded from raw pixels.
fn image_of(message: &crate::ros2::mcap_read::LogMessage) -> Option<Vec<u8>> {
    if message.channel.type_name == "sensor_msgs/msg/CompressedImage" {
        let image = CompressedImageView::decode(&message.data).ok()?;
        if image.data.starts_with(&[0xff, 0xd8]) {
            return Some(image.data.to_vec());
        }
    }
    let picture = decode::picture(message).ok()?;
    jpeg(&picture.to_rgb(), picture.width, picture.height)
}

fn jpeg(rgb: &[u8], width: usize, height: usize) -> Option<Vec<u8>> {
    encode::jpeg(rgb, width, height, ColorType::Rgb, JPEG_QUALITY).ok()
}

/// Plays views along a trajectory. Odometry is the camera's own pose over the ground, since nothing says where the feet
/// are.
fn play_trajectory(
    options: &PlayOptions,
    poses: &[(f64, Isometry)],
    database: &ImageDatabase,
    stop: &AtomicBool,
) -> Result<Played, PlayError> {
    let mut player: Option<Player> = None;
    let mut camera = None;
    for (seconds, pose) in poses {
        let wanted = ViewQuery {
            map_from_link: *pose,
            method: Method::Exact,
            camera: camera.clone(),
            max_distance_m: f64::INFINITY,
            may_be_stored: true,
            without: Vec::new(),
        };
        let shown = match (database.view(&wanted), &mut player) {
            (Ok(shown), _) => shown,
            // Counted as a frame that a camera drops: the walk goes on.
            (Err(DatabaseError::View(_) | DatabaseError::Image { .. }), Some(player)) => {
                player.played.lost += 1;
                continue;
            }
            (Err(error), _) => return Err(error.into()),
        };
        let image = &shown.answer.image;
        let (width, height) = (image.width, image.height);
        camera.get_or_insert_with(|| shown.camera.clone());
        let stored = shown.stored.filter(|bytes| bytes.starts_with(&[0xff, 0xd8]));
        let bytes = stored.or_else(|| jpeg(&image.to_rgb(), width, height));
        let player = match &mut player {
            Some(player) => player,
            none => none.insert(Player::new(options, [width as u32, height as u32], stop)?),
        };
        if let Some(why) = shown.answer.warning(FAR_M) {
            player.played.doubtful += 1;
            player.played.doubt.get_or_insert(why);
        }
        let since_ns = (seconds * 1e9) as i64;
        let events = [Some(Event::Odometry(Pose2::from_isometry(pose))), bytes.map(Event::Image)];
        if !events.iter().flatten().all(|event| player.play(since_ns, event, stop)) {
            break;
        }
    }
    Ok(player.map(|player| player.played()).unwrap_or_default())
}

/// The output devices and the playback clock.
struct Player<'a> {
    options: &'a PlayOptions,
    size: (u32, u32),
    video: ReconnectingDevice<VideoOut>,
    serial: ReconnectingDevice<Box<dyn SerialPort>>,
    robot: RobotSide,
    started: Instant,
    /// Time of the recording that was left out in gaps.
    skipped: Duration,
    last: Duration,
    beat: Option<Instant>,
    played: Played,
}

impl<'a> Player<'a> {
    /// Opens the devices. One that is absent at the start is an error, since its name may be wrong.
    fn new(options: &'a PlayOptions, [width, height]: [u32; 2], stop: &AtomicBool) -> Result<Self, PlayError> {
        let video = options.video.as_ref().map(|path| open_video(path, [width, height], stop)).transpose()?;
        let serial = options.serial.as_ref().map(open_port).transpose()?;
        Ok(Self {
            options,
            size: (width, height),
            video: ReconnectingDevice::new(video),
            serial: ReconnectingDevice::new(serial),
            robot: RobotSide::new(options.system),
            started: Instant::now(),
            skipped: Duration::ZERO,
            last: Duration::ZERO,
            beat: None,
            played: Played::default(),
        })
    }

    /// Waits for the event's time and writes it. Returns whether to go on.
    fn play(&mut self, since_ns: i64, event: &Event, stop: &AtomicBool) -> bool {
        let recorded = Duration::from_nanos(since_ns.max(0) as u64);
        let gap = recorded.saturating_sub(self.last);
        self.skipped += gap.saturating_sub(MAX_GAP);
        self.last = self.last.max(recorded);
        let due = self.started + recorded.saturating_sub(self.skipped).div_f64(self.options.speed);
        loop {
            let wait = due.saturating_duration_since(Instant::now());
            if stop.load(Ordering::Relaxed) {
                return false;
            }
            if wait.is_zero() {
                break;
            }
            std::thread::sleep(wait.min(POLL_INTERVAL));
        }
        self.played.late += u64::from(due.elapsed() > LATE);
        self.write(since_ns.saturating_add(BOOT_NS), event);
        !stop.load(Ordering::Relaxed)
    }

    fn write(&mut self, boot_ns: i64, event: &Event) {
        if self.beat.is_none_or(|beat| beat.elapsed() >= HEARTBEAT_EVERY) {
            self.beat = Some(Instant::now());
            let bytes = self.robot.heartbeat();
            self.send(&bytes);
        }
        match event {
            Event::Image(jpeg) => {
                let (options, (width, height)) = (self.options, self.size);
                let open = || VideoOut::open(options.video.as_ref()?, width, height).ok();
                let done = self.video.with(open, |video| match video.form {
                    OutputForm::Mjpeg => video.show(jpeg),
                    OutputForm::Yuyv => match decode::compressed(jpeg) {
                        Ok(picture) => video.show(&yuyv(&picture.to_rgb(), picture.width)),
                        Err(_) => Ok(()),
                    },
                });
                self.count(done, |played| &mut played.images);
            }
            Event::Odometry(pose) => {
                let bytes = self.robot.odometry(boot_ns, &pose.to_isometry());
                let done = self.send(&bytes);
                self.count(done, |played| &mut played.odometry);
            }
            Event::Attitude(orientation, rate) => {
                let bytes = self.robot.attitude(boot_ns, *orientation, rate.unwrap_or_default());
                let mut done = self.send(&bytes);
                if let Some(rate) = rate {
                    let bytes = self.robot.turn_rate(boot_ns, *rate);
                    done = done.and(self.send(&bytes));
                }
                self.count(done, |played| &mut played.attitudes);
            }
        }
    }

    /// Writes to the serial port. `None` if no serial port is asked for, else whether it was written.
    fn send(&mut self, bytes: &[u8]) -> Option<bool> {
        let options = self.options;
        let open = || open_port(options.serial.as_ref()?).ok();
        self.serial.with(open, |serial| serial.write_all(bytes))
    }

    fn count(&mut self, done: Option<bool>, of: impl Fn(&mut Played) -> &mut u64) {
        match done {
            Some(true) => *of(&mut self.played) += 1,
            Some(false) => self.played.lost += 1,
            None => {}
        }
    }

    fn played(&self) -> Played {
        Played { seconds: self.started.elapsed().as_secs_f64(), ..self.played.clone() }
    }
}

/// Opens the video output. Waits for the reader of a pipe, which may come later.
fn open_video(path: &Path, [width, height]: [u32; 2], stop: &AtomicBool) -> Result<VideoOut, VideoOutError> {
    loop {
        match VideoOut::open(path, width, height) {
            Err(error) if error.nobody_reads() && !stop.load(Ordering::Relaxed) => std::thread::sleep(POLL_INTERVAL),
            opened => return opened,
        }
    }
}

fn open_port((device, baud): &(String, u32)) -> Result<Box<dyn SerialPort>, PlayError> {
    let opened = serialport::new(device, *baud).timeout(SERIAL_TIMEOUT).open();
    opened.map_err(|source| PlayError::Serial { device: device.clone(), source })
}

/// A device that may go away and come back.
struct ReconnectingDevice<T> {
    device: Option<T>,
    /// Whether the device is asked for: it was open at the start.
    wanted: bool,
    tried: Instant,
}

impl<T> ReconnectingDevice<T> {
    fn new(device: Option<T>) -> Self {
        Self { wanted: device.is_some(), device, tried: Instant::now() }
    }

    /// Runs `work` on the device, reopening it if need be. Returns whether that worked; `None` if the device is not asked
    /// for.
    fn with(
        &mut self,
        open: impl FnOnce() -> Option<T>,
        work: impl FnOnce(&mut T) -> std::io::Result<()>,
    ) -> Option<bool> {
        if !self.wanted {
            return None;
        }
        if self.device.is_none() && self.tried.elapsed() >= REOPEN_INTERVAL {
            self.tried = Instant::now();
            self.device = open();
        }
        let done = self.device.as_mut().is_some_and(|device| work(device).is_ok());
        if !done && self.device.take().is_some() {
            self.tried = Instant::now();
        }
        Some(done)
    }
}
