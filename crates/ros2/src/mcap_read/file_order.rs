//! Reads a log from front to back, which needs no index and survives a torn tail, damaged chunks and garbage between them.

use std::io::{Read, Seek};

use mcap::records::op;

use super::channels::{Channels, Definition};
use super::chunk::{Chunk, MAX_CHUNK_BYTES, MESSAGE_HEAD_BYTES, PlacedMessage, parse_message};
use super::error::{Damage, MAGIC, ReadError};
use super::fields::Fields;
use super::resync::{CHUNK_HEAD_BYTES, has_chunk_shape, next_chunk};
use super::source::{Record, Source};
use super::unpacking::Unpacking;
use crate::cdr::MAX_MESSAGE_BYTES;

/// Largest schema or channel record, bytes.
const MAX_DEFINITION_BYTES: u64 = 4 << 20;

/// Largest number of times that a reader goes back to a chunk which a wrong length has led it past.
///
/// Each may cost as much as reading the file once, and needs a length that is wrong and fits into the file. Going forward
/// to the next chunk costs no more than reading the file once, so it has no limit.
const MAX_RESYNCS: u32 = 64;

/// Length of the body of a footer, bytes.
const FOOTER_BODY_BYTES: u64 = 20;
/// Length of the body of a summary offset record, bytes.
const SUMMARY_OFFSET_BODY_BYTES: u64 = 17;
/// Length of the body of a data end record, bytes.
const DATA_END_BODY_BYTES: u64 = 4;

/// The state of reading a log from front to back.
pub(super) struct FileOrder {
    /// File offset of the next record.
    position: u64,
    /// The chunk whose messages are being delivered.
    chunk: Option<Chunk>,
    /// Whether the file has chunks, and with them message indexes.
    has_chunks: bool,
    /// The part of the file that has been delivered.
    trusted: Trusted,
    /// File offset of the last damaged chunk.
    last_bad_chunk: Option<u64>,
    /// Whether the header of the file is behind.
    is_past_head: bool,
    /// Number of times that the reader went back.
    resyncs: u32,
    unpacking: Unpacking,
}

/// The part of the file before the end of the last sound chunk or loose message. It is not read again.
#[derive(Clone, Copy)]
struct Trusted {
    /// Where the part ends.
    end: u64,
    /// Number of bytes in it that were not used.
    skipped: u64,
}

impl FileOrder {
    pub fn new() -> Self {
        let start = MAGIC.len() as u64;
        let trusted = Trusted { end: start, skipped: 0 };
        Self {
            position: start,
            chunk: None,
            has_chunks: false,
            trusted,
            last_bad_chunk: None,
            is_past_head: false,
            resyncs: 0,
            unpacking: Unpacking::default(),
        }
    }

    /// Delivers the next message.
    pub fn next<R: Read + Seek>(
        &mut self,
        source: &mut Source<R>,
        channels: &mut Channels,
        damage: &mut Damage,
    ) -> Result<Option<PlacedMessage>, ReadError> {
        loop {
            if let Some(chunk) = &mut self.chunk {
                if let Some(message) = chunk.next(channels) {
                    return Ok(Some(message));
                }
                self.chunk = None;
            }
            if self.position >= source.length() {
                return Ok(None);
            }
            let record = match source.record_at(self.position)? {
                Ok(record) => record,
                Err(error) => {
                    damage.note(|| format!("record at byte {}: {error}", self.position));
                    match self.resync(source, damage)? {
                        Some(record) => record,
                        None => return Ok(None),
                    }
                }
            };
            let is_first = !std::mem::replace(&mut self.is_past_head, true);
            self.position = record.end();
            if is_first {
                if record.opcode != op::HEADER {
                    damage.bad_record(record.offset, record.bytes(), "expected the header of the file");
                }
                continue;
            }
            // What follows the data only repeats definitions and lists positions.
            let ends_data = (op::DATA_END, DATA_END_BODY_BYTES);
            if [ends_data, (op::FOOTER, FOOTER_BODY_BYTES)].contains(&(record.opcode, record.length)) {
                self.position = source.length();
                return Ok(None);
            }
            if let Some(message) = self.process_record(&record, source, channels, damage)? {
                self.trusted = Trusted { end: record.end(), skipped: damage.bytes_skipped };
                return Ok(Some(message));
            }
        }
    }

    /// Moves from a record that cannot be parsed to the next chunk. That chunk may lie before the record, because a wrong length
    /// may have led past it.
    fn resync<R: Read + Seek>(
        &mut self,
        source: &mut Source<R>,
        damage: &mut Damage,
    ) -> Result<Option<Record>, ReadError> {
        self.is_past_head = true;
        let Trusted { end, skipped } = self.trusted;
        let from = self.last_bad_chunk.map_or(end, |bad| end.max(bad + 1));
        let found = next_chunk(source, from)?;
        let goes_back = found.is_some_and(|record| record.offset < self.position);
        let found = found.filter(|_| !goes_back || self.resyncs < MAX_RESYNCS);
        self.resyncs += u32::from(goes_back);
        let next = found.map_or(source.length(), |record| record.offset);
        match next.checked_sub(self.position) {
            Some(passed) => damage.bytes_skipped += passed,
            None => damage.bytes_skipped = skipped + (next - end),
        }
        self.position = next;
        Ok(found)
    }

    /// Processes a record; returns its message if it is one that is selected.
    fn process_record<R: Read + Seek>(
        &mut self,
        record: &Record,
        source: &mut Source<R>,
        channels: &mut Channels,
        damage: &mut Damage,
    ) -> Result<Option<PlacedMessage>, ReadError> {
        let limit = match record.opcode {
            op::CHUNK => MAX_CHUNK_BYTES,
            op::MESSAGE => MAX_MESSAGE_BYTES as u64 + MESSAGE_HEAD_BYTES,
            op::SCHEMA | op::CHANNEL => MAX_DEFINITION_BYTES,
            _ => {
                let mut head = Vec::new();
                source.read_at(record.body(), record.length.min(CHUNK_HEAD_BYTES), &mut head)?;
                if let Some(error) = find_implausibility(record, &head) {
                    damage.bad_record(record.offset, record.bytes(), error);
                }
                return Ok(None);
            }
        };
        if record.length > limit {
            let error = format!("expected at most {limit} bytes, found {}", record.length);
            let is_chunk = record.opcode == op::CHUNK;
            self.last_bad_chunk = if is_chunk { Some(record.offset) } else { self.last_bad_chunk };
            let skip = if is_chunk { Damage::bad_chunk } else { Damage::bad_record };
            skip(damage, record.offset, record.bytes(), &error);
            return Ok(None);
        }
        let mut body = Vec::new();
        if !source.read_at(record.body(), record.length, &mut body)? {
            damage.bad_record(record.offset, record.bytes(), "expected a record, found the end of the file");
            return Ok(None);
        }
        match record.opcode {
            op::CHUNK => {
                self.has_chunks = true;
                self.chunk = Chunk::unpack(body, record.offset, &mut self.unpacking, channels, damage);
                if self.chunk.is_some() {
                    self.trusted = Trusted { end: record.end(), skipped: damage.bytes_skipped };
                } else {
                    self.last_bad_chunk = Some(record.offset);
                }
            }
            op::MESSAGE if self.has_chunks && has_message_index_shape(&body) => {
                damage.bad_record(record.offset, record.bytes(), "the opcode of a message index is damaged");
            }
            op::MESSAGE => return Ok(read_loose_message(&body, record, channels, damage)),
            opcode => {
                let defined =
                    Definition::parse(opcode, &body).and_then(|found| found.map_or(Ok(()), |d| channels.define(d)));
                if let Err(error) = defined {
                    damage.bad_record(record.offset, record.bytes(), &error);
                }
            }
        }
        Ok(None)
    }
}

/// Reads a message outside of any chunk, if its channel is selected.
fn read_loose_message(body: &[u8], record: &Record, channels: &Channels, damage: &mut Damage) -> Option<PlacedMessage> {
    let id = Fields::new(body).u16();
    let channel = id.and_then(|id| channels.get(id));
    match (id.and_then(|id| channels.wanted(id)), channel) {
        (Some(false), _) => None,
        (_, Some(channel)) => {
            let message = parse_message(body, channel);
            if message.is_none() {
                damage.bad_record(record.offset, record.bytes(), "a message that is too short");
            }
            message.map(|message| (message, Some(record.body() + MESSAGE_HEAD_BYTES)))
        }
        (_, None) => {
            damage.orphan_messages += 1;
            damage.bytes_skipped += record.bytes();
            damage.note(|| format!("message at byte {}: its channel was never defined", record.offset));
            None
        }
    }
}

/// Looks for signs that a record which is not read has a damaged opcode: it might be a chunk.
///
/// Such signs are the shape of a chunk, a wrong length, and an opcode that the format has not assigned. `head` is the start of
/// the record's body.
fn find_implausibility(record: &Record, head: &[u8]) -> Option<&'static str> {
    match record.opcode {
        op::FOOTER => Some("a footer of the wrong length"),
        op::SUMMARY_OFFSET if record.length != SUMMARY_OFFSET_BODY_BYTES => {
            Some("a summary offset of the wrong length")
        }
        op::DATA_END => Some("an end of data of the wrong length"),
        0x10..0x80 => Some("an unknown opcode"),
        _ if has_chunk_shape(record, head) => Some("the opcode of a chunk is damaged"),
        _ => None,
    }
}

/// Whether the body of a message record has the shape of a message index: the number of bytes where a message has its
/// sequence number agrees with the length of the record.
fn has_message_index_shape(body: &[u8]) -> bool {
    let mut fields = Fields::new(body);
    let mut entries = || {
        fields.u16()?;
        fields.u32()
    };
    entries().is_some_and(|bytes| bytes % 16 == 0 && bytes as usize + fields.taken() == body.len())
}
