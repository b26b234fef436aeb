//! Reads what a message measures: checked, and in the axes of REP 103.

use glam::{DQuat, DVec3};
use mavlink::dialects::common::{
    ATTITUDE_QUATERNION_DATA, GIMBAL_DEVICE_ATTITUDE_STATUS_DATA, GimbalDeviceFlags, HIGHRES_IMU_DATA,
    HighresImuUpdatedFlags, MavFrame, MavMessage, ODOMETRY_DATA,
};
use mavlink::{MavlinkVersion, Message};
use serde::{Deserialize, Serialize};

use super::axes::{ENU_FROM_NED, FLU_FROM_FRD, enu_from_ned, flu_from_frd, turned_covariance};
use realitysim_geometry::{Euler, Isometry};

/// The content of one message.
#[derive(Clone, Debug, PartialEq)]
pub enum Content {
    /// HEARTBEAT: the device is there.
    Heartbeat,
    /// TIMESYNC: the device asks for the host's time.
    TimeRequest {
        /// The device's time, nanoseconds, to be sent back with the answer.
        its_ns: i64,
    },
    /// TIMESYNC: the device answers a question of the host.
    TimeReply {
        /// What the device's time counts from.
        base: TimeBase,
        /// The device's time, nanoseconds.
        device_ns: i64,
        /// The host's time at the question, nanoseconds.
        sent_ns: i64,
    },
    /// HIGHRES_IMU: acceleration and turn rate.
    Inertial(Inertial),
    /// ATTITUDE_QUATERNION: attitude and turn rate.
    Attitude(Attitude),
    /// ODOMETRY: pose and velocity.
    Odometry(Box<Step>),
    /// GIMBAL_DEVICE_ATTITUDE_STATUS: angles of the head.
    Head(Head),
}

/// Content of HIGHRES_IMU; fields that the message does not update are `None`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inertial {
    /// Acceleration in the body's axes (FLU), metres per second squared, gravity included: at rest it points up.
    pub acceleration: Option<DVec3>,
    /// Turn rate in the body's axes (FLU), radians per second.
    pub angular_velocity: Option<DVec3>,
}

/// Content of ATTITUDE_QUATERNION.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Attitude {
    /// Attitude of the body (FLU) in the world (ENU).
    pub world_from_body: DQuat,
    /// Turn rate in the body's axes (FLU), radians per second.
    pub angular_velocity: DVec3,
}

/// Content of ODOMETRY.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Pose of the body (FLU) in the coordinate frame of the odometry, metres.
    pub odom_from_body: Isometry,
    /// Covariance of the pose, 6 x 6 row by row over x, y, z and rotations about them; zero if the device does not state it.
    pub pose_covariance: [f64; 36],
    /// Velocity in the body's axes, metres per second.
    pub velocity: DVec3,
    /// Turn rate in the body's axes, radians per second.
    pub angular_velocity: DVec3,
    /// Counter that changes when the device's estimate jumps.
    pub reset_counter: u8,
}

/// Content of GIMBAL_DEVICE_ATTITUDE_STATUS: angles of the head's joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Head {
    /// Pan, radians, positive to the left.
    pub pan: f64,
    /// Tilt, radians, positive downwards.
    pub tilt: f64,
}

/// The zero of a device's clock. A device may use both.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TimeBase {
    /// The start of the device.
    Boot,
    /// The Unix epoch.
    Unix,
}

/// A stamp of the device's own clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DeviceTime {
    /// The zero of the clock.
    pub base: TimeBase,
    /// The earliest time that the stamp can mean, nanoseconds.
    pub floor_ns: i64,
    /// How far the stamp may have been rounded down, nanoseconds.
    pub resolution_ns: i64,
}

impl DeviceTime {
    /// Returns the middle of the times that the stamp can mean, nanoseconds.
    pub fn middle_ns(&self) -> i64 {
        self.floor_ns.saturating_add(self.resolution_ns / 2)
    }

    /// Converts a stamp in microseconds since boot or the Unix epoch; `None` if it is 0 or too large.
    fn from_micros(us: u64) -> Option<Self> {
        let floor_ns = i64::try_from(us).ok()?.checked_mul(1_000)?;
        (floor_ns > 0).then_some(Self { base: time_base(floor_ns), floor_ns, resolution_ns: 1_000 })
    }

    /// Converts a stamp in milliseconds since boot.
    fn from_millis(ms: u32) -> Self {
        Self { base: TimeBase::Boot, floor_ns: i64::from(ms) * 1_000_000, resolution_ns: 1_000_000 }
    }
}

/// Stamps from here on count from the Unix epoch, nanoseconds: no device has been up for 31 years, and 2001 is past.
const UNIX_FROM_NS: i64 = 1_000_000_000_000_000_000;

/// Returns the zero that a stamp counts from, by its size.
fn time_base(ns: i64) -> TimeBase {
    if ns >= UNIX_FROM_NS { TimeBase::Unix } else { TimeBase::Boot }
}

/// Why a message with a right checksum gives no measurement.
pub(super) enum Unusable {
    /// Its type is not needed.
    NotNeeded,
    /// Its content is of no use; the reason.
    Because(&'static str),
}

const NO_TIME: Unusable = Unusable::Because("time_usec is 0");
const NOT_FINITE: Unusable = Unusable::Because("a value is not finite");

/// Reads a message of the type `id`: its name, its time by the device's clock, and its content.
pub(super) fn read(id: u32, payload: &[u8]) -> Result<(&'static str, Option<DeviceTime>, Content), Unusable> {
    if !NEEDED.contains(&id) {
        return Err(Unusable::NotNeeded);
    }
    let message = MavMessage::parse(MavlinkVersion::V2, id, payload)
        .map_err(|_| Unusable::Because("a value that its type does not have"))?;
    let name = message.message_name();
    let (time, content) = match message {
        MavMessage::HEARTBEAT(_) => (None, Content::Heartbeat),
        MavMessage::TIMESYNC(sync) if sync.tc1 == 0 => (None, Content::TimeRequest { its_ns: sync.ts1 }),
        MavMessage::TIMESYNC(sync) => {
            let (device_ns, sent_ns) = (sync.tc1, sync.ts1);
            (None, Content::TimeReply { base: time_base(device_ns), device_ns, sent_ns })
        }
        MavMessage::HIGHRES_IMU(imu) => {
            let time = DeviceTime::from_micros(imu.time_usec).ok_or(NO_TIME)?;
            (Some(time), Content::Inertial(inertial(&imu)?))
        }
        MavMessage::ATTITUDE_QUATERNION(attitude) => {
            let time = DeviceTime::from_millis(attitude.time_boot_ms);
            (Some(time), Content::Attitude(world_attitude(&attitude)?))
        }
        MavMessage::ODOMETRY(odometry) => {
            let time = DeviceTime::from_micros(odometry.time_usec).ok_or(NO_TIME)?;
            (Some(time), Content::Odometry(Box::new(step(&odometry)?)))
        }
        MavMessage::GIMBAL_DEVICE_ATTITUDE_STATUS(gimbal) => {
            let time = DeviceTime::from_millis(gimbal.time_boot_ms);
            (Some(time), Content::Head(head(&gimbal)?))
        }
        _ => return Err(Unusable::NotNeeded),
    };
    Ok((name, time, content))
}

/// Numbers of the types that are read: HEARTBEAT, ATTITUDE_QUATERNION, HIGHRES_IMU, TIMESYNC, GIMBAL_DEVICE_ATTITUDE_STATUS, ODOMETRY.
const NEEDED: [u32; 6] = [0, 31, 105, 111, 285, 331];

/// Reads acceleration and turn rate.
fn inertial(imu: &HIGHRES_IMU_DATA) -> Result<Inertial, Unusable> {
    type F = HighresImuUpdatedFlags;
    let acceleration = F::HIGHRES_IMU_UPDATED_XACC | F::HIGHRES_IMU_UPDATED_YACC | F::HIGHRES_IMU_UPDATED_ZACC;
    let gyro = F::HIGHRES_IMU_UPDATED_XGYRO | F::HIGHRES_IMU_UPDATED_YGYRO | F::HIGHRES_IMU_UPDATED_ZGYRO;
    // Of a sender that leaves `fields_updated` empty, all fields are used.
    let is_updated = |fields: F| imu.fields_updated.is_empty() || imu.fields_updated.contains(fields);
    let part =
        |fields: F, xyz: [f32; 3]| if is_updated(fields) { vector(xyz).map(flu_from_frd).map(Some) } else { Ok(None) };
    Ok(Inertial {
        acceleration: part(acceleration, [imu.xacc, imu.yacc, imu.zacc])?,
        angular_velocity: part(gyro, [imu.xgyro, imu.ygyro, imu.zgyro])?,
    })
}

/// Reads the attitude.
fn world_attitude(attitude: &ATTITUDE_QUATERNION_DATA) -> Result<Attitude, Unusable> {
    let ned_from_frd = quaternion([attitude.q1, attitude.q2, attitude.q3, attitude.q4])?;
    let rates = vector([attitude.rollspeed, attitude.pitchspeed, attitude.yawspeed])?;
    Ok(Attitude { world_from_body: ENU_FROM_NED * ned_from_frd * FLU_FROM_FRD, angular_velocity: flu_from_frd(rates) })
}

/// Reads odometry in any of the four local coordinate frames.
fn step(odometry: &ODOMETRY_DATA) -> Result<Step, Unusable> {
    type Turn = fn(DVec3) -> DVec3;
    let (world, turn_world): (DQuat, Turn) = match odometry.frame_id {
        MavFrame::MAV_FRAME_LOCAL_FLU => (DQuat::IDENTITY, |v| v),
        MavFrame::MAV_FRAME_LOCAL_ENU => (DQuat::IDENTITY, |v| v),
        MavFrame::MAV_FRAME_LOCAL_FRD => (FLU_FROM_FRD, flu_from_frd),
        MavFrame::MAV_FRAME_LOCAL_NED => (ENU_FROM_NED, enu_from_ned),
        _ => return Err(Unusable::Because("ODOMETRY.frame_id is not LOCAL_FLU, LOCAL_FRD, LOCAL_NED or LOCAL_ENU")),
    };
    let rotation = quaternion(odometry.q)?;
    let position = turn_world(vector([odometry.x, odometry.y, odometry.z])?);
    let linear = vector([odometry.vx, odometry.vy, odometry.vz])?;
    let angular = vector([odometry.rollspeed, odometry.pitchspeed, odometry.yawspeed])?;
    // MAVLink has no name for a FLU body. A child frame of LOCAL_FLU is taken to mean that.
    let (body, velocity, angular_velocity) = match odometry.child_frame_id {
        MavFrame::MAV_FRAME_BODY_FRD => (FLU_FROM_FRD, flu_from_frd(linear), flu_from_frd(angular)),
        MavFrame::MAV_FRAME_LOCAL_FLU => (DQuat::IDENTITY, linear, angular),
        _ => return Err(Unusable::Because("ODOMETRY.child_frame_id is not BODY_FRD or LOCAL_FLU")),
    };
    let is_known = odometry.pose_covariance.iter().all(|value| value.is_finite());
    let pose_covariance = if is_known { turned_covariance(&odometry.pose_covariance, turn_world) } else { [0.0; 36] };
    Ok(Step {
        odom_from_body: Isometry::new((world * rotation * body).normalize(), position),
        pose_covariance,
        velocity,
        angular_velocity,
        reset_counter: odometry.reset_counter,
    })
}

/// Reads the angles of the head against the torso. A gimbal that is held against the horizon or north is refused.
fn head(gimbal: &GIMBAL_DEVICE_ATTITUDE_STATUS_DATA) -> Result<Head, Unusable> {
    type F = GimbalDeviceFlags;
    let flags = gimbal.flags;
    if flags.intersects(F::GIMBAL_DEVICE_FLAGS_ROLL_LOCK | F::GIMBAL_DEVICE_FLAGS_PITCH_LOCK) {
        return Err(Unusable::Because("the gimbal's roll or pitch is against the horizon (ROLL_LOCK, PITCH_LOCK)"));
    }
    // Devices that do not set the newer flags of the yaw's coordinate frame say it with YAW_LOCK.
    let in_vehicle = flags.contains(F::GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME);
    let in_earth = flags.contains(F::GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME)
        || (!in_vehicle && flags.contains(F::GIMBAL_DEVICE_FLAGS_YAW_LOCK));
    if in_earth {
        return Err(Unusable::Because("the gimbal's yaw is against north (YAW_IN_EARTH_FRAME or YAW_LOCK)"));
    }
    let torso_from_head = FLU_FROM_FRD * quaternion(gimbal.q)? * FLU_FROM_FRD;
    let Euler { yaw, pitch, .. } = Euler::from_rotation(torso_from_head);
    Ok(Head { pan: yaw, tilt: pitch })
}

/// Makes a vector of finite numbers.
fn vector(xyz: [f32; 3]) -> Result<DVec3, Unusable> {
    let vector = DVec3::from_array(xyz.map(f64::from));
    if vector.is_finite() { Ok(vector) } else { Err(NOT_FINITE) }
}

/// Makes a rotation of w, x, y, z. A length that differs from 1 by more than 0.05 is an error.
fn quaternion(wxyz: [f32; 4]) -> Result<DQuat, Unusable> {
    let [w, x, y, z] = wxyz.map(f64::from);
    let q = DQuat::from_xyzw(x, y, z, w);
    if !q.is_finite() {
        return Err(NOT_FINITE);
    }
    if (q.length() - 1.0).abs() > 0.05 {
        return Err(Unusable::Because("a quaternion has not the length 1"));
    }
    Ok(q.normalize())
}
