//! Turns tables and pictures into the messages that a robot with ROS would have logged.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::imu::ImuSample;
use super::joints::JointsSample;
use super::odometry::OdometrySample;
use super::transforms::TransformSample;
use crate::synchroniser::STALE_NS;
use realitysim_config::{FrameNames, HeadSettings, Topics};
use realitysim_geometry::{Isometry, LensParameters};
use realitysim_ros2::mcap_read::{Channel, LogMessage};
use realitysim_ros2::mcap_write::{Durability, channel_metadata};
use realitysim_ros2::messages::{
    CameraInfo, CompressedImage, Header, Imu, JointState, Message, Odometry, Pose, Quaternion, TFMessage, Transform,
    TransformStamped, Vector3,
};

/// Everything that is known of a walk beside its pictures.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WalkTables {
    /// Attitudes and rates.
    pub imu: Vec<ImuSample>,
    /// Poses by odometry.
    pub odometry: Vec<OdometrySample>,
    /// Angles of the head.
    pub joints: Vec<JointsSample>,
    /// Transforms, constant and moving ones.
    pub transforms: Vec<TransformSample>,
}

/// Where the measurement with a stamp stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Place {
    Odometry(usize),
    Imu(usize),
    Joints(usize),
    Transform(usize),
}

/// Makes the messages of a walk on the default topics, in the order of time.
pub struct WalkMessages<'a> {
    tables: &'a WalkTables,
    /// All measurements by time; the next one is at `next`.
    places: Vec<(i64, Place)>,
    next: usize,
    topics: Topics,
    frames: FrameNames,
    head: HeadSettings,
    channels: BTreeMap<String, Arc<Channel>>,
}

impl<'a> WalkMessages<'a> {
    /// Sorts the measurements of the tables.
    pub fn new(tables: &'a WalkTables) -> Self {
        let odometry = tables.odometry.iter().enumerate().map(|(i, sample)| (sample.stamp_ns, Place::Odometry(i)));
        let imu = tables.imu.iter().enumerate().map(|(i, sample)| (sample.stamp_ns, Place::Imu(i)));
        let joints = tables.joints.iter().enumerate().map(|(i, sample)| (sample.stamp_ns, Place::Joints(i)));
        let moving = tables.transforms.iter().enumerate();
        let moving = moving.filter_map(|(i, sample)| Some((sample.stamp_ns?, Place::Transform(i))));
        let mut places: Vec<(i64, Place)> = odometry.chain(imu).chain(joints).chain(moving).collect();
        places.sort_unstable();
        Self {
            tables,
            places,
            next: 0,
            topics: Topics::default(),
            frames: FrameNames::default(),
            head: HeadSettings::default(),
            channels: BTreeMap::new(),
        }
    }

    /// The messages that hold for the whole walk: constant transforms and the lens, at time `first_ns`.
    pub fn constants(&mut self, first_ns: i64, lens: &LensParameters) -> Vec<LogMessage> {
        let constants = self.tables.transforms.iter().filter(|sample| sample.stamp_ns.is_none());
        let mut transforms: Vec<TransformStamped> = constants.map(|sample| stamped(sample, first_ns)).collect();
        let FrameNames { camera_link, camera_optical, .. } = self.frames.clone();
        // REP 103 fixes this rotation; a table may have the optical frame where its camera is calibrated.
        if !self.tables.transforms.iter().any(|sample| sample.child == camera_optical) {
            let optical = TransformSample {
                stamp_ns: None,
                parent: camera_link,
                child: camera_optical.clone(),
                parent_from_child: Isometry::link_from_optical(),
            };
            transforms.push(stamped(&optical, first_ns));
        }
        let info = CameraInfo::of_lens(lens, Header::at(first_ns, &camera_optical));
        let (tf_static, camera_info) = (self.topics.tf_static.clone(), self.topics.camera_info.clone());
        vec![
            self.message(&tf_static, first_ns, Durability::TransientLocal, &TFMessage { transforms }),
            self.message(&camera_info, first_ns, Durability::TransientLocal, &info),
        ]
    }

    /// The message of a picture: the bytes of its file, JPEG or PNG, as they are.
    pub fn picture(&mut self, stamp_ns: i64, data: Vec<u8>) -> LogMessage {
        let format = if data.starts_with(b"\x89PNG") { "png" } else { "jpeg" }.to_owned();
        let header = Header::at(stamp_ns, &self.frames.camera_optical);
        let topic = self.topics.image.clone();
        self.message(&topic, stamp_ns, Durability::Volatile, &CompressedImage { header, format, data })
    }

    /// The message of the next measurement up to `until_ns`; `None` if there is none.
    pub fn next_until(&mut self, until_ns: i64) -> Option<LogMessage> {
        let (stamp_ns, place) = *self.places.get(self.next).filter(|(stamp_ns, _)| *stamp_ns <= until_ns)?;
        self.next += 1;
        let tables = self.tables;
        let topics = self.topics.clone();
        let frames = self.frames.clone();
        Some(match place {
            Place::Odometry(index) => {
                let mut odometry = Odometry { header: Header::at(stamp_ns, &frames.odom), ..Default::default() };
                odometry.child_frame_id = frames.base_footprint;
                odometry.pose.pose = Pose::from(tables.odometry[index].odom_from_footprint.to_isometry());
                self.message(&topics.odometry, stamp_ns, Durability::Volatile, &odometry)
            }
            Place::Imu(index) => {
                let imu = imu_message(&tables.imu[index], &frames.base_link);
                self.message(&topics.imu, stamp_ns, Durability::Volatile, &imu)
            }
            Place::Joints(index) => {
                let JointsSample { pan, tilt, .. } = tables.joints[index];
                let joints = JointState {
                    header: Header::at(stamp_ns, ""),
                    name: vec![self.head.pan_joint.clone(), self.head.tilt_joint.clone()],
                    position: vec![pan, tilt],
                    ..Default::default()
                };
                self.message(&topics.joints, stamp_ns, Durability::Volatile, &joints)
            }
            Place::Transform(index) => {
                let transforms = vec![stamped(&tables.transforms[index], stamp_ns)];
                self.message(&topics.tf, stamp_ns, Durability::Volatile, &TFMessage { transforms })
            }
        })
    }

    fn message<M: Message>(&mut self, topic: &str, stamp_ns: i64, durability: Durability, message: &M) -> LogMessage {
        let next_id = self.channels.len() as u16 + 1;
        let channel = self.channels.entry(topic.to_owned());
        let channel =
            channel.or_insert_with(|| Arc::new(Channel::of::<M>(next_id, topic, channel_metadata(durability))));
        let channel = Arc::clone(channel);
        LogMessage { channel, sequence: 0, log_time_ns: stamp_ns, publish_time_ns: stamp_ns, data: message.encode() }
    }
}

fn stamped(sample: &TransformSample, stamp_ns: i64) -> TransformStamped {
    TransformStamped {
        header: Header::at(stamp_ns, &sample.parent),
        child_frame_id: sample.child.clone(),
        transform: Transform::from(sample.parent_from_child),
    }
}

/// The message of a sample. A covariance that begins with -1 says that a value was not measured.
fn imu_message(sample: &ImuSample, frame_id: &str) -> Imu {
    let covariance = |is_measured: bool| {
        let mut covariance = [0.0; 9];
        if !is_measured {
            covariance[0] = -1.0;
        }
        covariance
    };
    Imu {
        header: Header::at(sample.stamp_ns, frame_id),
        orientation: sample.orientation.map_or_else(Quaternion::default, Quaternion::from),
        orientation_covariance: covariance(sample.orientation.is_some()),
        angular_velocity: sample.turn_rate.map_or_else(Vector3::default, Vector3::from),
        angular_velocity_covariance: covariance(sample.turn_rate.is_some()),
        linear_acceleration: sample.acceleration.map_or_else(Vector3::default, Vector3::from),
        linear_acceleration_covariance: covariance(sample.acceleration.is_some()),
    }
}

/// Counts the pictures within the time of a table, and at most 250 ms beside it: beyond that a measurement says nothing of a
/// walking robot.
pub fn pictures_within(stamps_ns: impl IntoIterator<Item = i64>, [first_ns, last_ns]: [i64; 2]) -> usize {
    let range = first_ns.saturating_sub(STALE_NS)..=last_ns.saturating_add(STALE_NS);
    stamps_ns.into_iter().filter(|stamp_ns| range.contains(stamp_ns)).count()
}
