//! What this program sends: its heartbeat, questions for the time and answers to them, and tags for the robot.

use glam::DVec3;
use mavlink::dialects::common::{MavEstimatorType, MavFrame, MavMessage, MavType, ODOMETRY_DATA, TIMESYNC_DATA};

use super::Sender;
use super::sequence_counter::{Numbered, w_first};
use realitysim_geometry::Isometry;

/// Frames in the name of one component, numbered.
#[derive(Debug)]
pub struct Outgoing {
    sender: Numbered,
}

/// MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY: what a camera that locates itself is called.
const COMPONENT: u8 = 197;

impl Outgoing {
    /// As a component of the robot's system.
    pub fn new(system: u8) -> Self {
        Self { sender: Numbered::new(system, COMPONENT, MavType::MAV_TYPE_ONBOARD_CONTROLLER) }
    }

    pub fn name(system: u8) -> Sender {
        Sender { system, component: COMPONENT }
    }

    pub fn heartbeat(&mut self) -> Vec<u8> {
        self.sender.heartbeat()
    }

    /// Asks every device on the line what time it has; `host_ns` comes back with the answer.
    pub fn time_request(&mut self, host_ns: i64) -> Vec<u8> {
        self.sender.frame(&MavMessage::TIMESYNC(TIMESYNC_DATA { tc1: 0, ts1: host_ns, ..TIMESYNC_DATA::DEFAULT }))
    }

    pub fn time_reply(&mut self, host_ns: i64, its_ns: i64) -> Vec<u8> {
        self.sender.frame(&MavMessage::TIMESYNC(TIMESYNC_DATA { tc1: host_ns, ts1: its_ns, ..TIMESYNC_DATA::DEFAULT }))
    }

    /// A valid tag: `camera_link` in `map`, its covariance row by row; stamped by the clock that TIMESYNC answers tell.
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
            // A body in FLU, as this program reads it too.
            child_frame_id: MavFrame::MAV_FRAME_LOCAL_FLU,
            x: x as f32,
            y: y as f32,
            z: z as f32,
            q: w_first(map_from_camera_link.rotation),
            pose_covariance: triangle,
            velocity_covariance: [f32::NAN; 21],
            estimator_type: MavEstimatorType::MAV_ESTIMATOR_TYPE_VISION,
            ..ODOMETRY_DATA::DEFAULT
        }))
    }
}
