//! Writes what this program sends: heartbeats, questions for the time, answers to such questions, and tags for the robot.

use glam::DVec3;
use mavlink::dialects::common::{MavEstimatorType, MavFrame, MavMessage, MavType, ODOMETRY_DATA, TIMESYNC_DATA};

use super::Sender;
use super::sequence_counter::{NumberedSender, to_wxyz};
use realitysim_geometry::Isometry;

/// A sender of numbered frames in the name of this program.
#[derive(Debug)]
pub struct Outgoing {
    sender: NumberedSender,
}

/// MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY: MAVLink's number for a camera that locates itself.
const COMPONENT: u8 = 197;

impl Outgoing {
    /// Creates the sender as a component of the robot with this MAVLink number.
    pub fn new(system: u8) -> Self {
        Self { sender: NumberedSender::new(system, COMPONENT, MavType::MAV_TYPE_ONBOARD_CONTROLLER) }
    }

    /// Returns the name under which it sends.
    pub fn name(system: u8) -> Sender {
        Sender { system, component: COMPONENT }
    }

    /// Returns a HEARTBEAT frame.
    pub fn heartbeat(&mut self) -> Vec<u8> {
        self.sender.heartbeat()
    }

    /// Returns a TIMESYNC frame that asks every device on the line for its time; `host_ns` comes back with the answer.
    pub fn time_request(&mut self, host_ns: i64) -> Vec<u8> {
        self.sender.frame(&MavMessage::TIMESYNC(TIMESYNC_DATA { tc1: 0, ts1: host_ns, ..TIMESYNC_DATA::DEFAULT }))
    }

    /// Returns a TIMESYNC frame that answers a device's question; `its_ns` is the time in the question, nanoseconds.
    pub fn time_reply(&mut self, host_ns: i64, its_ns: i64) -> Vec<u8> {
        self.sender.frame(&MavMessage::TIMESYNC(TIMESYNC_DATA { tc1: host_ns, ts1: its_ns, ..TIMESYNC_DATA::DEFAULT }))
    }

    /// Returns an ODOMETRY frame with a valid tag: `camera_link` in `map`, metres, and its 6 x 6 covariance, row by row.
    ///
    /// The stamp, nanoseconds, is of the clock that the answers to TIMESYNC tell.
    pub fn pose(&mut self, stamp_ns: i64, map_from_camera_link: &Isometry, covariance: &[f64; 36]) -> Vec<u8> {
        let DVec3 { x, y, z } = map_from_camera_link.translation;
        let mut triangle = [0.0; 21];
        let upper = (0..6).flat_map(|row| (row..6).map(move |column| 6 * row + column));
        for (place, index) in triangle.iter_mut().zip(upper) {
            *place = covariance[index] as f32;
        }
        self.sender.frame(&MavMessage::ODOMETRY(ODOMETRY_DATA {
            time_usec: u64::try_from(stamp_ns / 1_000).unwrap_or(0),
            frame_id: MavFrame::MAV_FRAME_LOCAL_FLU,
            // This stands for a body in FLU, as in what this program reads.
            child_frame_id: MavFrame::MAV_FRAME_LOCAL_FLU,
            x: x as f32,
            y: y as f32,
            z: z as f32,
            q: to_wxyz(map_from_camera_link.rotation),
            pose_covariance: triangle,
            velocity_covariance: [f32::NAN; 21],
            estimator_type: MavEstimatorType::MAV_ESTIMATOR_TYPE_VISION,
            ..ODOMETRY_DATA::DEFAULT
        }))
    }
}
