//! Reading from front to back: needs no index, survives a torn tail, damaged chunks, and what stands between them and makes no
//! sense.

use std::io::{Read, Seek};

use mcap::records::op;

use super::channels::{Channels, Definition};
use super::chunk::{Chunk, MAX_CHUNK_BYTES, MESSAGE_HEAD_BYTES, Placed, message};
use super::error::{Damage, MAGIC, ReadError};
use super::fields::Fields;
use super::resync::{CHUNK_HEAD_BYTES, has_chunk_shape, next_chunk};
use super::source::{Record, Source};
use super::unpacking::Unpacking;
use crate::cdr::MAX_MESSAGE_BYTES;

/// A schema or channel that is larger is refused.
const MAX_DEFINITION_BYTES: u64 = 4 << 20;

/// Times that a reader goes back to a chunk which a wrong length has led it past. Each may cost as much as reading the file
/// once, and needs a length that is wrong and fits into the file; going on behind what makes no sense costs no more than that.
const MAX_RESYNCS: u32 = 64;

const FOOTER_BODY_BYTES: u64 = 20;
const SUMMARY_OFFSET_BODY_BYTES: u64 = 17;
const DATA_END_BODY_BYTES: u64 = 4;

pub(super) struct FileOrder {
    position: u64,
    chunk: Option<Chunk>,
    /// Whether the file has chunks, and with them message indexes.
    chunked: bool,
    trusted: Trusted,
    /// Where the last chunk begins that made no sense.
    bad_chunk: Option<u64>,
    is_past_head: bool,
    went_back: u32,
    unpacking: Unpacking,
}

/// Nothing before it is read again.
#[derive(Clone, Copy)]
struct Trusted {
    /// Of the last sound chunk, or of the last message outside of one.
    end: u64,
    /// Bytes before it that were not used.
    skipped: u64,
}

impl FileOrder {
    pub fn new() -> Self {
        let start = MAGIC.len() as u64;
        let trusted = Trusted { end: start, skipped: 0 };
        Self {
            position: start,
            chunk: None,
            chunked: false,
            trusted,
            bad_chunk: None,
            is_past_head: false,
            went_back: 0,
            unpacking: Unpacking::default(),
        }
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
                    damage.note(|| format!("record at byte {}: {error}", self.position));
                    match self.resync(source, damage)? {
                        Some(record) => record,
                        None => return Ok(None),
                    }
                }
            };
            let first = !std::mem::replace(&mut self.is_past_head, true);
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
                self.trusted = Trusted { end: record.end(), skipped: damage.bytes_skipped };
                return Ok(Some(message));
            }
        }
    }

    /// From a place that makes no sense to the next chunk, be it before that place: a wrong length may have led past it.
    fn resync<R: Read + Seek>(
        &mut self,
        source: &mut Source<R>,
        damage: &mut Damage,
    ) -> Result<Option<Record>, ReadError> {
        self.is_past_head = true;
        let Trusted { end, skipped } = self.trusted;
        let from = self.bad_chunk.map_or(end, |bad| end.max(bad + 1));
        let found = next_chunk(source, from)?;
        let goes_back = found.is_some_and(|record| record.offset < self.position);
        let found = found.filter(|_| !goes_back || self.went_back < MAX_RESYNCS);
        self.went_back += u32::from(goes_back);
        let next = found.map_or(source.length(), |record| record.offset);
        match next.checked_sub(self.position) {
            Some(passed) => damage.bytes_skipped += passed,
            None => damage.bytes_skipped = skipped + (next - end),
        }
        self.position = next;
        Ok(found)
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
            let is_chunk = record.opcode == op::CHUNK;
            self.bad_chunk = if is_chunk { Some(record.offset) } else { self.bad_chunk };
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
                self.chunked = true;
                self.chunk = Chunk::unpack(body, record.offset, &mut self.unpacking, channels, damage);
                if self.chunk.is_some() {
                    self.trusted = Trusted { end: record.end(), skipped: damage.bytes_skipped };
                } else {
                    self.bad_chunk = Some(record.offset);
                }
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
