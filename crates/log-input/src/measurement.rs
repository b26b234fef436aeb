//! Decodes a message of a log into a measurement, by its topic and type.

use glam::{DQuat, DVec3};

use realitysim_config::{HeadSettings, Topics};
use realitysim_geometry::physical::settled;
use realitysim_geometry::{Euler, Isometry, Physical, Pose2, wrap_angle};
use realitysim_ros2::cdr::{CdrError, CdrReader, Wire};
use realitysim_ros2::mcap_read::{Channel, LogMessage};
use realitysim_ros2::messages::{
    CameraInfo, CompressedImage, CompressedImageView, Header, Image, ImageView, Imu, JointState, LowState, Message,
    Odometer, Odometry, Pose, PoseStamped, PoseWithCovarianceStamped, Stamp, TFMessage, Twist, TwistStamped,
    TwistWithCovarianceStamped,
};

use super::planar_velocity::PlanarVelocity;

/// A measurement, or a frame whose pixels stay in the message.
#[derive(Clone, Debug, PartialEq)]
pub enum Measurement {
    /// An image of the camera, compressed or raw.
    Frame {
        /// Time of the exposure, nanoseconds.
        stamp_ns: i64,
        /// Coordinate frame of the camera, as the message names it.
        frame_id: String,
    },
    /// The calibration of the camera's lens.
    CameraInfo(Box<CameraInfo>),
    /// Pose of `base_footprint` as the robot counts its steps; it knows nothing of `map`.
    Odometry {
        /// Time of the measurement, nanoseconds.
        stamp_ns: i64,
        /// Position in metres and heading in radians, in the coordinate frame `odom`.
        odom_from_footprint: Pose2,
        /// The pose in full and the coordinate frame that it is of, if the message names one: that of the torso leads to the
        /// footprint's where the transforms connect them.
        moving: Option<MovingFrame>,
        /// Which clock the time is of.
        clock: StampClock,
    },
    /// Velocity of `base_footprint` as the robot measures its walk.
    Velocity {
        /// Time of the measurement, nanoseconds.
        stamp_ns: i64,
        /// Along the footprint's own axes.
        velocity: PlanarVelocity,
    },
    /// A sample of the inertial measurement unit.
    Imu {
        /// Time of the measurement, nanoseconds.
        stamp_ns: i64,
        /// Coordinate frame of the sensor.
        frame_id: String,
        /// Orientation of `frame_id` against gravity, if the sensor measures it.
        orientation: Option<DQuat>,
        /// Radians per second about the axes of `frame_id`, if the sensor measures it.
        turn_rate: Option<DVec3>,
        /// Acceleration with gravity along the axes of `frame_id`, metres per second squared, if the sensor measures it.
        acceleration: Option<DVec3>,
    },
    /// Attitude and head of a robot that sends both in one message without a stamp.
    LowState {
        /// Log time of the message, nanoseconds.
        stamp_ns: i64,
        /// The inertial sensor in the torso, if the topic is that of the attitude.
        inertial: Option<TorsoState>,
        /// Angles of pan and tilt, radians, if the topic is that of the joints and the message has them.
        head: Option<(f64, f64)>,
    },
    /// Angles of the head's joints.
    Joints {
        /// Time of the measurement, nanoseconds.
        stamp_ns: i64,
        /// Angle of the pan joint, radians, if the message has it.
        pan: Option<f64>,
        /// Angle of the tilt joint, radians, if the message has it.
        tilt: Option<f64>,
    },
    /// Transforms of `/tf` or `/tf_static`.
    Transforms {
        /// Whether they came on `/tf_static` and hold for good.
        latched: bool,
        /// The transforms, in the order of the message.
        transforms: Vec<StampedTransform>,
    },
    /// A pose that somebody announces.
    InitialPose {
        /// Time of the header, nanoseconds.
        stamp_ns: i64,
        /// Position in metres and heading in radians, in the coordinate frame `map`.
        map_from_footprint: Pose2,
        /// Standard deviations that the message states for the pose.
        deviations: StatedDeviations,
    },
    /// A measurement that no robot can have made: a number in it is not finite, or out of all range. It is recorded and counted.
    Impossible,
    /// A message that is recorded, and that the filter does not use.
    Other,
}

/// The clock that the time of a measurement is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StampClock {
    /// The message has a stamp of its own.
    Header,
    /// The message has none: the time is that at which it was logged.
    Log,
}

/// The pose of the coordinate frame that odometry is of.
#[derive(Clone, Debug, PartialEq)]
pub struct MovingFrame {
    /// Name of the coordinate frame, without a leading slash.
    pub name: String,
    /// Its pose in `odom`, metres.
    pub odom_from_frame: Isometry,
}

/// What an inertial sensor along the torso's axes measures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TorsoState {
    /// Attitude against gravity, if the sensor states it.
    pub orientation: Option<DQuat>,
    /// Radians per second.
    pub turn_rate: DVec3,
    /// Acceleration with gravity, metres per second squared.
    pub acceleration: DVec3,
}

/// The standard deviations that a message states for the pose in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StatedDeviations {
    /// The message states none: its variances are zero.
    None,
    /// The message states these.
    Of {
        /// Of the position, metres: the larger of those of x and y.
        xy_m: f64,
        /// Of the heading, radians.
        yaw_rad: f64,
    },
    /// The numbers are no covariance: not finite, negative, not positive semi-definite, or wider than any field.
    Impossible,
}

/// One transform of `/tf` or `/tf_static`.
#[derive(Clone, Debug, PartialEq)]
pub struct StampedTransform {
    /// Time at which it holds, nanoseconds.
    pub stamp_ns: i64,
    /// Name of the parent coordinate frame, without a leading slash.
    pub parent: String,
    /// Name of the child coordinate frame, without a leading slash.
    pub child: String,
    /// Turns coordinates of `child` into those of `parent`, metres.
    pub parent_from_child: Isometry,
}

/// Returns whether messages of a channel are images of the camera: its topic is the camera's and its type is that of an image.
pub fn is_frame(channel: &Channel, topics: &Topics) -> bool {
    channel.topic == topics.image && [CompressedImage::TYPE, Image::TYPE].contains(&channel.type_name.as_str())
}

/// Decodes one message. `head` names the head's joints.
///
/// An error means that the bytes of the message are not what its type says. A damaged image still is a frame as long as
/// its stamp can be read.
pub fn read(message: &LogMessage, topics: &Topics, head: &HeadSettings) -> Result<Measurement, CdrError> {
    let topic = message.channel.topic.as_str();
    let data = message.data.as_slice();
    // A topic may carry several types; only the expected one is read. Where a log names no types, the topic decides.
    let is = |wanted: &str, kind: &str| {
        topic == wanted && (message.channel.type_name == kind || message.channel.type_name.is_empty())
    };
    if is_frame(&message.channel, topics) {
        let header = frame_header(&message.channel.type_name, data)?;
        return Ok(Measurement::Frame { stamp_ns: header.stamp.to_nanoseconds(), frame_id: header.frame_id });
    }
    if topic == topics.odometry
        && let Some(odometry) = odometry(message)?
    {
        return Ok(odometry);
    }
    if message.channel.type_name == LowState::TYPE && [&topics.imu, &topics.joints].contains(&&message.channel.topic) {
        return low_state(message, topics);
    }
    if is(&topics.imu, Imu::TYPE) {
        let imu = Imu::decode(data)?;
        // A quaternion of zeros is how drivers that know no attitude leave the field.
        let measured = imu.orientation_covariance[0] != -1.0;
        let orientation = measured.then(|| DQuat::from(imu.orientation)).filter(|q| q.length_squared() != 0.0);
        return Ok(Measurement::Imu {
            stamp_ns: imu.header.stamp.to_nanoseconds(),
            frame_id: imu.header.frame_id,
            orientation,
            turn_rate: (imu.angular_velocity_covariance[0] != -1.0).then(|| DVec3::from(imu.angular_velocity)),
            acceleration: (imu.linear_acceleration_covariance[0] != -1.0).then(|| DVec3::from(imu.linear_acceleration)),
        });
    }
    if is(&topics.joints, JointState::TYPE) {
        let joints = JointState::decode(data)?;
        let angle = |name: &str| {
            let index = joints.name.iter().position(|joint| joint == name)?;
            joints.position.get(index).copied().map(settled)
        };
        let (pan, tilt) = (angle(&head.pan_joint), angle(&head.tilt_joint));
        return Ok(Measurement::Joints { stamp_ns: joints.header.stamp.to_nanoseconds(), pan, tilt });
    }
    if is(&topics.tf, TFMessage::TYPE) || is(&topics.tf_static, TFMessage::TYPE) {
        let transforms = TFMessage::decode(data)?.transforms;
        let transforms = transforms
            .into_iter()
            .map(|t| StampedTransform {
                stamp_ns: t.header.stamp.to_nanoseconds(),
                parent: strip_slash(t.header.frame_id),
                child: strip_slash(t.child_frame_id),
                parent_from_child: t.transform.into(),
            })
            .collect();
        return Ok(Measurement::Transforms { latched: topic == topics.tf_static, transforms });
    }
    if is(&topics.initial_pose, PoseWithCovarianceStamped::TYPE) {
        let initial = PoseWithCovarianceStamped::decode(data)?;
        let pose = initial.pose.pose;
        let map_from_footprint = Isometry::from(pose);
        if !map_from_footprint.is_possible() {
            return Ok(Measurement::Impossible);
        }
        return Ok(Measurement::InitialPose {
            stamp_ns: initial.header.stamp.to_nanoseconds(),
            map_from_footprint: Pose2::from_isometry(&map_from_footprint),
            deviations: StatedDeviations::from_covariance(&initial.pose.covariance),
        });
    }
    if is(&topics.camera_info, CameraInfo::TYPE) {
        return Ok(Measurement::CameraInfo(Box::new(CameraInfo::decode(data)?)));
    }
    Ok(Measurement::Other)
}

/// Decodes a message of the odometry's topic; `None` if its type is none that odometry has.
fn odometry(message: &LogMessage) -> Result<Option<Measurement>, CdrError> {
    let data = message.data.as_slice();
    Ok(Some(match message.channel.type_name.as_str() {
        // Where a log names no types, it is the usual one.
        Odometry::TYPE | "" => {
            let odometry = Odometry::decode(data)?;
            pose_odometry(&odometry.header, odometry.pose.pose, odometry.child_frame_id)
        }
        PoseStamped::TYPE => {
            let stamped = PoseStamped::decode(data)?;
            pose_odometry(&stamped.header, stamped.pose, String::new())
        }
        PoseWithCovarianceStamped::TYPE => {
            let stamped = PoseWithCovarianceStamped::decode(data)?;
            pose_odometry(&stamped.header, stamped.pose.pose, String::new())
        }
        TwistStamped::TYPE => {
            let stamped = TwistStamped::decode(data)?;
            planar_velocity(&stamped.header, &stamped.twist)
        }
        TwistWithCovarianceStamped::TYPE => {
            let stamped = TwistWithCovarianceStamped::decode(data)?;
            planar_velocity(&stamped.header, &stamped.twist.twist)
        }
        Odometer::TYPE => {
            let Odometer { x, y, theta } = Odometer::decode(data)?;
            let [x, y, yaw] = [x, y, theta].map(|value| settled(f64::from(value)));
            let odom_from_footprint = Pose2::new(x, y, yaw);
            if !odom_from_footprint.is_possible() {
                return Ok(Some(Measurement::Impossible));
            }
            let odom_from_footprint = Pose2 { yaw: wrap_angle(yaw), ..odom_from_footprint };
            let (stamp_ns, clock) = (message.log_time_ns, StampClock::Log);
            Measurement::Odometry { stamp_ns, odom_from_footprint, moving: None, clock }
        }
        _ => return Ok(None),
    }))
}

/// Returns the odometry in a pose; `child` is the coordinate frame that moves, empty if the message does not say.
fn pose_odometry(header: &Header, pose: Pose, child: String) -> Measurement {
    let odom_from_frame = Isometry::from(pose);
    if !odom_from_frame.is_possible() {
        return Measurement::Impossible;
    }
    let moving = (!child.is_empty()).then(|| MovingFrame { name: strip_slash(child), odom_from_frame });
    let odom_from_footprint = Pose2::from_isometry(&odom_from_frame);
    let (stamp_ns, clock) = (header.stamp.to_nanoseconds(), StampClock::Header);
    Measurement::Odometry { stamp_ns, odom_from_footprint, moving, clock }
}

/// Returns the part of a velocity that lies in the ground plane.
fn planar_velocity(header: &Header, twist: &Twist) -> Measurement {
    let [x_m_per_s, y_m_per_s, yaw_rad_per_s] = [twist.linear.x, twist.linear.y, twist.angular.z].map(settled);
    let velocity = PlanarVelocity { x_m_per_s, y_m_per_s, yaw_rad_per_s };
    match velocity.is_possible() {
        true => Measurement::Velocity { stamp_ns: header.stamp.to_nanoseconds(), velocity },
        false => Measurement::Impossible,
    }
}

/// Decodes the state of sensors and joints of a robot of Booster Robotics: the parts whose topic it is.
fn low_state(message: &LogMessage, topics: &Topics) -> Result<Measurement, CdrError> {
    let LowState { imu_state, motor_state_serial, .. } = LowState::decode(&message.data)?;
    let topic = &message.channel.topic;
    let vector = |values: [f32; 3]| DVec3::from(values.map(|value| settled(f64::from(value))));
    let [roll, pitch, yaw] = vector(imu_state.rpy).to_array();
    let is_stated = [roll, pitch, yaw].iter().all(Physical::is_possible) && imu_state.rpy != [0.0; 3];
    let inertial = (*topic == topics.imu).then(|| TorsoState {
        orientation: is_stated.then(|| Euler { roll, pitch, yaw }.rotation()),
        turn_rate: vector(imu_state.gyro),
        acceleration: vector(imu_state.acc),
    });
    let head = (*topic == topics.joints).then_some(motor_state_serial.get(..2)).flatten();
    let head = head.map(|joints| [joints[0].q, joints[1].q].map(|angle| settled(f64::from(angle))));
    let head = head.map(|[pan, tilt]| (pan, tilt));
    Ok(Measurement::LowState { stamp_ns: message.log_time_ns, inertial, head })
}

/// Returns the header of an image message; of a damaged one only the stamp.
fn frame_header(type_name: &str, data: &[u8]) -> Result<Header, CdrError> {
    let header = if type_name == Image::TYPE {
        ImageView::decode(data).map(|image| image.header)
    } else {
        CompressedImageView::decode(data).map(|image| image.header)
    };
    header.or_else(|error| stamp_of_torn(data).map(|stamp| Header { stamp, ..Header::default() }).ok_or(error))
}

/// Returns the stamp of an image message that is damaged further back: the stamp comes first and is often whole.
fn stamp_of_torn(data: &[u8]) -> Option<Stamp> {
    let stamp = Stamp::read(&mut CdrReader::new(data).ok()?).ok()?;
    // A stamp of zero was never written.
    (stamp.nanosec < 1_000_000_000 && stamp != Stamp::default()).then_some(stamp)
}

/// Largest variance that is believed, m² or rad²: a standard deviation of 100 m or 100 rad is wider than any field.
const MAX_VARIANCE: f64 = 1e4;
/// Share by which the square of a covariance may exceed the product of its variances because of rounding.
const ROUNDING_SHARE: f64 = 1e-6;

impl StatedDeviations {
    /// Takes the standard deviations from the covariance of a ROS pose: 6 x 6, row by row, of x, y, z and the rotations
    /// about them. Variances of zero state nothing.
    fn from_covariance(covariance: &[f64; 36]) -> Self {
        let [xx, xy, yx, yy, yaw] = [0, 1, 6, 7, 35].map(|index| settled(covariance[index]));
        let variances = [xx, yy, yaw];
        let is_covariance = variances.iter().all(|variance| (0.0..=MAX_VARIANCE).contains(variance))
            && [xy, yx].iter().all(|both| both * both <= xx * yy * (1.0 + ROUNDING_SHARE));
        if !is_covariance {
            Self::Impossible
        } else if variances == [0.0; 3] {
            Self::None
        } else {
            Self::Of { xy_m: libm::sqrt(xx.max(yy)), yaw_rad: libm::sqrt(yaw) }
        }
    }
}

/// Removes the slash that names of coordinate frames begin with in ROS 1, and not in ROS 2.
fn strip_slash(frame: String) -> String {
    frame.strip_prefix('/').map(str::to_owned).unwrap_or(frame)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use realitysim_ros2::messages::{ImuState, MotorState};

    /// What a message on a topic is read as, logged at 7 ns.
    fn read_on<M: Message>(topic: &str, content: &M, topics: &Topics) -> Measurement {
        let channel = Arc::new(Channel::of::<M>(1, topic, Default::default()));
        let message = LogMessage { channel, sequence: 0, log_time_ns: 7, publish_time_ns: 7, data: content.encode() };
        read(&message, topics, &HeadSettings::default()).expect("it decodes")
    }

    #[test]
    fn an_odometer_counts_at_the_time_of_the_log() {
        let topics = Topics { odometry: "/odometer_state".to_owned(), ..Topics::default() };
        let odometer = |x, theta| read_on("/odometer_state", &Odometer { x, y: -0.5, theta }, &topics);
        let odom_from_footprint = Pose2::new(0.25, -0.5, 1.5);
        let expected = Measurement::Odometry { stamp_ns: 7, odom_from_footprint, moving: None, clock: StampClock::Log };
        assert_eq!(odometer(0.25, 1.5), expected);
        for wild in [f32::NAN, f32::INFINITY, 3e6] {
            assert_eq!(odometer(wild, 0.0), Measurement::Impossible);
            assert_eq!(odometer(0.0, wild), Measurement::Impossible);
        }
        let elsewhere = read_on("/other", &Odometer::default(), &topics);
        assert_eq!(elsewhere, Measurement::Other);
    }

    #[test]
    fn a_low_state_gives_what_its_topic_is_asked_for() {
        let joint = |q| MotorState { q, ..MotorState::default() };
        let imu_state = ImuState { rpy: [0.5, -0.25, 1.0], gyro: [0.125, 0.0, 0.0], acc: [0.0, 0.0, 9.75] };
        let state = LowState {
            imu_state,
            motor_state_parallel: Vec::new(),
            motor_state_serial: vec![joint(0.5), joint(-0.25)],
        };
        let on = |imu: &str, joints: &str, state: &LowState| {
            let topics = Topics { imu: imu.to_owned(), joints: joints.to_owned(), ..Topics::default() };
            read_on("/low_state", state, &topics)
        };
        let Measurement::LowState { stamp_ns: 7, inertial: Some(torso), head } = on("/low_state", "/low_state", &state)
        else {
            panic!("both are asked for")
        };
        assert_eq!(head, Some((0.5, -0.25)));
        let euler = Euler::from_rotation(torso.orientation.expect("stated"));
        assert!((euler.roll - 0.5).abs() < 1e-12 && (euler.pitch + 0.25).abs() < 1e-12);
        assert_eq!((torso.turn_rate.x, torso.acceleration.z), (0.125, 9.75));
        assert!(matches!(
            on("/imu", "/low_state", &state),
            Measurement::LowState { inertial: None, head: Some(_), .. }
        ));
        assert!(matches!(on("/low_state", "/joints", &state), Measurement::LowState { head: None, .. }));
        assert_eq!(on("/imu", "/joints", &state), Measurement::Other);
        // A robot that states no attitude, and one of few joints.
        let bare = LowState { motor_state_serial: vec![joint(0.5)], ..LowState::default() };
        let Measurement::LowState { inertial: Some(torso), head: None, .. } = on("/low_state", "/low_state", &bare)
        else {
            panic!("one joint is no head")
        };
        assert_eq!(torso.orientation, None);
    }

    #[test]
    fn a_velocity_counts_along_the_ground_and_a_pose_as_it_stands() {
        let topics = Topics { odometry: "/walk".to_owned(), ..Topics::default() };
        let mut twist = TwistStamped::default();
        (twist.twist.linear.x, twist.twist.linear.z, twist.twist.angular.z) = (0.5, 9.0, -0.25);
        let velocity = PlanarVelocity { x_m_per_s: 0.5, y_m_per_s: 0.0, yaw_rad_per_s: -0.25 };
        assert_eq!(read_on("/walk", &twist, &topics), Measurement::Velocity { stamp_ns: 0, velocity });
        twist.twist.linear.y = f64::NAN;
        assert_eq!(read_on("/walk", &twist, &topics), Measurement::Impossible);
        let mut pose = PoseStamped::default();
        (pose.pose.position.x, pose.pose.position.z) = (1.5, 0.4);
        let Measurement::Odometry { odom_from_footprint, moving: None, .. } = read_on("/walk", &pose, &topics) else {
            panic!("odometry")
        };
        assert_eq!(odom_from_footprint, Pose2::new(1.5, 0.0, 0.0));
    }
}
