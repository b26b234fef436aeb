//! Writes what a robot's microcontroller sends, to play recordings back to robot software.

use glam::{DQuat, DVec3};
use mavlink::dialects::common::{
    ATTITUDE_QUATERNION_DATA, HIGHRES_IMU_DATA, HighresImuUpdatedFlags, MavFrame, MavMessage, MavType, ODOMETRY_DATA,
};

use super::axes::{ENU_FROM_NED, FLU_FROM_FRD, flu_from_frd};
use super::sequence_counter::{NumberedSender, to_wxyz};
use realitysim_geometry::Isometry;

/// A sender of numbered frames in the name of a robot's autopilot.
///
/// Times count from the start of the microcontroller, nanoseconds. Stamps in microseconds are never 0, which would mean "unknown".
#[derive(Debug)]
pub struct RobotSide {
    sender: NumberedSender,
}

/// MAV_COMP_ID_AUTOPILOT1.
const AUTOPILOT: u8 = 1;

impl RobotSide {
    /// Creates the sender of the robot with this MAVLink number.
    pub fn new(system: u8) -> Self {
        Self { sender: NumberedSender::new(system, AUTOPILOT, MavType::MAV_TYPE_GENERIC) }
    }

    /// Returns a HEARTBEAT frame.
    pub fn heartbeat(&mut self) -> Vec<u8> {
        self.sender.heartbeat()
    }

    /// Returns an ATTITUDE_QUATERNION frame: body (FLU) in the world (ENU), turn rate in the body's axes, radians per second.
    pub fn attitude(&mut self, boot_ns: i64, world_from_body: DQuat, angular_velocity: DVec3) -> Vec<u8> {
        let [q1, q2, q3, q4] = to_wxyz(ENU_FROM_NED.conjugate() * world_from_body * FLU_FROM_FRD.conjugate());
        // The turn from FLU to FRD is its own inverse.
        let rate = flu_from_frd(angular_velocity).as_vec3();
        self.sender.frame(&MavMessage::ATTITUDE_QUATERNION(ATTITUDE_QUATERNION_DATA {
            time_boot_ms: (boot_ns / 1_000_000).clamp(0, i64::from(u32::MAX)) as u32,
            q1,
            q2,
            q3,
            q4,
            rollspeed: rate.x,
            pitchspeed: rate.y,
            yawspeed: rate.z,
            ..ATTITUDE_QUATERNION_DATA::DEFAULT
        }))
    }

    /// Returns a HIGHRES_IMU frame with a turn rate in the body's axes (FLU), radians per second.
    pub fn turn_rate(&mut self, boot_ns: i64, angular_velocity: DVec3) -> Vec<u8> {
        let rate = flu_from_frd(angular_velocity).as_vec3();
        type F = HighresImuUpdatedFlags;
        self.sender.frame(&MavMessage::HIGHRES_IMU(HIGHRES_IMU_DATA {
            time_usec: micros(boot_ns),
            xgyro: rate.x,
            ygyro: rate.y,
            zgyro: rate.z,
            fields_updated: F::HIGHRES_IMU_UPDATED_XGYRO | F::HIGHRES_IMU_UPDATED_YGYRO | F::HIGHRES_IMU_UPDATED_ZGYRO,
            ..HIGHRES_IMU_DATA::DEFAULT
        }))
    }

    /// Returns an ODOMETRY frame with the pose of `base_footprint` in `odom`, metres.
    pub fn odometry(&mut self, boot_ns: i64, odom_from_body: &Isometry) -> Vec<u8> {
        let place = odom_from_body.translation.as_vec3();
        self.sender.frame(&MavMessage::ODOMETRY(ODOMETRY_DATA {
            time_usec: micros(boot_ns),
            frame_id: MavFrame::MAV_FRAME_LOCAL_FLU,
            child_frame_id: MavFrame::MAV_FRAME_LOCAL_FLU,
            x: place.x,
            y: place.y,
            z: place.z,
            q: to_wxyz(odom_from_body.rotation),
            pose_covariance: [f32::NAN; 21],
            velocity_covariance: [f32::NAN; 21],
            ..ODOMETRY_DATA::DEFAULT
        }))
    }
}

/// Converts nanoseconds into microseconds, at least 1.
fn micros(boot_ns: i64) -> u64 {
    u64::try_from(boot_ns / 1_000).unwrap_or(0).max(1)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::{Content, Decoder};
    use super::*;

    fn received(bytes: &[u8]) -> Content {
        let (mut decoder, mut all) = (Decoder::default(), Vec::new());
        decoder.push(bytes, |received| all.push(received.content));
        all.pop().expect("a message")
    }

    proptest! {
        #[test]
        fn what_a_robot_sends_is_what_this_program_reads(
            axis in (-1.0..1.0f64, -1.0..1.0f64, -1.0..1.0f64), angle in -3.0..3.0f64,
            rate in (-3.0..3.0f64, -3.0..3.0f64, -3.0..3.0f64),
            place in (-5.0..5.0f64, -5.0..5.0f64, -1.0..1.0f64),
        ) {
            let vector = |(x, y, z): (f64, f64, f64)| DVec3::new(x, y, z);
            let axis = vector(axis).try_normalize().unwrap_or(DVec3::Z);
            let (turn, rate, place) = (DQuat::from_axis_angle(axis, angle), vector(rate), vector(place));
            let mut robot = RobotSide::new(3);
            let same = |a: DQuat, b: DQuat| a.dot(b).abs() > 1.0 - 1e-6;
            match received(&robot.attitude(5_000_000_000, turn, rate)) {
                Content::Attitude(found) => {
                    prop_assert!(same(found.world_from_body, turn) && found.angular_velocity.distance(rate) < 1e-5);
                }
                other => prop_assert!(false, "{:?}", other),
            }
            match received(&robot.turn_rate(5_000_000_000, rate)) {
                Content::Inertial(found) => {
                    prop_assert!(found.acceleration.is_none());
                    prop_assert!(found.angular_velocity.is_some_and(|own| own.distance(rate) < 1e-5));
                }
                other => prop_assert!(false, "{:?}", other),
            }
            match received(&robot.odometry(5_000_000_000, &Isometry::new(turn, place))) {
                Content::Odometry(found) => {
                    prop_assert!(same(found.odom_from_body.rotation, turn));
                    prop_assert!(found.odom_from_body.translation.distance(place) < 1e-5);
                }
                other => prop_assert!(false, "{:?}", other),
            }
        }
    }
}
