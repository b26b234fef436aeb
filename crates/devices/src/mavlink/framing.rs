//! Frames out of a stream of bytes, whatever stands between them.

use mavlink::dialects::common::MavMessage;
use mavlink::{Message, calculate_crc};
use serde::Serialize;

use super::Sender;

/// A sound frame. An `id` of none belongs to a type that the dialect does not know, so that nothing can be checked.
pub(super) struct Frame<'a> {
    pub sender: Sender,
    pub sequence: u8,
    pub id: Option<u32>,
    pub payload: &'a [u8],
    pub wire_bytes: usize,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct FrameCounts {
    pub bytes: u64,
    /// Whole frames with a right checksum.
    pub frames: u64,
    /// Places that look like a frame of a known type, with a wrong checksum.
    pub crc_failures: u64,
    /// Bytes that belong to no frame.
    pub bytes_skipped: u64,
    /// What stands between two frames and looks like one of a type that the dialect `common` does not know.
    pub unknown: u64,
}

const START: u8 = 0xfd;
const HEADER_BYTES: usize = 10;
const CHECKSUM_BYTES: usize = 2;
const SIGNATURE_BYTES: usize = 13;
const SIGNED: u8 = 0x01;
/// What a MAVLink 2 frame has besides its payload, unsigned.
pub const FRAME_OVERHEAD_BYTES: usize = HEADER_BYTES + CHECKSUM_BYTES;

/// What has come of a frame so far.
enum Candidate {
    /// More bytes are needed to tell.
    Open,
    NoFrame {
        crc_failed: bool,
    },
    Whole {
        bytes: usize,
        known: bool,
    },
}

#[derive(Debug, Default)]
pub(super) struct Framer {
    /// Less than one frame between two calls.
    buffer: Vec<u8>,
    /// The byte before was the last of a frame.
    follows_frame: bool,
    counts: FrameCounts,
}

impl Framer {
    pub fn counts(&self) -> FrameCounts {
        self.counts
    }

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
            match judge(&self.buffer[start..], self.follows_frame) {
                Candidate::Open => break,
                Candidate::NoFrame { crc_failed } => {
                    self.counts.crc_failures += u64::from(crc_failed);
                    self.counts.bytes_skipped += 1;
                    // A real frame may begin within what looked like one.
                    start += 1;
                    self.follows_frame = false;
                }
                Candidate::Whole { bytes, known } => {
                    if known {
                        self.counts.frames += 1;
                    } else {
                        self.counts.unknown += 1;
                    }
                    take(frame(&self.buffer[start..start + bytes], known));
                    start += bytes;
                    self.follows_frame = true;
                }
            }
        }
        self.buffer.drain(..start);
    }

    pub fn drop_unfinished(&mut self) {
        self.counts.bytes_skipped += self.buffer.len() as u64;
        self.buffer.clear();
        self.follows_frame = false;
    }
}

/// What begins at a start marker.
fn judge(bytes: &[u8], follows_frame: bool) -> Candidate {
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
    let extra = MavMessage::extra_crc(id_of(bytes));
    if extra == 0 {
        // Its checksum cannot be known. That it stands between frames speaks for it.
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

fn frame(bytes: &[u8], known: bool) -> Frame<'_> {
    Frame {
        sequence: bytes[4],
        sender: Sender { system: bytes[5], component: bytes[6] },
        id: known.then(|| id_of(bytes)),
        payload: &bytes[HEADER_BYTES..HEADER_BYTES + usize::from(bytes[1])],
        wire_bytes: bytes.len(),
    }
}

fn id_of(bytes: &[u8]) -> u32 {
    u32::from_le_bytes([bytes[7], bytes[8], bytes[9], 0])
}
