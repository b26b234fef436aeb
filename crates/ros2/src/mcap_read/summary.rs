//! The summary section at the end of a finished file, which lists its records.

use std::io::{Read, Seek};

use mcap::records::{AttachmentIndex, ChunkIndex, MetadataIndex, Record as Parsed, Statistics, op};

use super::channels::{Channels, Definition};
use super::error::{Damage, MAGIC, ReadError};
use super::fields::Fields;
use super::lengths::parse_record;
use super::source::{RECORD_HEAD_BYTES, Record, Source};

/// Largest summary that is used, bytes; that of an hour of chunks takes about a megabyte.
const MAX_SUMMARY_BYTES: u64 = 256 << 20;

/// Length of the footer record and the final magic, bytes.
const TAIL_BYTES: u64 = RECORD_HEAD_BYTES + 20 + MAGIC.len() as u64;

/// The indexes and statistics of a summary.
#[derive(Default)]
pub(super) struct Summary {
    /// Where the chunks are.
    pub chunks: Vec<ChunkIndex>,
    /// Where the attachments are.
    pub attachments: Vec<AttachmentIndex>,
    /// Where the metadata records are.
    pub metadata: Vec<MetadataIndex>,
    /// Counts of records and messages.
    pub statistics: Option<Statistics>,
}

impl Summary {
    /// Reads the summary and enters its definitions into `channels`; `None` if there is none or it is not sound.
    pub fn read<R: Read + Seek>(
        source: &mut Source<R>,
        channels: &mut Channels,
        damage: &mut Damage,
    ) -> Result<Option<Self>, ReadError> {
        let mut tail = Vec::new();
        let Some(tail_start) = source.length().checked_sub(TAIL_BYTES) else { return Ok(None) };
        if !source.read_at(tail_start, TAIL_BYTES, &mut tail)? || tail[0] != op::FOOTER || !tail.ends_with(MAGIC) {
            return Ok(None);
        }
        let mut footer = Fields::new(&tail[RECORD_HEAD_BYTES as usize..]);
        let parsed = (footer.u64(), footer.u64(), footer.u32());
        let (Some(start), Some(_), Some(crc)) = parsed else { return Ok(None) };
        if start == 0 {
            return Ok(None);
        }
        let bytes = tail_start.checked_sub(start).filter(|&bytes| bytes <= MAX_SUMMARY_BYTES);
        let mut section = Vec::new();
        if bytes.is_none() || !source.read_at(start, bytes.unwrap_or(0), &mut section)? {
            damage.bad_record(tail_start, 0, "the footer points to no summary");
            return Ok(None);
        }
        let mut hasher = crc32fast::Hasher::new();
        hasher.update(&section);
        hasher.update(&tail[..RECORD_HEAD_BYTES as usize + 16]);
        let calculated = hasher.finalize();
        if crc != 0 && crc != calculated {
            let error = format!("summary: expected the checksum {crc:08x}, found {calculated:08x}");
            damage.bad_record(start, section.len() as u64, &error);
            return Ok(None);
        }
        match Self::parse(&section, channels) {
            Ok(summary) => Ok(Some(summary)),
            Err(error) => {
                damage.bad_record(start, section.len() as u64, &format!("summary: {error}"));
                Ok(None)
            }
        }
    }

    /// Parses the records of the summary section.
    fn parse(section: &[u8], channels: &mut Channels) -> Result<Self, String> {
        let mut summary = Self::default();
        let mut fields = Fields::new(section);
        while fields.taken() < section.len() {
            let mut next = || {
                let (opcode, length) = (fields.u8()?, fields.length()?);
                Some((opcode, fields.bytes(length)?))
            };
            let (opcode, body) = next().ok_or("a record is cut")?;
            match opcode {
                op::SCHEMA | op::CHANNEL => {
                    if let Some(definition) = Definition::parse(opcode, body)? {
                        channels.define(definition)?;
                    }
                }
                op::CHUNK_INDEX | op::ATTACHMENT_INDEX | op::METADATA_INDEX | op::STATISTICS => {
                    match parse_record(opcode, body)? {
                        Parsed::ChunkIndex(index) => summary.chunks.push(index),
                        Parsed::AttachmentIndex(index) => summary.attachments.push(index),
                        Parsed::MetadataIndex(index) => summary.metadata.push(index),
                        Parsed::Statistics(statistics) => summary.statistics = Some(statistics),
                        _ => {}
                    }
                }
                _ => {}
            }
        }
        Ok(summary)
    }

    /// Returns the records of attachments and metadata, or `None` if the summary does not lead to all of them.
    pub fn side_records<R: Read + Seek>(&self, source: &mut Source<R>) -> Result<Option<Vec<Record>>, ReadError> {
        let listed = (self.attachments.len() as u64, self.metadata.len() as u64);
        let counted = self.statistics.as_ref().map(|s| (u64::from(s.attachment_count), u64::from(s.metadata_count)));
        if counted != Some(listed) {
            return Ok(None);
        }
        let places = self.side_places();
        let mut records = Vec::with_capacity(places.len());
        for (offset, opcode) in places {
            match source.record_at(offset)? {
                Ok(record) if record.opcode == opcode => records.push(record),
                _ => return Ok(None),
            }
        }
        Ok(Some(records))
    }

    /// Counts attachments and metadata that are not where the summary lists them.
    pub fn check_side_places<R: Read + Seek>(
        &self,
        source: &mut Source<R>,
        damage: &mut Damage,
    ) -> Result<(), ReadError> {
        for (offset, opcode) in self.side_places() {
            match source.record_at(offset)? {
                Ok(record) if record.opcode == opcode => {}
                Ok(record) => {
                    let error = format!("expected opcode {opcode:#04x}, found {:#04x}", record.opcode);
                    damage.bad_record(offset, record.bytes(), &error);
                }
                Err(error) => damage.bad_record(offset, 0, &error),
            }
        }
        Ok(())
    }

    /// Returns offset and opcode of each attachment and metadata record that the summary lists, in the order of the file.
    fn side_places(&self) -> Vec<(u64, u8)> {
        let attachments = self.attachments.iter().map(|a| (a.offset, op::ATTACHMENT));
        let mut places: Vec<_> = attachments.chain(self.metadata.iter().map(|m| (m.offset, op::METADATA))).collect();
        places.sort_unstable();
        places
    }

    /// Whether the index leads to every message.
    ///
    /// It does not if the writer left parts of it out, put messages outside of chunks, or defined channels only in the chunk
    /// that is first in the file: that chunk need not be first in time.
    pub fn leads_to_all_messages<R: Read + Seek>(
        &self,
        channels: &Channels,
        source: &mut Source<R>,
    ) -> Result<bool, ReadError> {
        let counted = self.statistics.iter().flat_map(|statistics| statistics.channel_message_counts.keys());
        let mut used = counted.chain(self.chunks.iter().flat_map(|chunk| chunk.message_index_offsets.keys()));
        if used.any(|&id| channels.get(id).is_none()) {
            return Ok(false);
        }
        match &self.statistics {
            Some(statistics) if u64::from(statistics.chunk_count) != self.chunks.len() as u64 => return Ok(false),
            Some(statistics) if statistics.message_count > 0 && self.chunks.is_empty() => return Ok(false),
            _ => {}
        }
        let chunks =
            self.chunks.iter().map(|c| (c.chunk_start_offset, c.chunk_length.saturating_add(c.message_index_length)));
        let attachments = self.attachments.iter().map(|a| (a.offset, a.length));
        let mut extents: Vec<(u64, u64)> =
            chunks.chain(attachments).chain(self.metadata.iter().map(|m| (m.offset, m.length))).collect();
        extents.push((source.length() - TAIL_BYTES, 0));
        extents.sort_unstable();
        let mut position = MAGIC.len() as u64;
        for (start, length) in extents {
            if start < position {
                return Ok(false);
            }
            while position < start {
                match source.record_at(position)? {
                    Ok(record) if matches!(record.opcode, op::CHUNK | op::MESSAGE) => return Ok(false),
                    // Only the definitions and indexes of the summary follow the end of the data.
                    Ok(record) if record.opcode == op::DATA_END => return Ok(true),
                    Ok(record) => position = record.end(),
                    // A damaged record lies between sound ones, so the walk goes on where the index says.
                    Err(_) => position = start,
                }
            }
            position = start.saturating_add(length);
        }
        Ok(true)
    }
}
