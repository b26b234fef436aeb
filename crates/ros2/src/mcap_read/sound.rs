//! Reads the sound beginning of a torn log, record by record, so that the log can be finished.

use std::io::{Read, Seek};
use std::sync::Arc;

use mcap::records::{Record as Parsed, op};

use super::attachments::{Attachment, MAX_ATTACHMENT_BYTES, MetadataRecord, parse_attachment};
use super::channels::{Channel, Channels, Definition, Selection};
use super::chunk::{MAX_CHUNK_BYTES, parse_header, parse_message};
use super::error::{MAGIC, ReadError};
use super::fields::Fields;
use super::lengths::parse_record;
use super::source::{Record, Source};
use super::{LogMessage, MAX_METADATA_BYTES};

/// A sound record of a log.
pub enum Piece {
    /// An attachment whose checksum is right.
    Attachment(Attachment),
    /// A metadata record.
    Metadata(MetadataRecord),
    /// The parts of an uncompressed chunk whose checksum is right.
    Chunk(Vec<Part>),
}

/// A part of a chunk.
pub enum Part {
    /// The definition of a channel.
    Channel(Arc<Channel>),
    /// A message.
    Message(LogMessage),
}

/// How much of a log, from its beginning, is sound.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Sound {
    /// File offset of the end of the last sound piece, bytes.
    pub end: u64,
    /// Description of the damage behind it; `None` if the data section ends as it should.
    pub damage: Option<String>,
}

/// Passes every piece of a log to `take`, in the order of the file, up to the first record that is damaged.
///
/// # Errors
///
/// Fails if the file cannot be read, or as `take` does.
pub fn sound_pieces<R, E>(reader: R, take: &mut dyn FnMut(Piece) -> Result<(), E>) -> Result<Sound, E>
where
    R: Read + Seek,
    E: From<ReadError>,
{
    let mut source = match Source::open(reader) {
        Err(ReadError::NotMcap { found }) => return Ok(Sound { end: 0, damage: Some(format!("found {found}")) }),
        source => source?,
    };
    let mut channels = Channels::new(Selection::All);
    let mut sound = Sound::default();
    let mut position = MAGIC.len() as u64;
    while position < source.length() {
        let record = match source.record_at(position).map_err(ReadError::from)? {
            Ok(record) => record,
            Err(error) => return Ok(Sound { damage: Some(error), ..sound }),
        };
        let is_first = position == MAGIC.len() as u64;
        position = record.end();
        match record.opcode {
            op::HEADER if is_first => {}
            _ if is_first => return Ok(Sound { damage: Some("expected the header of the file".to_owned()), ..sound }),
            op::MESSAGE_INDEX => {}
            op::DATA_END | op::FOOTER => return Ok(sound),
            _ => match read_piece(&record, &mut source, &mut channels)? {
                Ok(piece) => {
                    take(piece)?;
                    sound.end = position;
                }
                Err(error) => return Ok(Sound { damage: Some(error), ..sound }),
            },
        }
    }
    Ok(Sound { damage: Some("it was never finished".to_owned()), ..sound })
}

/// Reads the piece of a record, or says what is wrong with it.
fn read_piece<R: Read + Seek>(
    record: &Record,
    source: &mut Source<R>,
    channels: &mut Channels,
) -> Result<Result<Piece, String>, ReadError> {
    let limit = match record.opcode {
        op::CHUNK => MAX_CHUNK_BYTES,
        op::ATTACHMENT => MAX_ATTACHMENT_BYTES,
        op::METADATA => MAX_METADATA_BYTES,
        opcode => return Ok(Err(format!("record at byte {}: opcode {opcode:#04x}", record.offset))),
    };
    if record.length > limit {
        return Ok(Err(format!("record at byte {}: {} bytes", record.offset, record.length)));
    }
    let mut body = Vec::new();
    if !source.read_at(record.body(), record.length, &mut body)? {
        return Ok(Err("found the end of the file".to_owned()));
    }
    let read = match record.opcode {
        op::CHUNK => parse_chunk(&body, channels).map(Piece::Chunk),
        op::ATTACHMENT => parse_attachment(&body).map(Piece::Attachment),
        _ => match parse_record(op::METADATA, &body) {
            Ok(Parsed::Metadata(found)) => {
                Ok(Piece::Metadata(MetadataRecord { name: found.name, values: found.metadata }))
            }
            Ok(_) => Err("expected metadata".to_owned()),
            Err(error) => Err(error.to_string()),
        },
    };
    Ok(read.map_err(|error| format!("record at byte {}: {error}", record.offset)))
}

/// Verifies an uncompressed chunk and parses its parts.
fn parse_chunk(body: &[u8], channels: &mut Channels) -> Result<Vec<Part>, String> {
    let header = parse_header(body)?;
    if !header.compression.is_empty() {
        return Err("it is compressed".to_owned());
    }
    let records = header.checked_records()?;
    let mut fields = Fields::new(records);
    let mut parts = Vec::new();
    while fields.taken() < records.len() {
        let mut next = || {
            let (opcode, length) = (fields.u8()?, fields.length()?);
            Some((opcode, fields.bytes(length)?))
        };
        let (opcode, body) = next().ok_or("one of its records is cut")?;
        if opcode == op::MESSAGE {
            let id = Fields::new(body).u16().ok_or("one of its messages is too short")?;
            let channel = channels.get(id).ok_or("one of its messages is of an unknown topic")?;
            parts.push(Part::Message(parse_message(body, channel).ok_or("one of its messages is too short")?));
        } else if let Some(definition) = Definition::parse(opcode, body)? {
            let id = definition.channel_id();
            channels.define(definition)?;
            parts.extend(id.and_then(|id| channels.get(id)).map(|channel| Part::Channel(Arc::clone(channel))));
        }
    }
    Ok(parts)
}
