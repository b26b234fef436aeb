//! Decodes MAVLink 2 from a serial line: bytes in, measurements out (<https://mavlink.io/en/guide/serialization.html>).
//!
//! There is no I/O and no clock: the same bytes give the same measurements and counts, however they were cut into reads.
//! All vectors and rotations that leave this module are in the axes of REP 103: body x forward, y left, z up.

mod axes;
mod framing;
mod measurement;
mod outgoing;
mod resets;
mod robot;
mod sequence_counter;
#[cfg(test)]
mod tests;

use std::borrow::Cow;
use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

pub use framing::{FRAME_OVERHEAD_BYTES, FrameCounts};
pub use measurement::{Attitude, Content, DeviceTime, Head, Inertial, Step, TimeBase};
pub use outgoing::Outgoing;
pub use robot::RobotSide;

use framing::{Frame, Framer};
use measurement::Unusable;
use resets::Continuity;

/// The sender of a message; one port may carry several devices.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Sender {
    /// MAVLink's number of the system, that is, of the robot.
    pub system: u8,
    /// MAVLink's number of the component within the system.
    pub component: u8,
}

/// One message whose checksum is right.
#[derive(Clone, Debug, PartialEq)]
pub struct Received {
    /// The device that sent it.
    pub sender: Sender,
    /// Length of the whole frame, bytes: at a known baud rate it tells how long the message was on the wire.
    pub wire_bytes: usize,
    /// Time of the measurement by the device's own clock, if the message has one.
    pub time: Option<DeviceTime>,
    /// What the message says.
    pub content: Content,
}

/// Counts of what a port has carried so far.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct PortCounts {
    /// Counts of bytes and frames.
    #[serde(flatten)]
    pub frames: FrameCounts,
    /// Number of messages that were used, by MAVLink's name of the type.
    pub used: BTreeMap<Cow<'static, str>, u64>,
    /// Messages with a right checksum, of a known type that is not needed.
    pub not_needed: u64,
    /// Messages with a right checksum whose content cannot be used, by reason.
    pub unusable: BTreeMap<Cow<'static, str>, u64>,
    /// Messages that are missing by the senders' sequence numbers. These count modulo 256, so a device that restarts may add
    /// up to 255.
    pub lost: u64,
    /// Number of times that a device's odometry jumped and was joined again.
    pub resets: u64,
    /// Messages that bear this program's own name, because what it sent came back. They are not used.
    pub echoes: u64,
}

/// Largest number of senders on one port, more than any robot has. Further ones are noise whose checksum is right by chance.
const MAX_SENDERS: usize = 16;

/// Decodes the bytes of one port, and counts what comes of them.
#[derive(Debug, Default)]
pub struct Decoder {
    framer: Framer,
    senders: BTreeMap<Sender, SenderState>,
    counts: PortCounts,
    /// The name under which this program sends on the same line.
    own: Option<Sender>,
}

/// State that is kept for each sender.
#[derive(Debug, Default)]
struct SenderState {
    next_sequence: Option<u8>,
    odometry: Continuity,
}

impl Decoder {
    /// Creates a decoder for a line on which this program sends under the name `own`.
    pub fn beside(own: Sender) -> Self {
        Self { own: Some(own), ..Self::default() }
    }

    /// Takes the next bytes, and hands every message that they complete to `take`.
    pub fn push(&mut self, bytes: &[u8], mut take: impl FnMut(Received)) {
        let Self { framer, senders, counts, own } = self;
        framer.push(bytes, |frame| {
            if Some(frame.sender) == *own {
                counts.echoes += 1;
            } else if let Some(received) = read(senders, counts, &frame) {
                take(received);
            }
        });
        self.counts.frames = self.framer.counts();
    }

    /// Returns what the port has carried so far.
    pub fn counts(&self) -> &PortCounts {
        &self.counts
    }

    /// Tells that the port was closed: an unfinished frame is dropped, and messages missed meanwhile do not count as lost.
    pub fn interrupted(&mut self) {
        self.framer.drop_unfinished();
        self.counts.frames = self.framer.counts();
        for sender in self.senders.values_mut() {
            sender.next_sequence = None;
        }
    }
}

/// Reads the message in a frame, and counts what comes of it. `None` if it is not used.
fn read(senders: &mut BTreeMap<Sender, SenderState>, counts: &mut PortCounts, frame: &Frame) -> Option<Received> {
    let Some(id) = frame.id else {
        // A message of an unknown type cannot be checked: its sequence number counts only if it is the one expected.
        if let Some(state) = senders.get_mut(&frame.sender).filter(|state| state.next_sequence == Some(frame.sequence))
        {
            state.next_sequence = Some(frame.sequence.wrapping_add(1));
        }
        return None;
    };
    if !senders.contains_key(&frame.sender) && senders.len() >= MAX_SENDERS {
        *counts.unusable.entry("too many senders".into()).or_default() += 1;
        return None;
    }
    let state = senders.entry(frame.sender).or_default();
    if let Some(expected) = state.next_sequence {
        counts.lost += u64::from(frame.sequence.wrapping_sub(expected));
    }
    state.next_sequence = Some(frame.sequence.wrapping_add(1));
    let (name, time, content) = match measurement::read(id, frame.payload) {
        Ok(read) => read,
        Err(Unusable::NotNeeded) => {
            counts.not_needed += 1;
            return None;
        }
        Err(Unusable::Because(reason)) => {
            *counts.unusable.entry(reason.into()).or_default() += 1;
            return None;
        }
    };
    let content = match content {
        Content::Odometry(step) => {
            let (step, jumped) = state.odometry.join(time, step);
            counts.resets += u64::from(jumped);
            Content::Odometry(step)
        }
        content => content,
    };
    *counts.used.entry(name.into()).or_default() += 1;
    Some(Received { sender: frame.sender, wire_bytes: frame.wire_bytes, time, content })
}
