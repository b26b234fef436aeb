//! Finds MAVLink 2 frames in a stream of bytes, whatever is between them.

use mavlink::dialects::common::MavMessage;
use mavlink::{Message, calculate_crc};
use serde::{Deserialize, Serialize};

use super::Sender;

/// A whole frame.
pub(super) struct Frame<'a> {
    pub sender: Sender,
    pub sequence: u8,
    /// Number of the message's type, with a right checksum. `None` for a type that the dialect does not know: its checksum
    /// cannot be checked.
    pub id: Option<u32>,
    pub payload: &'a [u8],
    /// Length of the whole frame, bytes.
    pub wire_bytes: usize,
}

/// Counts of the bytes and frames of a line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct FrameCounts {
    /// Bytes that came.
    pub bytes: u64,
    /// Whole frames with a right checksum.
    pub frames: u64,
    /// Places that look like a frame of a known type but have a wrong checksum.
    pub crc_failures: u64,
    /// Bytes that belong to no frame.
    pub bytes_skipped: u64,
    /// Frames between two others that look like ones of a type that the dialect `common` does not know.
    pub unknown: u64,
}

/// First byte of a MAVLink 2 frame.
const START: u8 = 0xfd;
const HEADER_BYTES: usize = 10;
const CHECKSUM_BYTES: usize = 2;
const SIGNATURE_BYTES: usize = 13;
/// Flag of a frame that ends with a signature.
const SIGNED: u8 = 0x01;
/// Length of an unsigned MAVLink 2 frame besides its payload, bytes.
pub const FRAME_OVERHEAD_BYTES: usize = HEADER_BYTES + CHECKSUM_BYTES;

/// What the bytes from a start marker on turn out to be.
enum Candidate {
    /// More bytes are needed to tell.
    Open,
    /// They are no frame.
    NoFrame {
        /// Whether they look like one of a known type with a wrong checksum.
        crc_failed: bool,
    },
    /// They begin with a whole frame.
    Whole {
        /// Length of the frame.
        bytes: usize,
        /// Whether its type is known and its checksum right.
        known: bool,
    },
}

/// Cuts a stream of bytes into frames.
#[derive(Debug, Default)]
pub(super) struct Framer {
    /// Bytes of an unfinished frame: less than one frame between two calls.
    buffer: Vec<u8>,
    /// Whether the byte before the buffer was the last one of a frame.
    follows_frame: bool,
    counts: FrameCounts,
}

impl Framer {
    pub fn counts(&self) -> FrameCounts {
        self.counts
    }

    /// Takes the next bytes, and hands every frame that they complete to `take`.
    pub fn push(&mut self, bytes: &[u8], mut take: impl FnMut(Frame)) {
        self.counts.bytes += bytes.len() as u64;
        self.buffer.extend_from_slice(bytes);
        let mut start = 0;
        loop {
            let rest = &self.buffer[start..];
            let Some(skipped) = rest.iter().position(|byte| *byte == START) else {
                self.counts.bytes_skipped += rest.len() as u64;
                self.follows_frame &= rest.is_empty();
                start = self.buffer.len();
                break;
            };
            self.counts.bytes_skipped += skipped as u64;
            self.follows_frame &= skipped == 0;
            start += skipped;
            match classify(&self.buffer[start..], self.follows_frame) {
                Candidate::Open => break,
                Candidate::NoFrame { crc_failed } => {
                    self.counts.crc_failures += u64::from(crc_failed);
                    self.counts.bytes_skipped += 1;
                    // A real frame may begin within these bytes.
                    start += 1;
                    self.follows_frame = false;
                }
                Candidate::Whole { bytes, known } => {
                    if known {
                        self.counts.frames += 1;
                    } else {
                        self.counts.unknown += 1;
                    }
                    take(parse_frame(&self.buffer[start..start + bytes], known));
                    start += bytes;
                    self.follows_frame = true;
                }
            }
        }
        self.buffer.drain(..start);
    }

    /// Drops an unfinished frame.
    pub fn drop_unfinished(&mut self) {
        self.counts.bytes_skipped += self.buffer.len() as u64;
        self.buffer.clear();
        self.follows_frame = false;
    }
}

/// Finds out whether a frame begins at a start marker.
fn classify(bytes: &[u8], follows_frame: bool) -> Candidate {
    let [_, length, flags, ..] = *bytes else { return Candidate::Open };
    if flags & !SIGNED != 0 {
        return Candidate::NoFrame { crc_failed: false };
    }
    let signature = if flags & SIGNED != 0 { SIGNATURE_BYTES } else { 0 };
    let end_of_payload = HEADER_BYTES + usize::from(length);
    let whole = end_of_payload + CHECKSUM_BYTES + signature;
    if bytes.len() < whole {
        return Candidate::Open;
    }
    let extra = MavMessage::extra_crc(message_id(bytes));
    if extra == 0 {
        // The checksum of an unknown type cannot be computed. It counts as a frame if it stands between two frames.
        return match bytes.get(whole) {
            None if follows_frame => Candidate::Open,
            Some(&START) if follows_frame => Candidate::Whole { bytes: whole, known: false },
            _ => Candidate::NoFrame { crc_failed: false },
        };
    }
    let stated = u16::from_le_bytes([bytes[end_of_payload], bytes[end_of_payload + 1]]);
    if calculate_crc(&bytes[1..end_of_payload], extra) == stated {
        Candidate::Whole { bytes: whole, known: true }
    } else {
        Candidate::NoFrame { crc_failed: true }
    }
}

/// Takes a whole frame apart.
fn parse_frame(bytes: &[u8], known: bool) -> Frame<'_> {
    Frame {
        sequence: bytes[4],
        sender: Sender { system: bytes[5], component: bytes[6] },
        id: known.then(|| message_id(bytes)),
        payload: &bytes[HEADER_BYTES..HEADER_BYTES + usize::from(bytes[1])],
        wire_bytes: bytes.len(),
    }
}

/// Returns the number of the message's type.
fn message_id(bytes: &[u8]) -> u32 {
    u32::from_le_bytes([bytes[7], bytes[8], bytes[9], 0])
}
