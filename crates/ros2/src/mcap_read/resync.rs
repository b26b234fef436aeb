//! Finding the way back into a log behind what makes no sense: to the next chunk, by its shape.

use std::io::{self, Read, Seek};

use mcap::records::op;

use super::error::{MAGIC, ReadError};
use super::fields::Fields;
use super::source::{RECORD_HEAD_BYTES, Record, Source};

/// Start, end, size and checksum of a chunk stand before the name of its compression.
const CHUNK_COMPRESSION_AT: usize = 28;

/// Enough for the head of a chunk whose compression has a name of usual length.
pub(super) const CHUNK_HEAD_BYTES: u64 = 96;

/// Looked through at once.
const BLOCK_BYTES: u64 = 1 << 20;

/// The header of a log names a profile and a library; a larger one is none.
const MAX_LOG_HEAD_BYTES: u64 = 4096;

/// The first whole record at or behind this byte that has the opcode and the shape of a chunk.
pub(super) fn next_chunk<R: Read + Seek>(source: &mut Source<R>, from: u64) -> io::Result<Option<Record>> {
    const HEAD_BYTES: usize = (RECORD_HEAD_BYTES + CHUNK_HEAD_BYTES) as usize;
    let (mut block, mut start) = (Vec::new(), from);
    while start < source.length() {
        // Heads that begin in this block end behind it.
        let bytes = (BLOCK_BYTES + HEAD_BYTES as u64).min(source.length() - start);
        if !source.read_at(start, bytes, &mut block)? {
            return Ok(None);
        }
        let own = block.len().min(BLOCK_BYTES as usize);
        for (at, _) in block[..own].iter().enumerate().filter(|(_, byte)| **byte == op::CHUNK) {
            let offset = start + at as u64;
            let mut head = Fields::new(&block[at + 1..block.len().min(at + HEAD_BYTES)]);
            let Some(length) = head.u64() else { continue };
            if length > source.length().saturating_sub(offset + RECORD_HEAD_BYTES) {
                continue;
            }
            let record = Record { opcode: op::CHUNK, offset, length };
            if has_chunk_shape(&record, head.rest()) {
                return Ok(Some(record));
            }
        }
        start += own as u64;
    }
    Ok(None)
}

/// Whether its sizes agree with each other: 64 bits that are right by chance nowhere. `head` is how its body starts.
pub(super) fn has_chunk_shape(record: &Record, head: &[u8]) -> bool {
    let mut fields = Fields::new(head);
    let mut packed = || {
        fields.bytes(CHUNK_COMPRESSION_AT)?;
        fields.string()?;
        fields.u64()
    };
    packed().is_some_and(|packed| packed > 0 && packed.checked_add(fields.taken() as u64) == Some(record.length))
}

/// What a file is that gives no message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Remains {
    /// Empty, zeros, or the beginning of a log, and nothing behind it but zeros.
    Nothing,
    /// The beginning of a log, and behind it so many bytes of what was begun.
    Torn { bytes: u64 },
    /// No log, or one with more in it than that.
    Other,
}

/// Looks at a file out of which no reader gets a message, and of which the first `sound` bytes are sound.
pub fn remains<R: Read + Seek>(mut reader: R, sound: u64) -> Result<Remains, ReadError> {
    reader.rewind()?;
    if is_zero(&mut reader)? {
        return Ok(Remains::Nothing);
    }
    let mut source = match Source::open(reader) {
        Err(ReadError::NotMcap { .. }) => return Ok(Remains::Other),
        source => source?,
    };
    let mut position = MAGIC.len() as u64;
    match source.record_at(position)? {
        Ok(record) if record.opcode == op::HEADER => position = record.end().max(sound),
        Ok(_) => return Ok(Remains::Other),
        Err(_) => return torn_head(&mut source, position),
    }
    if next_chunk(&mut source, position)?.is_some() {
        return Ok(Remains::Other);
    }
    while position < source.length() {
        match source.record_at(position)? {
            Ok(Record { opcode: op::DATA_END | op::FOOTER, .. }) => return Ok(Remains::Nothing),
            Ok(record) if matches!(record.opcode, op::ATTACHMENT | op::METADATA | op::MESSAGE_INDEX) => {
                position = record.end();
            }
            Ok(_) => return Ok(Remains::Other),
            Err(_) => break,
        }
    }
    match is_zero_from(&mut source, position)? {
        true => Ok(Remains::Nothing),
        false => Ok(Remains::Torn { bytes: source.length() - position }),
    }
}

fn torn_head<R: Read + Seek>(source: &mut Source<R>, position: u64) -> Result<Remains, ReadError> {
    let mut head = Vec::new();
    source.read_at(position, RECORD_HEAD_BYTES.min(source.length().saturating_sub(position)), &mut head)?;
    let mut fields = Fields::new(&head);
    let is_begun = match (fields.u8(), fields.u64()) {
        (None, _) => true,
        (Some(opcode), length) => opcode == op::HEADER && length.is_none_or(|length| length <= MAX_LOG_HEAD_BYTES),
    };
    let is_nothing = is_begun || is_zero_from(source, position)?;
    Ok(if is_nothing { Remains::Nothing } else { Remains::Other })
}

fn is_zero_from<R: Read + Seek>(source: &mut Source<R>, mut position: u64) -> io::Result<bool> {
    let mut block = Vec::new();
    while position < source.length() {
        let bytes = BLOCK_BYTES.min(source.length() - position);
        if !source.read_at(position, bytes, &mut block)? || block.iter().any(|byte| *byte != 0) {
            return Ok(false);
        }
        position += bytes;
    }
    Ok(true)
}

fn is_zero(reader: &mut impl Read) -> io::Result<bool> {
    let mut block = vec![0; BLOCK_BYTES as usize];
    loop {
        match reader.read(&mut block)? {
            0 => return Ok(true),
            read if block[..read].iter().any(|byte| *byte != 0) => return Ok(false),
            _ => {}
        }
    }
}
