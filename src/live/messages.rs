//! Converts live measurements to the ROS 2 messages that a robot would have logged.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::{DQuat, DVec3};

use crate::config::{FrameNames, HeadSettings, MountSettings, Topics};
use crate::devices::mavlink::Content;
use crate::geometry::{Euler, Isometry, Pose2};
use crate::ros2::mcap_read::{Channel, LogMessage};
use crate::ros2::mcap_write::{Durability, channel_metadata};
use crate::ros2::messages::{
    Header, Imu, JointState, Message, Odometry, Pose, PoseWithCovarianceStamped, Quaternion, TFMessage, Transform,
    TransformStamped, Vector3,
};

/// Makes messages and keeps one channel for each topic and type.
#[derive(Default)]
pub struct Messages {
    channels: BTreeMap<(String, &'static str), Arc<Channel>>,
}

impl Messages {
    /// Makes a message; `latched` for what late subscribers need too. Its log time is set when the event loop takes it.
    pub fn message<M: Message>(&mut self, topic: &str, latched: bool, message: &M) -> LogMessage {
        let id = u16::try_from(self.channels.len() + 1).unwrap_or(u16::MAX);
        let durability = if latched { Durability::TransientLocal } else { Durability::Volatile };
        let channel = self
            .channels
            .entry((topic.to_owned(), M::TYPE))
            .or_insert_with(|| Arc::new(Channel::of::<M>(id, topic, channel_metadata(durability))));
        let (channel, data) = (Arc::clone(channel), message.encode());
        LogMessage { channel, sequence: 0, log_time_ns: 0, publish_time_ns: 0, data }
    }

    /// Converts one measurement; `None` for content that is not recorded. `stamp_ns` is UTC.
    pub fn measured(&mut self, stamp_ns: i64, content: &Content, names: &Names) -> Option<LogMessage> {
        let Names { topics, frames, head } = names;
        match content {
            Content::Attitude(attitude) => {
                let mut imu = Imu {
                    header: Header::at(stamp_ns, &frames.base_link),
                    orientation: Quaternion::from(attitude.world_from_body),
                    angular_velocity: Vector3::from(attitude.angular_velocity),
                    ..Imu::default()
                };
                imu.linear_acceleration_covariance[0] = NOT_MEASURED;
                Some(self.message(&topics.imu, false, &imu))
            }
            Content::Inertial(inertial) => {
                let mut imu = Imu { header: Header::at(stamp_ns, &frames.base_link), ..Imu::default() };
                imu.orientation_covariance[0] = NOT_MEASURED;
                match inertial.acceleration {
                    Some(acceleration) => imu.linear_acceleration = Vector3::from(acceleration),
                    None => imu.linear_acceleration_covariance[0] = NOT_MEASURED,
                }
                match inertial.angular_velocity {
                    Some(velocity) => imu.angular_velocity = Vector3::from(velocity),
                    None => imu.angular_velocity_covariance[0] = NOT_MEASURED,
                }
                Some(self.message(&format!("{}_raw", topics.imu), false, &imu))
            }
            Content::Odometry(step) => {
                let mut odometry = Odometry { header: Header::at(stamp_ns, &frames.odom), ..Odometry::default() };
                odometry.child_frame_id = frames.base_footprint.clone();
                odometry.pose.pose = Pose::from(step.odom_from_body);
                odometry.pose.covariance = step.pose_covariance;
                odometry.twist.twist.linear = Vector3::from(step.velocity);
                odometry.twist.twist.angular = Vector3::from(step.angular_velocity);
                Some(self.message(&topics.odometry, false, &odometry))
            }
            Content::Head(angles) => {
                let joints = JointState {
                    header: Header::at(stamp_ns, ""),
                    name: vec![head.pan_joint.clone(), head.tilt_joint.clone()],
                    position: vec![angles.pan, angles.tilt],
                    ..JointState::default()
                };
                Some(self.message(&topics.joints, false, &joints))
            }
            Content::Heartbeat | Content::TimeRequest { .. } | Content::TimeReply { .. } => None,
        }
    }
}

/// First element of the covariance of a quantity that is not measured (sensor_msgs/Imu).
const NOT_MEASURED: f64 = -1.0;

/// Names of topics, coordinate frames and head joints.
pub struct Names {
    pub topics: Topics,
    pub frames: FrameNames,
    pub head: HeadSettings,
}

/// Transforms from `base_footprint` to the camera's optical frame, as `/tf_static` carries them.
pub fn transforms(stamp_ns: i64, torso_height_m: f64, mount: &MountSettings, frames: &FrameNames) -> TFMessage {
    let [roll, pitch, yaw] = mount.camera_rpy_deg.map(f64::to_radians);
    let step = |parent: &str, child: &str, parent_from_child: Isometry| TransformStamped {
        header: Header::at(stamp_ns, parent),
        child_frame_id: child.to_owned(),
        transform: Transform {
            translation: Vector3::from(parent_from_child.translation),
            rotation: Quaternion::from(parent_from_child.rotation),
        },
    };
    let torso = Isometry::new(DQuat::IDENTITY, DVec3::new(0.0, 0.0, torso_height_m));
    let camera = Isometry::from_euler(Euler { yaw, pitch, roll }, DVec3::from_array(mount.camera_xyz_m));
    TFMessage {
        transforms: vec![
            step(&frames.base_footprint, &frames.base_link, torso),
            step(&frames.base_link, &frames.camera_link, camera),
            step(&frames.camera_link, &frames.camera_optical, Isometry::link_from_optical()),
        ],
    }
}

/// Message for a pose that somebody announces, as on `/initialpose`.
pub fn initial_pose(stamp_ns: i64, map_from_footprint: &Pose2, frames: &FrameNames) -> PoseWithCovarianceStamped {
    let mut message = PoseWithCovarianceStamped { header: Header::at(stamp_ns, &frames.map), ..Default::default() };
    message.pose.pose = Pose::from(map_from_footprint.to_isometry());
    message
}
