//! A robot that walks as a log says: its camera at a socket, its microcontroller at the end of a serial line.

use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use glam::{DMat3, DQuat, DVec3};
use mavlink::dialects::common::{ATTITUDE_QUATERNION_DATA, MavFrame, MavMessage, ODOMETRY_DATA};
use mavlink::{MAVLinkV2MessageRaw, MavHeader, MavlinkReader, MavlinkVersion};
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use realitysim::devices::host_clock::monotonic_ns;
use realitysim::ros2::LogMessage;
use realitysim::ros2::messages::{CompressedImageView, Imu, Message, Odometry};

use crate::replay::support::{IMAGE, IMU, ODOMETRY};
use crate::serial::Cable;

pub struct Robot {
    cable: Cable,
    /// With their times since the first.
    events: Vec<(i64, Event)>,
}

enum Event {
    Frame(Vec<u8>),
    Measured(Box<MavMessage>),
}

/// The robot stands for so long before it walks: clocks settle.
const STANDS_NS: i64 = 4_000_000_000;
/// What its clock shows when it begins.
const UP_NS: i64 = 10_000_000_000;

impl Robot {
    pub fn of(messages: &[LogMessage]) -> Self {
        let stamp = |message: &LogMessage| message.log_time_ns;
        let first = messages.iter().filter(|m| m.channel.topic == ODOMETRY).map(stamp).min().expect("odometry");
        let mut events = Vec::new();
        for message in messages {
            let at_ns = STANDS_NS + message.log_time_ns - first;
            let event = match message.channel.topic.as_str() {
                IMAGE => Event::Frame(CompressedImageView::decode(&message.data).expect("an image").data.to_vec()),
                ODOMETRY => {
                    Event::Measured(Box::new(odometry(at_ns, &Odometry::decode(&message.data).expect("odometry"))))
                }
                IMU => Event::Measured(Box::new(attitude(at_ns, &Imu::decode(&message.data).expect("an IMU")))),
                _ => continue,
            };
            events.push((at_ns, event));
        }
        // Standing: the first measurements again and again.
        for kind in [ODOMETRY, IMU] {
            let message = messages.iter().find(|message| message.channel.topic == kind).expect("one");
            for at_ns in (0..STANDS_NS).step_by(20_000_000) {
                let measured = match kind {
                    ODOMETRY => odometry(at_ns, &Odometry::decode(&message.data).expect("odometry")),
                    _ => attitude(at_ns, &Imu::decode(&message.data).expect("an IMU")),
                };
                events.push((at_ns, Event::Measured(Box::new(measured))));
            }
        }
        events.sort_by_key(|(at_ns, _)| *at_ns);
        Self { cable: Cable::new(), events }
    }

    pub fn tty(&self) -> &str {
        &self.cable.ends[1]
    }

    pub fn frames(&self) -> usize {
        self.events.iter().filter(|(_, event)| matches!(event, Event::Frame(_))).count()
    }

    /// Poses that come back on its line, until it hangs up for half a second after some.
    pub fn listens(&self) -> JoinHandle<Vec<ODOMETRY_DATA>> {
        let line = std::fs::OpenOptions::new().read(true).open(&self.cable.ends[0]).expect("the line");
        std::thread::spawn(move || {
            let (mut bytes, mut quiet_since) = (Vec::new(), Instant::now());
            let mut buffer = [0; 4096];
            // The recorder asks for the time four times a second: silence is its end.
            while quiet_since.elapsed() < Duration::from_secs(if bytes.is_empty() { 60 } else { 2 }) {
                let patience = Timespec { tv_sec: 0, tv_nsec: 50_000_000 };
                if poll(&mut [PollFd::new(&line, PollFlags::IN)], Some(&patience)).is_ok_and(|ready| ready > 0) {
                    let count = (&line).read(&mut buffer).unwrap_or(0);
                    bytes.extend(&buffer[..count]);
                    quiet_since = Instant::now();
                }
            }
            let mut reader = MavlinkReader::new(std::io::Cursor::new(bytes));
            let mut poses = Vec::new();
            while let Ok((header, message)) = reader.read_message::<MavMessage>(MavlinkVersion::V2) {
                assert_eq!((header.system_id, header.component_id), (1, 197));
                if let MavMessage::ODOMETRY(pose) = message {
                    poses.push(pose);
                }
            }
            poses
        })
    }

    /// In real time, to the end; the frames' stamps, and itself: its line stays open.
    pub fn walk(self, camera: &Path) -> (Vec<i64>, Self) {
        let mut line = std::fs::OpenOptions::new().write(true).open(&self.cable.ends[0]).expect("the line");
        let (began, began_ns) = (Instant::now(), monotonic_ns());
        let (mut socket, mut stamps) = (None, Vec::new());
        let mut header = MavHeader { system_id: 1, component_id: 1, sequence: 0 };
        for (at_ns, event) in &self.events {
            let due = Duration::from_nanos(*at_ns as u64);
            std::thread::sleep(due.saturating_sub(began.elapsed()));
            match event {
                Event::Measured(message) => {
                    let mut raw = MAVLinkV2MessageRaw::new();
                    raw.serialize_message(header, message.as_ref());
                    header.sequence = header.sequence.wrapping_add(1);
                    line.write_all(raw.raw_bytes()).expect("sent");
                }
                Event::Frame(jpeg) => {
                    let connect = || UnixStream::connect(camera).expect("a recorder");
                    let to_recorder = socket.get_or_insert_with(connect);
                    let stamp_ns = began_ns + at_ns;
                    let mut bytes = b"RSF1".to_vec();
                    bytes.extend((jpeg.len() as u32).to_le_bytes());
                    bytes.extend((stamps.len() as u32).to_le_bytes());
                    bytes.extend(stamp_ns.to_le_bytes());
                    bytes.extend(jpeg);
                    // Who has sent nothing for a while has been hung up on.
                    if to_recorder.write_all(&bytes).is_err() {
                        *to_recorder = connect();
                        to_recorder.write_all(&bytes).expect("sent");
                    }
                    stamps.push(stamp_ns);
                }
            }
        }
        // The last frame waits for what is measured after it.
        std::thread::sleep(Duration::from_millis(500));
        (stamps, self)
    }
}

fn odometry(at_ns: i64, odometry: &Odometry) -> MavMessage {
    let (p, q) = (&odometry.pose.pose.position, &odometry.pose.pose.orientation);
    let twist = &odometry.twist.twist;
    MavMessage::ODOMETRY(ODOMETRY_DATA {
        time_usec: ((UP_NS + at_ns) / 1_000) as u64,
        frame_id: MavFrame::MAV_FRAME_LOCAL_FLU,
        child_frame_id: MavFrame::MAV_FRAME_LOCAL_FLU,
        x: p.x as f32,
        y: p.y as f32,
        z: p.z as f32,
        q: [q.w, q.x, q.y, q.z].map(|part| part as f32),
        vx: twist.linear.x as f32,
        vy: twist.linear.y as f32,
        yawspeed: twist.angular.z as f32,
        pose_covariance: [f32::NAN; 21],
        velocity_covariance: [f32::NAN; 21],
        ..ODOMETRY_DATA::DEFAULT
    })
}

/// As an aircraft would say it: FRD in NED. By matrices, unlike the program.
fn attitude(at_ns: i64, imu: &Imu) -> MavMessage {
    let q = &imu.orientation;
    let enu_from_flu = DMat3::from_quat(DQuat::from_xyzw(q.x, q.y, q.z, q.w));
    let ned_from_enu = DMat3::from_cols(DVec3::Y, DVec3::X, -DVec3::Z);
    let flu_from_frd = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    let q = DQuat::from_mat3(&(ned_from_enu * enu_from_flu * flu_from_frd));
    let rate = &imu.angular_velocity;
    MavMessage::ATTITUDE_QUATERNION(ATTITUDE_QUATERNION_DATA {
        time_boot_ms: ((UP_NS + at_ns) / 1_000_000) as u32,
        q1: q.w as f32,
        q2: q.x as f32,
        q3: q.y as f32,
        q4: q.z as f32,
        rollspeed: rate.x as f32,
        pitchspeed: -rate.y as f32,
        yawspeed: -rate.z as f32,
        ..ATTITUDE_QUATERNION_DATA::DEFAULT
    })
}
