//! Gaps as messages of the log: a gap is encoded as a diagnostic status and read back.

use std::sync::Arc;

use super::entry::Gap;
use realitysim_ros2::mcap_read::{Channel, LogMessage};
use realitysim_ros2::mcap_write::{Durability, channel_metadata};
use realitysim_ros2::messages::{DiagnosticArray, DiagnosticStatus, Header, KeyValue, Message};
use realitysim_ros2::topics;
use realitysim_ros2::topics::DIAGNOSTICS_PREFIX;

/// Name of the status behind the program's prefix.
const NAME: &str = "gap";

/// Encodes gaps as messages.
pub(super) struct GapMessages {
    channel: Arc<Channel>,
    robot: String,
}

impl GapMessages {
    pub fn new(robot: &str) -> Self {
        Self { channel: own_channel::<DiagnosticArray>(topics::DIAGNOSTICS), robot: robot.to_owned() }
    }

    /// Message that reports a gap.
    pub fn message(&self, gap: &Gap) -> LogMessage {
        let value = |key: &str, value: String| KeyValue { key: key.to_owned(), value };
        let status = DiagnosticStatus {
            level: DiagnosticStatus::WARN,
            name: format!("{DIAGNOSTICS_PREFIX}{NAME}"),
            message: format!("{} frames and {} other messages were not recorded", gap.frames, gap.messages),
            hardware_id: self.robot.clone(),
            values: vec![
                value("cause", gap.cause.clone()),
                value("frames", gap.frames.to_string()),
                value("messages", gap.messages.to_string()),
                value("untagged", gap.untagged.to_string()),
                value("first_ns", gap.first_ns.to_string()),
                value("last_ns", gap.last_ns.to_string()),
            ],
        };
        let report = DiagnosticArray { header: Header::at(gap.last_ns, ""), status: vec![status] };
        LogMessage {
            channel: Arc::clone(&self.channel),
            sequence: 0,
            log_time_ns: gap.last_ns,
            publish_time_ns: gap.last_ns,
            data: report.encode(),
        }
    }
}

/// Channel of a topic that a recording adds.
pub(super) fn own_channel<M: Message>(topic: &str) -> Arc<Channel> {
    Arc::new(Channel::of::<M>(0, topic, channel_metadata(Durability::Volatile)))
}

/// Gaps that a message reports; none if it is not a report of diagnostics.
pub(super) fn gaps_in(message: &LogMessage) -> Vec<Gap> {
    if message.channel.topic != topics::DIAGNOSTICS {
        return Vec::new();
    }
    let Ok(report) = DiagnosticArray::decode(&message.data) else { return Vec::new() };
    let is_gap = |status: &&DiagnosticStatus| status.name.strip_prefix(DIAGNOSTICS_PREFIX) == Some(NAME);
    report.status.iter().filter(is_gap).filter_map(gap).collect()
}

/// Decodes a gap; `None` if a value is missing or makes no sense.
fn gap(status: &DiagnosticStatus) -> Option<Gap> {
    let text = |key: &str| status.values.iter().find(|pair| pair.key == key).map(|pair| pair.value.clone());
    Some(Gap {
        cause: text("cause")?,
        frames: text("frames")?.parse().ok()?,
        messages: text("messages")?.parse().ok()?,
        // Earlier versions did not write this value.
        untagged: text("untagged").map_or(Some(0), |count| count.parse().ok())?,
        first_ns: text("first_ns")?.parse().ok()?,
        last_ns: text("last_ns")?.parse().ok()?,
    })
}
