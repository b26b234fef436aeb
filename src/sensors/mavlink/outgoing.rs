//! What this program sends: its heartbeat, questions for the time and answers to them, and tags for the robot.

use glam::DVec3;
use mavlink::dialects::common::{
    HEARTBEAT_DATA, MavAutopilot, MavEstimatorType, MavFrame, MavMessage, MavState, MavType, ODOMETRY_DATA,
    TIMESYNC_DATA,
};
use mavlink::{MAVLinkV2MessageRaw, MavHeader};

use crate::geometry::Isometry;

/// Frames in the name of one component, numbered.
#[derive(Debug)]
pub struct Outgoing {
    header: MavHeader,
}

/// MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY: what a camera that locates itself is called.
const COMPONENT: u8 = 197;

impl Outgoing {
    /// As a component of the robot's system.
    pub fn new(system: u8) -> Self {
        Self { header: MavHeader { system_id: system.into(), component_id: COMPONENT, sequence: 0 } }
    }

    pub fn heartbeat(&mut self) -> Vec<u8> {
        self.frame(&MavMessage::HEARTBEAT(HEARTBEAT_DATA {
            mavtype: MavType::MAV_TYPE_ONBOARD_CONTROLLER,
            autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
            system_status: MavState::MAV_STATE_ACTIVE,
            mavlink_version: 3,
            ..HEARTBEAT_DATA::DEFAULT
        }))
    }

    /// Asks every device on the line what time it has; `host_ns` comes back with the answer.
    pub fn time_request(&mut self, host_ns: i64) -> Vec<u8> {
        self.frame(&MavMessage::TIMESYNC(TIMESYNC_DATA { tc1: 0, ts1: host_ns, ..TIMESYNC_DATA::DEFAULT }))
    }

    pub fn time_reply(&mut self, host_ns: i64, its_ns: i64) -> Vec<u8> {
        self.frame(&MavMessage::TIMESYNC(TIMESYNC_DATA { tc1: host_ns, ts1: its_ns, ..TIMESYNC_DATA::DEFAULT }))
    }

    /// A valid tag: `camera_link` in `map`, its covariance row by row; stamped by the clock that TIMESYNC answers tell.
    pub fn pose(&mut self, stamp_ns: i64, map_from_camera_link: &Isometry, covariance: &[f64; 36]) -> Vec<u8> {
        let DVec3 { x, y, z } = map_from_camera_link.translation;
        let q = map_from_camera_link.rotation;
        let mut triangle = [0.0; 21];
        let upper = (0..6).flat_map(|row| (row..6).map(move |column| 6 * row + column));
        for (place, index) in triangle.iter_mut().zip(upper) {
            *place = covariance[index] as f32;
        }
        self.frame(&MavMessage::ODOMETRY(ODOMETRY_DATA {
            time_usec: u64::try_from(stamp_ns / 1_000).unwrap_or(0),
            frame_id: MavFrame::MAV_FRAME_LOCAL_FLU,
            // A body in FLU, as this program reads it too.
            child_frame_id: MavFrame::MAV_FRAME_LOCAL_FLU,
            x: x as f32,
            y: y as f32,
            z: z as f32,
            q: [q.w, q.x, q.y, q.z].map(|part| part as f32),
            pose_covariance: triangle,
            velocity_covariance: [f32::NAN; 21],
            estimator_type: MavEstimatorType::MAV_ESTIMATOR_TYPE_VISION,
            ..ODOMETRY_DATA::DEFAULT
        }))
    }

    fn frame(&mut self, message: &MavMessage) -> Vec<u8> {
        let mut raw = MAVLinkV2MessageRaw::new();
        raw.serialize_message(self.header, message);
        self.header.sequence = self.header.sequence.wrapping_add(1);
        raw.raw_bytes().to_vec()
    }
}
