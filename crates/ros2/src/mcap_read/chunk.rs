//! A chunk of a log: decompressed, verified, its messages listed. No message is delivered before the whole chunk is sound.

use std::sync::Arc;

use mcap::records::op;
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};

use super::LogMessage;
use super::channels::{Channel, Channels, Definition};
use super::error::Damage;
use super::fields::Fields;
use super::source::RECORD_HEAD_BYTES;
use super::unpacking::Unpacking;

/// Largest chunk, compressed or not, bytes. Writers close theirs at about a megabyte, or behind one large message.
pub(super) const MAX_CHUNK_BYTES: u64 = 256 << 20;

/// A sound chunk whose selected messages are delivered one after the other.
pub(super) struct Chunk {
    /// Bytes that contain the bodies of the message records.
    bytes: Vec<u8>,
    /// Selected messages.
    entries: Vec<Entry>,
    /// Index of the next entry.
    next: usize,
    /// File offset of `bytes`; `None` if the chunk is compressed.
    place: Option<u64>,
}

/// A message and the file offset of its data; `None` if it is compressed.
pub(super) type PlacedMessage = (LogMessage, Option<u64>);

/// Length of the head of a message record, bytes: channel, sequence number and two times.
pub(super) const MESSAGE_HEAD_BYTES: u64 = 22;

/// The log time, channel and position in [`Chunk::bytes`] of a message record.
#[derive(Clone, Copy)]
struct Entry {
    log_time: u64,
    start: u32,
    length: u32,
    channel: u16,
}

/// The fields of a chunk record.
pub(super) struct Header<'a> {
    /// Size of the records when decompressed.
    unpacked_bytes: u64,
    /// Checksum of the decompressed records; 0 if the writer made none.
    crc: u32,
    /// Name of the compression; empty if there is none.
    pub compression: &'a str,
    /// The records, compressed or not.
    records: &'a [u8],
    /// Offset of `records` in the body of the chunk.
    records_start: usize,
    /// Number of bytes behind the records, which no field accounts for.
    surplus: usize,
}

impl Chunk {
    /// Decompresses and verifies the chunk record at `offset` of the file. Returns `None` if it is damaged.
    pub fn unpack(
        body: Vec<u8>,
        offset: u64,
        unpacking: &mut Unpacking,
        channels: &mut Channels,
        damage: &mut Damage,
    ) -> Option<Self> {
        let bytes = RECORD_HEAD_BYTES + body.len() as u64;
        let unpacked = parse_header(&body).and_then(|header| {
            let surplus = header.surplus;
            if header.compression.is_empty() {
                return Ok((list_uncompressed(&header)?, surplus));
            }
            unpacking.admit(header.records.len() as u64, header.unpacked_bytes)?;
            Ok((decompress(&header, &body)?, surplus))
        });
        let (listing, surplus) = match unpacked {
            Ok(unpacked) => unpacked,
            Err(error) => {
                damage.bad_chunk(offset, bytes, &error);
                return None;
            }
        };
        if surplus > 0 {
            damage.bad_record(offset, surplus as u64, &format!("{surplus} bytes behind the messages of a chunk"));
        }
        for definition in listing.definitions {
            if let Err(error) = channels.define(definition) {
                damage.bad_record(offset, 0, &error);
            }
        }
        let mut entries = listing.entries;
        entries.retain(|entry| match channels.wanted(entry.channel) {
            Some(wanted) => wanted,
            None => {
                damage.orphan_messages += 1;
                damage.bytes_skipped += u64::from(entry.length);
                damage.note(|| format!("chunk at byte {offset}: channel {} was never defined", entry.channel));
                false
            }
        });
        let place = listing.unpacked.is_none().then_some(offset + RECORD_HEAD_BYTES);
        Some(Self { bytes: listing.unpacked.unwrap_or(body), entries, next: 0, place })
    }

    /// Sorts the messages by log time; messages of the same time keep their order.
    pub fn sort(&mut self) {
        self.entries.sort_by_key(|entry| entry.log_time);
    }

    /// Returns the log time of the next message.
    pub fn log_time(&self) -> Option<u64> {
        self.entries.get(self.next).map(|entry| entry.log_time)
    }

    /// Returns how much memory the chunk takes, bytes.
    pub fn memory(&self) -> usize {
        self.bytes.len() + self.entries.len() * size_of::<Entry>()
    }

    /// Delivers the next message.
    pub fn next(&mut self, channels: &Channels) -> Option<PlacedMessage> {
        let entry = *self.entries.get(self.next)?;
        self.next += 1;
        let start = entry.start as usize;
        let message =
            parse_message(self.bytes.get(start..start + entry.length as usize)?, channels.get(entry.channel)?)?;
        Some((message, self.place.map(|place| place + u64::from(entry.start) + MESSAGE_HEAD_BYTES)))
    }
}

/// Parses the body of a message record.
pub(super) fn parse_message(body: &[u8], channel: &Arc<Channel>) -> Option<LogMessage> {
    let mut fields = Fields::new(body);
    fields.u16()?;
    Some(LogMessage {
        channel: Arc::clone(channel),
        sequence: fields.u32()?,
        log_time_ns: nanoseconds(fields.u64()?),
        publish_time_ns: nanoseconds(fields.u64()?),
        data: fields.rest().to_vec(),
    })
}

/// Converts a time of MCAP. A time after the year 2262 becomes the last one that `i64` can hold.
pub(super) fn nanoseconds(time: u64) -> i64 {
    i64::try_from(time).unwrap_or(i64::MAX)
}

impl<'a> Header<'a> {
    /// Returns the records of an uncompressed chunk after verifying their checksum.
    pub fn checked_records(&self) -> Result<&'a [u8], String> {
        let found = self.records.len() as u64;
        if found != self.unpacked_bytes {
            return Err(format!("expected {} bytes of records, found {found}", self.unpacked_bytes));
        }
        let calculated = crc32fast::hash(self.records);
        if self.crc != 0 && self.crc != calculated {
            return Err(format!("expected the checksum {:08x}, found {calculated:08x}", self.crc));
        }
        Ok(self.records)
    }
}

/// Parses the body of a chunk record.
pub(super) fn parse_header(body: &[u8]) -> Result<Header<'_>, String> {
    let mut fields = Fields::new(body);
    let mut parse = || {
        fields.u64()?;
        fields.u64()?;
        Some((fields.u64()?, fields.u32()?, fields.string()?, fields.length()?))
    };
    let (unpacked_bytes, crc, compression, packed) = parse().ok_or("its header makes no sense")?;
    if unpacked_bytes > MAX_CHUNK_BYTES {
        return Err(format!("expected at most {MAX_CHUNK_BYTES} bytes, found {unpacked_bytes}"));
    }
    let records_start = fields.taken();
    let left = body.len() - records_start;
    let Some(records) = fields.bytes(packed) else { return Err(format!("expected {packed} bytes, found {left}")) };
    Ok(Header { unpacked_bytes, crc, compression, records, records_start, surplus: left - packed })
}

/// The content of a chunk.
#[derive(Default)]
struct Listing {
    definitions: Vec<Definition>,
    entries: Vec<Entry>,
    /// Bodies of the message records of a compressed chunk; `None` if the chunk is not compressed.
    unpacked: Option<Vec<u8>>,
}

impl Listing {
    /// Adds a record whose body begins at `start` of [`Chunk::bytes`].
    fn add(&mut self, opcode: u8, body: &[u8], start: usize) -> Result<(), String> {
        if opcode != op::MESSAGE {
            self.definitions.extend(Definition::parse(opcode, body)?);
            return Ok(());
        }
        let mut fields = Fields::new(body);
        let mut parse = || {
            let channel = fields.u16()?;
            fields.u32()?;
            let log_time = fields.u64()?;
            fields.u64()?;
            // Both conversions succeed, because chunks are smaller than 4 GiB.
            Some(Entry { log_time, start: start.try_into().ok()?, length: body.len().try_into().ok()?, channel })
        };
        self.entries.push(parse().ok_or("one of its messages is too short")?);
        Ok(())
    }
}

/// Lists the records of an uncompressed chunk.
fn list_uncompressed(header: &Header<'_>) -> Result<Listing, String> {
    let records = header.checked_records()?;
    let mut listing = Listing::default();
    let mut fields = Fields::new(records);
    while fields.taken() < records.len() {
        let mut next = || Some((fields.u8()?, fields.length()?));
        let (opcode, length) = next().ok_or("its last record is cut")?;
        let start = header.records_start + fields.taken();
        let body = fields.bytes(length).ok_or("one of its records is cut")?;
        listing.add(opcode, body, start)?;
    }
    Ok(listing)
}

/// Decompresses a chunk, verifies its checksum and lists its records.
fn decompress(header: &Header<'_>, body: &[u8]) -> Result<Listing, String> {
    let limit = body.len().max(header.unpacked_bytes as usize);
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_skip_end_magic(true)
        .with_prevalidate_chunk_crcs(true)
        .with_record_length_limit(limit);
    let mut reader = LinearReader::new_with_options(options);
    let mut head = [op::CHUNK; RECORD_HEAD_BYTES as usize];
    head[1..].copy_from_slice(&(body.len() as u64).to_le_bytes());
    let mut pending: [&[u8]; 2] = [&head, body];
    let mut listing = Listing::default();
    let mut unpacked = Vec::with_capacity(header.unpacked_bytes.min(4 * body.len() as u64) as usize);
    while let Some(event) = reader.next_event() {
        match event.map_err(|error| error.to_string())? {
            LinearReadEvent::ReadRequest(wanted) => {
                let from = usize::from(pending[0].is_empty());
                let (given, rest) = pending[from].split_at(wanted.min(pending[from].len()));
                reader.insert(given.len()).copy_from_slice(given);
                reader.notify_read(given.len());
                pending[from] = rest;
            }
            LinearReadEvent::Record { data, opcode } => {
                listing.add(opcode, data, unpacked.len())?;
                if opcode == op::MESSAGE {
                    unpacked.extend_from_slice(data);
                }
            }
        }
    }
    listing.unpacked = Some(unpacked);
    Ok(listing)
}
