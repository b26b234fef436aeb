//! Other ways in which robots say how they move: `/tf` in place of topics, a head that turns.

use realitysim::geometry::{Euler, Isometry};
use realitysim::ros2::messages::{
    Header, Imu, JointState, Odometry, Quaternion, TFMessage, Transform, TransformStamped,
};
use realitysim::ros2::{LogMessage, Message};

use super::support::{
    IMAGE, IMU, ODOMETRY, Room, TF, TF_STATIC, changed, decode_all, farthest_apart, message, on, walk, without,
};

fn transform(header: Header, parent: &str, child: &str, parent_from_child: Isometry) -> TransformStamped {
    TransformStamped {
        header: Header { frame_id: parent.into(), ..header },
        child_frame_id: child.into(),
        transform: Transform::from(parent_from_child),
    }
}

/// The constant between two frames of the walk's log.
fn constant(child: &str) -> Isometry {
    let all: Vec<TFMessage> = decode_all(&walk().messages, TF_STATIC);
    let found = all[0].transforms.iter().find(|transform| transform.child_frame_id == child);
    Isometry::from(found.unwrap().transform)
}

/// Each message of `topic` also as a transform on `/tf`, behind it.
fn as_transforms<M: Message>(
    messages: &[LogMessage],
    topic: &str,
    make: impl Fn(M) -> TransformStamped,
) -> Vec<LogMessage> {
    let mut result = Vec::new();
    for old in messages {
        if old.channel.topic == topic {
            let transforms = vec![make(M::decode(&old.data).unwrap())];
            result.push(message(901, TF, old.log_time_ns, &TFMessage { transforms }));
        } else {
            result.push(old.clone());
        }
    }
    result
}

/// Odometry and the torso's attitude in `/tf`, and neither `/odom` nor `/imu/data`.
fn in_tf() -> Vec<LogMessage> {
    let messages = as_transforms(&walk().messages, ODOMETRY, |odometry: Odometry| {
        transform(odometry.header, "odom", "base_footprint", odometry.pose.pose.into())
    });
    let torso = constant("base_link");
    let messages = as_transforms(&messages, IMU, |imu: Imu| {
        let tilt = Euler::from_rotation(imu.orientation.into());
        let leaning = Isometry::from_euler(Euler { yaw: 0.0, ..tilt }, torso.translation);
        transform(imu.header, "base_footprint", "base_link", leaning)
    });
    changed::<TFMessage>(&messages, TF_STATIC, |constants| {
        constants.transforms.retain(|transform| transform.child_frame_id != "base_link");
    })
}

#[test]
fn odometry_and_attitude_in_tf_give_tags_as_good() {
    let room = Room::with_log(&in_tf());
    let replayed = room.replay("log.mcap --field kid-2009");
    assert_eq!(replayed.run.code, Some(0), "{:?}", replayed.run);
    let apart = farthest_apart(&replayed.tags, &walk().tags);
    assert!(apart < 0.02, "{apart} m");
    assert_eq!(replayed.count("valid"), walk().tags.iter().filter(|tag| tag.valid).count());
    assert_eq!(replayed.report["warnings"], serde_json::json!([]), "/tf says how the torso is tilted");
}

#[test]
fn a_log_with_nothing_but_tf_gives_tags_as_good() {
    // Some robots send their constants again and again, on /tf.
    let constants: TFMessage = decode_all(&in_tf(), TF_STATIC).remove(0);
    let mut messages = Vec::new();
    for old in without(&in_tf(), TF_STATIC) {
        if old.channel.topic == TF || messages.is_empty() {
            let stamp = realitysim::ros2::messages::Stamp::from_nanoseconds(old.log_time_ns);
            let mut again = constants.clone();
            again.transforms.iter_mut().for_each(|transform| transform.header.stamp = stamp);
            messages.push(message(901, TF, old.log_time_ns, &again));
        }
        messages.push(old);
    }
    // Images that come late: by then the newest transform is not that of their exposure any more.
    let late = messages.iter_mut().filter(|message| message.channel.topic == IMAGE);
    late.for_each(|message| message.log_time_ns += 55_000_000);
    messages.sort_by_key(|message| message.log_time_ns);
    let room = Room::with_log(&messages);
    let replayed = room.replay("log.mcap");
    assert_eq!(replayed.run.code, Some(0), "{:?}", replayed.run);
    let apart = farthest_apart(&replayed.tags, &Room::with_log(&in_tf()).replay("log.mcap").tags);
    println!("constants on /tf: {apart} m");
    // What moves is read between its samples, not taken for constant.
    assert!(apart < 1e-3, "{apart} m");
}

/// The head's joints at these angles at all times, in radians.
fn with_joints(messages: Vec<LogMessage>, pan: f64, tilt: f64) -> Vec<LogMessage> {
    let mut result = Vec::new();
    for old in messages {
        if old.channel.topic == ODOMETRY {
            let header = <Odometry as Message>::decode(&old.data).unwrap().header;
            let joints = JointState {
                header,
                // Others stand before and between, as on a real robot.
                name: ["left_knee", "head_tilt", "right_knee", "head_pan"].map(String::from).to_vec(),
                position: vec![0.9, tilt, -0.9, pan],
                ..JointState::default()
            };
            result.push(message(902, "/joint_states", old.log_time_ns, &joints));
        }
        result.push(old);
    }
    result
}

#[test]
fn a_head_that_is_turned_and_a_mount_that_makes_up_for_it_change_nothing() {
    let (pan, tilt) = (0.4, -0.2);
    let turned = Euler { yaw: pan, pitch: tilt, roll: 0.0 }.rotation();
    let messages = with_joints(walk().messages.clone(), pan, tilt);
    let messages = changed::<TFMessage>(&messages, TF_STATIC, |constants| {
        for mount in constants.transforms.iter_mut().filter(|transform| transform.child_frame_id == "camera_link") {
            let rotation = turned.conjugate() * glam::DQuat::from(mount.transform.rotation);
            mount.transform.rotation = Quaternion::from(rotation);
        }
    });
    let room = Room::with_log(&messages);
    let replayed = room.replay("log.mcap");
    let apart = farthest_apart(&replayed.tags, &walk().tags);
    assert!(apart < 0.02, "{apart} m");
    assert_eq!(replayed.count("valid"), walk().tags.iter().filter(|tag| tag.valid).count());

    // The joints do count: without them the mount is wrong.
    let still = Room::with_log(&without(&messages, "/joint_states"));
    let apart = farthest_apart(&still.replay("log.mcap").tags, &walk().tags);
    assert!(apart > 0.1, "{apart} m");
}

#[test]
fn joints_of_other_names_are_named_in_the_config() {
    let mut messages = with_joints(walk().messages.clone(), 0.0, 0.0);
    messages = changed::<JointState>(&messages, "/joint_states", |joints| {
        joints.name = ["a", "HeadPitch", "b", "HeadYaw"].map(String::from).to_vec();
    });
    let room = Room::with_log(&messages);
    let replayed = room.replay("log.mcap --set head.pan_joint=HeadYaw --set head.tilt_joint=HeadPitch");
    // Not bit for bit: a chain with two more turns by nothing rounds otherwise.
    let apart = farthest_apart(&replayed.tags, &walk().tags);
    assert!(apart < 1e-6, "a head that looks straight on: {apart} m");
    assert_eq!(on(&walk().messages, "/joint_states").count(), 0);
}
