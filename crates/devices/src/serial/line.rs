//! From the bytes of a port to measurements on the host's clock. Pure: when the bytes came is an argument.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::clock::{ClockStatus, DeviceClock};
use crate::mavlink::{Content, Decoder, Outgoing, PortCounts, Sender, TimeBase};
use realitysim_geometry::Isometry;

/// A measurement, stamped by the host's monotonic clock.
#[derive(Clone, Debug, PartialEq)]
pub struct Measured {
    pub sender: Sender,
    pub stamp_ns: i64,
    pub content: Content,
}

/// A valid tag that is to be sent: `camera_link` in `map`.
#[derive(Clone, Debug, PartialEq)]
pub struct Pose {
    /// Of the exposure, monotonic.
    pub stamp_ns: i64,
    pub map_from_camera_link: Isometry,
    /// Row by row over x, y, z and rotations about x, y, z.
    pub covariance: [f64; 36],
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct LineStatus {
    #[serde(flatten)]
    pub counts: PortCounts,
    /// How often nobody took what was to be sent: questions for the time, poses.
    pub unsent: u64,
    pub clocks: Vec<SenderClock>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SenderClock {
    #[serde(flatten)]
    pub sender: Sender,
    pub base: TimeBase,
    #[serde(flatten)]
    pub clock: ClockStatus,
}

/// How often the devices are asked for their time. With the answer 56 bytes: 224 a second.
const ASK_EVERY_NS: i64 = 250_000_000;
const HEARTBEAT_EVERY_NS: i64 = 1_000_000_000;

#[derive(Debug)]
pub struct Line {
    decoder: Decoder,
    clocks: BTreeMap<(Sender, TimeBase), DeviceClock>,
    outgoing: Outgoing,
    /// Time of a byte on the wire; 0 where the baud rate is only a number, as on USB.
    byte_ns: i64,
    asked_ns: Option<i64>,
    heartbeat_ns: Option<i64>,
    answers: Vec<u8>,
    unsent: u64,
}

impl Line {
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

    /// Bytes that were there at `host_ns`.
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
                    // Nothing was measured after it came.
                    let stamp_ns = middle_ns.saturating_add(offset.offset_ns).min(host_ns);
                    take(Measured { sender, stamp_ns, content });
                }
            }
        });
    }

    /// What is to be sent now: answers, questions, the heartbeat.
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

    /// As a message; the devices know its clock from our answers to their TIMESYNC.
    pub fn pose(&mut self, pose: &Pose) -> Vec<u8> {
        self.outgoing.pose(pose.stamp_ns, &pose.map_from_camera_link, &pose.covariance)
    }

    /// What was due could not be sent.
    pub fn was_not_taken(&mut self) {
        self.unsent += 1;
    }

    /// The port was closed: what follows is another beginning.
    pub fn interrupted(&mut self) {
        self.decoder.interrupted();
        self.answers.clear();
    }

    pub fn status(&self) -> LineStatus {
        let clocks = self.clocks.iter().filter_map(|((sender, base), clock)| {
            Some(SenderClock { sender: *sender, base: *base, clock: clock.status()? })
        });
        LineStatus { counts: self.decoder.counts().clone(), unsent: self.unsent, clocks: clocks.collect() }
    }
}
