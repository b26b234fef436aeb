//! What a robot's microcontroller sends: a stream of MAVLink, damaged, decoded as on the robot, and tagged together with the
//! images of the walk.

use glam::{DQuat, DVec3};
use mavlink::Message as _;
use mavlink::dialects::common::MavMessage;
use realitysim::config::Settings;
use realitysim::devices::mavlink::{Content, RobotSide};
use realitysim::devices::serial::Line;
use realitysim::geometry::Isometry;
use realitysim::ros2::messages::{Imu, Odometry, Pose, Quaternion, Stamp, Vector3};
use realitysim::ros2::{LogMessage, Message};

use crate::bytes;
use crate::case::{Case, Class, Finding, Outcome};
use crate::judge::{self, Judge};
use crate::support::{IMU, ODOMETRY, own_log};
use crate::walks::{options, replayed};

/// The device was started so long before the log begins.
const RUNS_NS: i64 = 5_000_000_000;

/// One frame on the wire, and when its last byte is there.
struct Sent {
    at_ns: i64,
    bytes: Vec<u8>,
}

pub fn run(case: &mut Case) -> Outcome {
    let walk = &case.walks.all[0];
    let first_ns = walk.messages[0].log_time_ns;
    let mut robot = RobotSide::new(1);
    let mut sent = vec![Sent { at_ns: RUNS_NS, bytes: robot.heartbeat() }];
    for message in &walk.messages {
        let at_ns = message.log_time_ns - first_ns + RUNS_NS;
        let bytes = match message.channel.topic.as_str() {
            IMU => {
                let imu = Imu::decode(&message.data).expect("sound");
                let q = imu.orientation;
                robot.attitude(at_ns, DQuat::from_xyzw(q.x, q.y, q.z, q.w), of(&imu.angular_velocity))
            }
            ODOMETRY => {
                let p = Odometry::decode(&message.data).expect("sound").pose.pose;
                let q = DQuat::from_xyzw(p.orientation.x, p.orientation.y, p.orientation.z, p.orientation.w);
                let place = DVec3::new(p.position.x, p.position.y, p.position.z);
                robot.odometry(at_ns, &Isometry { rotation: q, translation: place })
            }
            _ => continue,
        };
        sent.push(Sent { at_ns, bytes });
    }
    damage(case, &mut sent);
    let mut messages: Vec<LogMessage> = walk
        .messages
        .iter()
        .filter(|message| ![IMU, ODOMETRY].contains(&message.channel.topic.as_str()))
        .cloned()
        .collect();
    messages.extend(measured(walk_samples(&walk.messages), &sent, first_ns)?);
    messages.sort_by_key(|message| message.log_time_ns);
    let (source, captures) = (case.write("log.mcap", own_log(&messages)), case.path("captures"));
    let report = replayed(&options(source, captures.clone(), Settings::default()));
    judge::replay(&report, &captures, Judge { truth: Some(&walk.truth), mirrored: false })
}

fn damage(case: &mut Case, sent: &mut [Sent]) {
    let draw = &mut case.draw;
    let share = *draw.one_of(&[0.005, 0.05, 0.3, 1.0]);
    let way = draw.below(6);
    for frame in sent.iter_mut() {
        if !draw.chance(share) {
            continue;
        }
        match way {
            // As noise on the wire would; the checksum tells most of it.
            0 => bytes::damage(draw, &mut frame.bytes),
            // As a device that measures nonsense would.
            1..=3 => {
                let end = frame.bytes.len() - 2;
                let head = 10.min(end);
                bytes::number(draw, &mut frame.bytes[head..end], true);
                seal(&mut frame.bytes);
            }
            4 => frame.at_ns += *draw.one_of(&[50_000_000, 3_000_000_000, -20_000_000]),
            _ => frame.bytes.clear(),
        }
    }
    case.tell(format!("way {way} in a share of {share}"));
}

/// The right checksum of a frame of version 2.
fn seal(frame: &mut [u8]) {
    let Some(&[0xFD, length, .., low, middle, high]) = frame.first_chunk::<10>() else { return };
    let end = 10 + usize::from(length);
    if end + 2 <= frame.len() {
        let extra = MavMessage::extra_crc(u32::from_le_bytes([low, middle, high, 0]));
        let checksum = mavlink::calculate_crc(&frame[1..end], extra).to_le_bytes();
        frame[end..end + 2].copy_from_slice(&checksum);
    }
}

/// Messages whose channels and frames the new ones have.
fn walk_samples(messages: &[LogMessage]) -> [&LogMessage; 2] {
    [IMU, ODOMETRY].map(|topic| messages.iter().find(|message| message.channel.topic == topic).expect("in every walk"))
}

fn measured([imu, odometry]: [&LogMessage; 2], sent: &[Sent], first_ns: i64) -> Result<Vec<LogMessage>, Finding> {
    let mut line = Line::new(1, 0);
    let mut taken = Vec::new();
    // The host's clock began an hour before the device's.
    let host = |at_ns: i64| at_ns + 3_600_000_000_000;
    let mut now_ns = 0;
    for Sent { at_ns, bytes } in sent {
        now_ns = now_ns.max(*at_ns);
        let mut late = None;
        line.push(bytes, host(now_ns), |one| {
            late = late.or((one.stamp_ns > host(now_ns)).then_some(one.stamp_ns));
            taken.push((now_ns, one));
        });
        if let Some(stamp_ns) = late {
            return Err(Finding::new(Class::NotFinite, format!("measured at {stamp_ns}, after it came")));
        }
    }
    let mut messages = Vec::new();
    for (now_ns, one) in taken {
        let stamp = Stamp::from_nanoseconds(one.stamp_ns - host(RUNS_NS) + first_ns);
        let log_time_ns = now_ns - RUNS_NS + first_ns;
        let (sample, data, numbers) = match one.content {
            Content::Attitude(attitude) => {
                let mut content = Imu::decode(&imu.data).expect("sound");
                content.header.stamp = stamp;
                content.orientation = Quaternion::from(attitude.world_from_body);
                content.angular_velocity = to(attitude.angular_velocity);
                let q = attitude.world_from_body;
                (imu, content.encode(), [q.length(), attitude.angular_velocity.length()])
            }
            Content::Odometry(step) => {
                let mut content = Odometry::decode(&odometry.data).expect("sound");
                content.header.stamp = stamp;
                content.pose.pose = Pose::from(step.odom_from_body);
                let Isometry { rotation, translation } = step.odom_from_body;
                (odometry, content.encode(), [rotation.length(), translation.length()])
            }
            _ => continue,
        };
        if numbers.iter().any(|value| !value.is_finite()) {
            return Err(Finding::new(Class::NotFinite, format!("{} measures {numbers:?}", sample.channel.topic)));
        }
        messages.push(LogMessage { data, log_time_ns, publish_time_ns: log_time_ns, ..sample.clone() });
    }
    Ok(messages)
}

fn of(v: &Vector3) -> DVec3 {
    DVec3::new(v.x, v.y, v.z)
}

fn to(v: DVec3) -> Vector3 {
    Vector3 { x: v.x, y: v.y, z: v.z }
}
