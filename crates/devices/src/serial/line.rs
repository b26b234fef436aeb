//! Turns the bytes of a port into measurements on the host's clock. The module is pure: the time of arrival is an argument.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::clock::{ClockStatus, DeviceClock};
use crate::mavlink::{Content, Decoder, Outgoing, PortCounts, Sender, TimeBase};
use realitysim_geometry::Isometry;

/// A measurement of a device, stamped by the host's clock.
#[derive(Clone, Debug, PartialEq)]
pub struct Measured {
    /// The device that measured.
    pub sender: Sender,
    /// Time of the measurement by the host's monotonic clock, nanoseconds.
    pub stamp_ns: i64,
    /// What was measured.
    pub content: Content,
}

/// A valid tag to be sent on a port.
#[derive(Clone, Debug, PartialEq)]
pub struct Pose {
    /// Time of the exposure by the monotonic clock, nanoseconds.
    pub stamp_ns: i64,
    /// Pose of `camera_link` in `map`, metres.
    pub map_from_camera_link: Isometry,
    /// Covariance, 6 x 6 row by row over x, y, z and rotations about them.
    pub covariance: [f64; 36],
}

/// State of a line, for people and logs.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LineStatus {
    /// What the port has carried so far.
    #[serde(flatten)]
    pub counts: PortCounts,
    /// Number of times that bytes could not be sent because the device did not take them: questions for the time, poses.
    pub unsent: u64,
    /// The clocks of the devices.
    #[serde(default)]
    pub clocks: Vec<SenderClock>,
}

/// State of one clock of one device.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SenderClock {
    /// The device.
    #[serde(flatten)]
    pub sender: Sender,
    /// What the clock counts from.
    pub base: TimeBase,
    /// Offset and drift of the clock.
    #[serde(flatten)]
    pub clock: ClockStatus,
}

/// Time between two questions for the devices' time, nanoseconds. A question with its answer has 56 bytes: 224 a second.
const ASK_EVERY_NS: i64 = 250_000_000;
/// Time between two heartbeats, nanoseconds.
const HEARTBEAT_EVERY_NS: i64 = 1_000_000_000;

/// The state of one serial line: its decoder, the clocks of its devices, and what is to be sent.
#[derive(Debug)]
pub struct Line {
    decoder: Decoder,
    clocks: BTreeMap<(Sender, TimeBase), DeviceClock>,
    outgoing: Outgoing,
    /// Time of a byte on the wire; 0 where the baud rate means nothing, as on USB.
    byte_ns: i64,
    /// Time of the last question.
    asked_ns: Option<i64>,
    /// Time of the last heartbeat.
    heartbeat_ns: Option<i64>,
    /// Answers to devices that are still to be sent.
    answers: Vec<u8>,
    unsent: u64,
}

impl Line {
    /// Creates a line of the robot with the MAVLink number `system`, on which a byte takes `byte_ns` nanoseconds.
    pub fn new(system: u8, byte_ns: i64) -> Self {
        Self {
            decoder: Decoder::beside(Outgoing::name(system)),
            clocks: BTreeMap::new(),
            outgoing: Outgoing::new(system),
            byte_ns,
            asked_ns: None,
            heartbeat_ns: None,
            answers: Vec::new(),
            unsent: 0,
        }
    }

    /// Takes bytes that were there at `host_ns`, and hands every measurement that they complete to `take`.
    pub fn push(&mut self, bytes: &[u8], host_ns: i64, mut take: impl FnMut(Measured)) {
        let Self { decoder, clocks, outgoing, byte_ns, answers, .. } = self;
        decoder.push(bytes, |received| {
            let sender = received.sender;
            match received.content {
                Content::Heartbeat => {}
                Content::TimeRequest { its_ns } => answers.extend(outgoing.time_reply(host_ns, its_ns)),
                Content::TimeReply { base, device_ns, sent_ns } => {
                    clocks.entry((sender, base)).or_default().exchanged(sent_ns, device_ns, host_ns);
                }
                content => {
                    let Some(time) = received.time else { return };
                    let clock = clocks.entry((sender, time.base)).or_default();
                    let on_wire_ns = byte_ns.saturating_mul(received.wire_bytes as i64);
                    clock.arrived(time.floor_ns, time.resolution_ns, host_ns.saturating_sub(on_wire_ns));
                    let middle_ns = time.middle_ns();
                    let Some(offset) = clock.offset(middle_ns) else { return };
                    // A measurement cannot be later than its arrival.
                    let stamp_ns = middle_ns.saturating_add(offset.offset_ns).min(host_ns);
                    take(Measured { sender, stamp_ns, content });
                }
            }
        });
    }

    /// Returns the bytes that are to be sent now: answers, questions, the heartbeat.
    pub fn due(&mut self, host_ns: i64) -> Vec<u8> {
        let mut bytes = std::mem::take(&mut self.answers);
        let is_due = |last: Option<i64>, every: i64| last.is_none_or(|last| host_ns.saturating_sub(last) >= every);
        if is_due(self.heartbeat_ns, HEARTBEAT_EVERY_NS) {
            self.heartbeat_ns = Some(host_ns);
            bytes.extend(self.outgoing.heartbeat());
        }
        if is_due(self.asked_ns, ASK_EVERY_NS) {
            self.asked_ns = Some(host_ns);
            bytes.extend(self.outgoing.time_request(host_ns));
        }
        bytes
    }

    /// Returns the message of a pose. The devices know the clock of its stamp from the answers to their TIMESYNC.
    pub fn pose(&mut self, pose: &Pose) -> Vec<u8> {
        self.outgoing.pose(pose.stamp_ns, &pose.map_from_camera_link, &pose.covariance)
    }

    /// Counts bytes that could not be sent.
    pub fn was_not_taken(&mut self) {
        self.unsent += 1;
    }

    /// Tells that the port was closed: an unfinished message and unsent answers are dropped.
    pub fn interrupted(&mut self) {
        self.decoder.interrupted();
        self.answers.clear();
    }

    /// Returns the state of the line.
    pub fn status(&self) -> LineStatus {
        let clocks = self.clocks.iter().filter_map(|((sender, base), clock)| {
            Some(SenderClock { sender: *sender, base: *base, clock: clock.status()? })
        });
        LineStatus { counts: self.decoder.counts().clone(), unsent: self.unsent, clocks: clocks.collect() }
    }
}
