//! Writes the frames of one sender: with its name, its sequence numbers and its heartbeat.

use mavlink::dialects::common::{HEARTBEAT_DATA, MavAutopilot, MavMessage, MavState, MavType};
use mavlink::{MAVLinkV2MessageRaw, MavHeader};

/// A component of a system that sends numbered frames.
#[derive(Debug)]
pub(super) struct NumberedSender {
    header: MavHeader,
    kind: MavType,
}

impl NumberedSender {
    /// Creates a sender whose first frame has the number 0.
    pub fn new(system: u8, component: u8, kind: MavType) -> Self {
        Self { header: MavHeader { system_id: system.into(), component_id: component, sequence: 0 }, kind }
    }

    /// Returns the next heartbeat as a frame.
    pub fn heartbeat(&mut self) -> Vec<u8> {
        self.frame(&MavMessage::HEARTBEAT(HEARTBEAT_DATA {
            mavtype: self.kind,
            autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
            system_status: MavState::MAV_STATE_ACTIVE,
            mavlink_version: 3,
            ..HEARTBEAT_DATA::DEFAULT
        }))
    }

    /// Returns a message as the next frame.
    pub fn frame(&mut self, message: &MavMessage) -> Vec<u8> {
        let mut raw = MAVLinkV2MessageRaw::new();
        raw.serialize_message(self.header, message);
        self.header.sequence = self.header.sequence.wrapping_add(1);
        raw.raw_bytes().to_vec()
    }
}

/// Returns a quaternion in MAVLink's order: w, x, y, z.
pub(super) fn to_wxyz(rotation: glam::DQuat) -> [f32; 4] {
    [rotation.w, rotation.x, rotation.y, rotation.z].map(|part| part as f32)
}
