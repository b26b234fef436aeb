//! What every sender's frames have in common: its name, a number each, its heartbeat.

use mavlink::dialects::common::{HEARTBEAT_DATA, MavAutopilot, MavMessage, MavState, MavType};
use mavlink::{MAVLinkV2MessageRaw, MavHeader};

/// Frames of one component of a system, numbered.
#[derive(Debug)]
pub(super) struct Numbered {
    header: MavHeader,
    kind: MavType,
}

impl Numbered {
    pub fn new(system: u8, component: u8, kind: MavType) -> Self {
        Self { header: MavHeader { system_id: system.into(), component_id: component, sequence: 0 }, kind }
    }

    pub fn heartbeat(&mut self) -> Vec<u8> {
        self.frame(&MavMessage::HEARTBEAT(HEARTBEAT_DATA {
            mavtype: self.kind,
            autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
            system_status: MavState::MAV_STATE_ACTIVE,
            mavlink_version: 3,
            ..HEARTBEAT_DATA::DEFAULT
        }))
    }

    pub fn frame(&mut self, message: &MavMessage) -> Vec<u8> {
        let mut raw = MAVLinkV2MessageRaw::new();
        raw.serialize_message(self.header, message);
        self.header.sequence = self.header.sequence.wrapping_add(1);
        raw.raw_bytes().to_vec()
    }
}

/// The quaternion as MAVLink writes it: w first.
pub(super) fn w_first(rotation: glam::DQuat) -> [f32; 4] {
    [rotation.w, rotation.x, rotation.y, rotation.z].map(|part| part as f32)
}
