//! MAVLink 2 from a serial line: bytes in, measurements out (<https://mavlink.io/en/guide/serialization.html>).
//!
//! No I/O, no clock: the same bytes give the same measurements and the same counts, however they were cut into reads.
//! All vectors and rotations leave this room in the axes of REP 103: body x forward, y left, z up.

mod axes;
mod framing;
mod measurement;
mod outgoing;
mod resets;
mod robot;
mod sequence_counter;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use serde::Serialize;

pub use framing::{FRAME_OVERHEAD_BYTES, FrameCounts};
pub use measurement::{Attitude, Content, DeviceTime, Head, Inertial, Step, TimeBase};
pub use outgoing::Outgoing;
pub use robot::RobotSide;

use framing::{Frame, Framer};
use measurement::Unusable;
use resets::Continuity;

/// Who sent a message: one port may carry several devices.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
pub struct Sender {
    pub system: u8,
    pub component: u8,
}

/// One sound message.
#[derive(Clone, Debug, PartialEq)]
pub struct Received {
    pub sender: Sender,
    /// The whole frame on the wire: at a known baud rate it says how long the message took.
    pub wire_bytes: usize,
    /// When the device measured, by its own clock.
    pub time: Option<DeviceTime>,
    pub content: Content,
}

/// What a port has carried so far.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct PortCounts {
    #[serde(flatten)]
    pub frames: FrameCounts,
    /// Messages that were used, by name.
    pub used: BTreeMap<&'static str, u64>,
    /// Sound messages of known types that nobody here needs.
    pub not_needed: u64,
    /// Sound messages whose content cannot be used, by reason.
    pub unusable: BTreeMap<&'static str, u64>,
    /// Messages that the senders' sequence numbers say are missing: modulo 256, a device that starts anew may count as up
    /// to 255.
    pub lost: u64,
    /// Estimates of odometry that jumped and were joined again.
    pub resets: u64,
    /// Messages of this program's own name: what it sent came back. They are not used.
    pub echoes: u64,
}

/// More senders on one port than any robot has: those beyond are noise that happens to have a right checksum.
const MAX_SENDERS: usize = 16;

/// Of one port.
#[derive(Debug, Default)]
pub struct Decoder {
    framer: Framer,
    senders: BTreeMap<Sender, Line>,
    counts: PortCounts,
    /// As which this program sends on the same line.
    own: Option<Sender>,
}

/// What must be remembered of a sender.
#[derive(Debug, Default)]
struct Line {
    next_sequence: Option<u8>,
    odometry: Continuity,
}

impl Decoder {
    /// Of a line on which this program sends under that name.
    pub fn beside(own: Sender) -> Self {
        Self { own: Some(own), ..Self::default() }
    }

    /// Hands every measurement that the bytes complete to `take`.
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

    pub fn counts(&self) -> &PortCounts {
        &self.counts
    }

    /// The line was interrupted: half a frame will not be completed, and what was lost meanwhile is not the line's loss.
    pub fn interrupted(&mut self) {
        self.framer.drop_unfinished();
        self.counts.frames = self.framer.counts();
        for line in self.senders.values_mut() {
            line.next_sequence = None;
        }
    }
}

fn read(senders: &mut BTreeMap<Sender, Line>, counts: &mut PortCounts, frame: &Frame) -> Option<Received> {
    let Some(id) = frame.id else {
        // Nobody can check a message of an unknown type: its number counts only where it is the one that must follow.
        if let Some(line) = senders.get_mut(&frame.sender).filter(|line| line.next_sequence == Some(frame.sequence)) {
            line.next_sequence = Some(frame.sequence.wrapping_add(1));
        }
        return None;
    };
    if !senders.contains_key(&frame.sender) && senders.len() >= MAX_SENDERS {
        *counts.unusable.entry("too many senders").or_default() += 1;
        return None;
    }
    let line = senders.entry(frame.sender).or_default();
    if let Some(expected) = line.next_sequence {
        counts.lost += u64::from(frame.sequence.wrapping_sub(expected));
    }
    line.next_sequence = Some(frame.sequence.wrapping_add(1));
    let (name, time, content) = match measurement::read(id, frame.payload) {
        Ok(read) => read,
        Err(Unusable::NotNeeded) => {
            counts.not_needed += 1;
            return None;
        }
        Err(Unusable::Because(reason)) => {
            *counts.unusable.entry(reason).or_default() += 1;
            return None;
        }
    };
    let content = match content {
        Content::Odometry(step) => {
            let (step, jumped) = line.odometry.join(time, step);
            counts.resets += u64::from(jumped);
            Content::Odometry(step)
        }
        content => content,
    };
    *counts.used.entry(name).or_default() += 1;
    Some(Received { sender: frame.sender, wire_bytes: frame.wire_bytes, time, content })
}
