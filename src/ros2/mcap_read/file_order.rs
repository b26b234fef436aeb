//! Reading from front to back: needs no index, survives a torn tail and damaged chunks.

use std::io::{Read, Seek};

use mcap::records::op;

use super::channels::{Channels, Definition};
use super::chunk::{Chunk, MAX_CHUNK_BYTES, MESSAGE_HEAD_BYTES, Placed, message};
use super::error::{Damage, MAGIC, ReadError};
use super::fields::Fields;
use super::source::{Record, Source};
use crate::ros2::cdr::MAX_MESSAGE_BYTES;

/// A schema or channel that is larger is refused.
const MAX_DEFINITION_BYTES: u64 = 4 << 20;

/// Start, end, size and checksum of a chunk stand before the name of its compression.
const CHUNK_COMPRESSION_AT: usize = 28;

/// Enough for the head of a chunk whose compression has a name of usual length.
const CHUNK_HEAD_BYTES: u64 = 96;

const FOOTER_BODY_BYTES: u64 = 20;
const SUMMARY_OFFSET_BODY_BYTES: u64 = 17;
const DATA_END_BODY_BYTES: u64 = 4;

pub(super) struct FileOrder {
    position: u64,
    chunk: Option<Chunk>,
    /// Whether the file has chunks, and with them message indexes.
    chunked: bool,
}

impl FileOrder {
    pub fn new() -> Self {
        Self { position: MAGIC.len() as u64, chunk: None, chunked: false }
    }

    pub fn next<R: Read + Seek>(
        &mut self,
        source: &mut Source<R>,
        channels: &mut Channels,
        damage: &mut Damage,
    ) -> Result<Option<Placed>, ReadError> {
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
                    damage.bytes_skipped += source.length() - self.position;
                    damage.note(|| format!("record at byte {}: {error}", self.position));
                    self.position = source.length();
                    return Ok(None);
                }
            };
            let first = self.position == MAGIC.len() as u64;
            self.position = record.end();
            if first {
                if record.opcode != op::HEADER {
                    damage.bad_record(record.offset, record.bytes(), "expected the header of the file");
                }
                continue;
            }
            // What follows the data repeats it, or tells where it is.
            let ends_data = (op::DATA_END, DATA_END_BODY_BYTES);
            if [ends_data, (op::FOOTER, FOOTER_BODY_BYTES)].contains(&(record.opcode, record.length)) {
                self.position = source.length();
                return Ok(None);
            }
            if let Some(message) = self.enter(&record, source, channels, damage)? {
                return Ok(Some(message));
            }
        }
    }

    /// Deals with one record; returns its message if it is one.
    fn enter<R: Read + Seek>(
        &mut self,
        record: &Record,
        source: &mut Source<R>,
        channels: &mut Channels,
        damage: &mut Damage,
    ) -> Result<Option<Placed>, ReadError> {
        let limit = match record.opcode {
            op::CHUNK => MAX_CHUNK_BYTES,
            op::MESSAGE => MAX_MESSAGE_BYTES as u64 + MESSAGE_HEAD_BYTES,
            op::SCHEMA | op::CHANNEL => MAX_DEFINITION_BYTES,
            _ => {
                let mut head = Vec::new();
                source.read_at(record.body(), record.length.min(CHUNK_HEAD_BYTES), &mut head)?;
                if let Some(error) = implausible(record, &head) {
                    damage.bad_record(record.offset, record.bytes(), error);
                }
                return Ok(None);
            }
        };
        if record.length > limit {
            let error = format!("expected at most {limit} bytes, found {}", record.length);
            let skip = if record.opcode == op::CHUNK { Damage::bad_chunk } else { Damage::bad_record };
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
                self.chunked = true;
                self.chunk = Chunk::unpack(body, record.offset, channels, damage);
            }
            op::MESSAGE if self.chunked && has_message_index_shape(&body) => {
                damage.bad_record(record.offset, record.bytes(), "the opcode of a message index is damaged");
            }
            op::MESSAGE => return Ok(loose_message(&body, record, channels, damage)),
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

/// A message outside of any chunk.
fn loose_message(body: &[u8], record: &Record, channels: &Channels, damage: &mut Damage) -> Option<Placed> {
    let id = Fields::new(body).u16();
    let channel = id.and_then(|id| channels.get(id));
    match (id.and_then(|id| channels.wanted(id)), channel) {
        (Some(false), _) => None,
        (_, Some(channel)) => {
            let message = message(body, channel);
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

/// A record that is skipped could be a chunk whose opcode was damaged: one that has the shape of a chunk is suspect, as
/// are wrong lengths, and numbers that the format has not given away yet. `head` is how its body starts.
fn implausible(record: &Record, head: &[u8]) -> Option<&'static str> {
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

/// A message would have to have a sequence number that fits its length.
fn has_message_index_shape(body: &[u8]) -> bool {
    let mut fields = Fields::new(body);
    let mut entries = || {
        fields.u16()?;
        fields.u32()
    };
    entries().is_some_and(|bytes| bytes % 16 == 0 && bytes as usize + fields.taken() == body.len())
}

fn has_chunk_shape(record: &Record, head: &[u8]) -> bool {
    let mut fields = Fields::new(head);
    let mut packed = || {
        fields.bytes(CHUNK_COMPRESSION_AT)?;
        fields.string()?;
        fields.u64()
    };
    packed().is_some_and(|packed| packed > 0 && packed.checked_add(fields.taken() as u64) == Some(record.length))
}
