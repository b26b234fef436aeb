//! What a sound message measures, checked and in the axes of REP 103.

use glam::{DQuat, DVec3};
use mavlink::dialects::common::{
    ATTITUDE_QUATERNION_DATA, GIMBAL_DEVICE_ATTITUDE_STATUS_DATA, GimbalDeviceFlags, HIGHRES_IMU_DATA,
    HighresImuUpdatedFlags, MavFrame, MavMessage, ODOMETRY_DATA,
};
use mavlink::{MavlinkVersion, Message};
use serde::{Deserialize, Serialize};

use super::axes::{ENU_FROM_NED, FLU_FROM_FRD, enu_from_ned, flu_from_frd, turned_covariance};
use realitysim_geometry::{Euler, Isometry};

/// What one message says.
#[derive(Clone, Debug, PartialEq)]
pub enum Content {
    Heartbeat,
    /// The device asks for our time.
    TimeRequest {
        its_ns: i64,
    },
    /// The device's answer to our request of `sent_ns`.
    TimeReply {
        base: TimeBase,
        device_ns: i64,
        sent_ns: i64,
    },
    Inertial(Inertial),
    Attitude(Attitude),
    Odometry(Box<Step>),
    Head(Head),
}

/// HIGHRES_IMU; what a message does not bring is none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inertial {
    /// Metres per second squared, gravity included: at rest it points up.
    pub acceleration: Option<DVec3>,
    /// Radians per second.
    pub angular_velocity: Option<DVec3>,
}

/// ATTITUDE_QUATERNION.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Attitude {
    /// Body (FLU) in the world (ENU).
    pub world_from_body: DQuat,
    /// Radians per second.
    pub angular_velocity: DVec3,
}

/// ODOMETRY.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    pub odom_from_body: Isometry,
    /// Row by row over x, y, z and rotations about x, y, z; zero where the device does not know.
    pub pose_covariance: [f64; 36],
    /// Metres per second in the body's axes.
    pub velocity: DVec3,
    /// Radians per second in the body's axes.
    pub angular_velocity: DVec3,
    /// Changes when the estimate jumps.
    pub reset_counter: u8,
}

/// GIMBAL_DEVICE_ATTITUDE_STATUS: the head's joints, radians. Pan is positive to the left, tilt positive down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Head {
    pub pan: f64,
    pub tilt: f64,
}

/// What a device's clock counts from. A device may use both.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TimeBase {
    Boot,
    Unix,
}

/// A stamp of the device's own clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DeviceTime {
    pub base: TimeBase,
    /// The earliest that the stamp can mean.
    pub floor_ns: i64,
    /// How far it may have been rounded down.
    pub resolution_ns: i64,
}

impl DeviceTime {
    /// The best single guess.
    pub fn middle_ns(&self) -> i64 {
        self.floor_ns.saturating_add(self.resolution_ns / 2)
    }

    fn of_micros(us: u64) -> Option<Self> {
        let floor_ns = i64::try_from(us).ok()?.checked_mul(1_000)?;
        (floor_ns > 0).then_some(Self { base: base_of(floor_ns), floor_ns, resolution_ns: 1_000 })
    }

    fn of_millis(ms: u32) -> Self {
        Self { base: TimeBase::Boot, floor_ns: i64::from(ms) * 1_000_000, resolution_ns: 1_000_000 }
    }
}

/// Nothing has been up for 31 years, and nobody records the year 2001.
const UNIX_FROM_NS: i64 = 1_000_000_000_000_000_000;

fn base_of(ns: i64) -> TimeBase {
    if ns >= UNIX_FROM_NS { TimeBase::Unix } else { TimeBase::Boot }
}

/// Why a sound message brings nothing.
pub(super) enum Unusable {
    NotNeeded,
    Because(&'static str),
}

const NO_TIME: Unusable = Unusable::Because("time_usec is 0");
const NOT_FINITE: Unusable = Unusable::Because("a value is not finite");

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
            (None, Content::TimeReply { base: base_of(device_ns), device_ns, sent_ns })
        }
        MavMessage::HIGHRES_IMU(imu) => {
            let time = DeviceTime::of_micros(imu.time_usec).ok_or(NO_TIME)?;
            (Some(time), Content::Inertial(inertial(&imu)?))
        }
        MavMessage::ATTITUDE_QUATERNION(attitude) => {
            let time = DeviceTime::of_millis(attitude.time_boot_ms);
            (Some(time), Content::Attitude(world_attitude(&attitude)?))
        }
        MavMessage::ODOMETRY(odometry) => {
            let time = DeviceTime::of_micros(odometry.time_usec).ok_or(NO_TIME)?;
            (Some(time), Content::Odometry(Box::new(step(&odometry)?)))
        }
        MavMessage::GIMBAL_DEVICE_ATTITUDE_STATUS(gimbal) => {
            let time = DeviceTime::of_millis(gimbal.time_boot_ms);
            (Some(time), Content::Head(head(&gimbal)?))
        }
        _ => return Err(Unusable::NotNeeded),
    };
    Ok((name, time, content))
}

/// HEARTBEAT, ATTITUDE_QUATERNION, HIGHRES_IMU, TIMESYNC, GIMBAL_DEVICE_ATTITUDE_STATUS, ODOMETRY.
const NEEDED: [u32; 6] = [0, 31, 105, 111, 285, 331];

fn inertial(imu: &HIGHRES_IMU_DATA) -> Result<Inertial, Unusable> {
    type F = HighresImuUpdatedFlags;
    let acceleration = F::HIGHRES_IMU_UPDATED_XACC | F::HIGHRES_IMU_UPDATED_YACC | F::HIGHRES_IMU_UPDATED_ZACC;
    let gyro = F::HIGHRES_IMU_UPDATED_XGYRO | F::HIGHRES_IMU_UPDATED_YGYRO | F::HIGHRES_IMU_UPDATED_ZGYRO;
    // A sender that never fills the field in means what it sends.
    let brings = |fields: F| imu.fields_updated.is_empty() || imu.fields_updated.contains(fields);
    let part =
        |fields: F, xyz: [f32; 3]| if brings(fields) { vector(xyz).map(flu_from_frd).map(Some) } else { Ok(None) };
    Ok(Inertial {
        acceleration: part(acceleration, [imu.xacc, imu.yacc, imu.zacc])?,
        angular_velocity: part(gyro, [imu.xgyro, imu.ygyro, imu.zgyro])?,
    })
}

fn world_attitude(attitude: &ATTITUDE_QUATERNION_DATA) -> Result<Attitude, Unusable> {
    let ned_from_frd = quaternion([attitude.q1, attitude.q2, attitude.q3, attitude.q4])?;
    let rates = vector([attitude.rollspeed, attitude.pitchspeed, attitude.yawspeed])?;
    Ok(Attitude { world_from_body: ENU_FROM_NED * ned_from_frd * FLU_FROM_FRD, angular_velocity: flu_from_frd(rates) })
}

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
    // MAVLink has no name for a body in FLU: one whose twist is in the axes of a FLU world is one.
    let (body, velocity, angular_velocity) = match odometry.child_frame_id {
        MavFrame::MAV_FRAME_BODY_FRD => (FLU_FROM_FRD, flu_from_frd(linear), flu_from_frd(angular)),
        MavFrame::MAV_FRAME_LOCAL_FLU => (DQuat::IDENTITY, linear, angular),
        _ => return Err(Unusable::Because("ODOMETRY.child_frame_id is not BODY_FRD or LOCAL_FLU")),
    };
    let knows = odometry.pose_covariance.iter().all(|value| value.is_finite());
    let pose_covariance = if knows { turned_covariance(&odometry.pose_covariance, turn_world) } else { [0.0; 36] };
    Ok(Step {
        odom_from_body: Isometry::new((world * rotation * body).normalize(), position),
        pose_covariance,
        velocity,
        angular_velocity,
        reset_counter: odometry.reset_counter,
    })
}

/// Joints are angles against the torso: one that the device holds against the horizon or north is none.
fn head(gimbal: &GIMBAL_DEVICE_ATTITUDE_STATUS_DATA) -> Result<Head, Unusable> {
    type F = GimbalDeviceFlags;
    let flags = gimbal.flags;
    if flags.intersects(F::GIMBAL_DEVICE_FLAGS_ROLL_LOCK | F::GIMBAL_DEVICE_FLAGS_PITCH_LOCK) {
        return Err(Unusable::Because("the gimbal's roll or pitch is against the horizon (ROLL_LOCK, PITCH_LOCK)"));
    }
    // The flag of the yaw's frame is new; before it the lock said the same.
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

fn vector(xyz: [f32; 3]) -> Result<DVec3, Unusable> {
    let vector = DVec3::from_array(xyz.map(f64::from));
    if vector.is_finite() { Ok(vector) } else { Err(NOT_FINITE) }
}

/// From w, x, y, z. Lengths that rounding does not explain are no rotation.
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
