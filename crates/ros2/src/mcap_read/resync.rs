//! Finds the next chunk behind a damaged part of a log, by its shape, and judges files that give no message.

use std::io::{self, Read, Seek};

use mcap::records::op;

use super::error::{MAGIC, ReadError};
use super::fields::Fields;
use super::source::{RECORD_HEAD_BYTES, Record, Source};

/// Offset of the name of the compression in a chunk, bytes: start, end, size and checksum stand before it.
const CHUNK_COMPRESSION_AT: usize = 28;

/// Length of the start of a body that shows whether it is a chunk, bytes: enough for a compression with a name of usual length.
pub(super) const CHUNK_HEAD_BYTES: u64 = 96;

/// Size of the blocks in which a file is searched, bytes.
const BLOCK_BYTES: u64 = 1 << 20;

/// Largest header of a log, bytes: it only names a profile and a library.
const MAX_LOG_HEAD_BYTES: u64 = 4096;

/// Finds the first whole record at or behind `from` that has the opcode and the shape of a chunk.
pub(super) fn next_chunk<R: Read + Seek>(source: &mut Source<R>, from: u64) -> io::Result<Option<Record>> {
    const HEAD_BYTES: usize = (RECORD_HEAD_BYTES + CHUNK_HEAD_BYTES) as usize;
    let (mut block, mut start) = (Vec::new(), from);
    while start < source.length() {
        // A head that begins in this block may end behind it.
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

/// Whether the sizes in a record agree as those of a chunk do, 64 bits that hardly agree by chance.
///
/// `head` is the start of the record's body.
pub(super) fn has_chunk_shape(record: &Record, head: &[u8]) -> bool {
    let mut fields = Fields::new(head);
    let mut packed = || {
        fields.bytes(CHUNK_COMPRESSION_AT)?;
        fields.string()?;
        fields.u64()
    };
    packed().is_some_and(|packed| packed > 0 && packed.checked_add(fields.taken() as u64) == Some(record.length))
}

/// The content of a file that gives no message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileTail {
    /// The file is empty, all zeros, or the beginning of a log with nothing but zeros behind it.
    Nothing,
    /// The file is the beginning of a log and an unfinished record.
    Torn {
        /// Bytes of the unfinished record.
        bytes: u64,
    },
    /// The file is no log, or a log that holds more.
    Other,
}

/// Judges a file out of which no reader gets a message, and whose first `sound` bytes are sound.
pub fn file_tail<R: Read + Seek>(mut reader: R, sound: u64) -> Result<FileTail, ReadError> {
    reader.rewind()?;
    if is_zero(&mut reader)? {
        return Ok(FileTail::Nothing);
    }
    let mut source = match Source::open(reader) {
        Err(ReadError::NotMcap { .. }) => return Ok(FileTail::Other),
        source => source?,
    };
    let mut position = MAGIC.len() as u64;
    match source.record_at(position)? {
        Ok(record) if record.opcode == op::HEADER => position = record.end().max(sound),
        Ok(_) => return Ok(FileTail::Other),
        Err(_) => return judge_torn_head(&mut source, position),
    }
    if next_chunk(&mut source, position)?.is_some() {
        return Ok(FileTail::Other);
    }
    while position < source.length() {
        match source.record_at(position)? {
            Ok(Record { opcode: op::DATA_END | op::FOOTER, .. }) => return Ok(FileTail::Nothing),
            Ok(record) if matches!(record.opcode, op::ATTACHMENT | op::METADATA | op::MESSAGE_INDEX) => {
                position = record.end();
            }
            Ok(_) => return Ok(FileTail::Other),
            Err(_) => break,
        }
    }
    match is_zero_from(&mut source, position)? {
        true => Ok(FileTail::Nothing),
        false => Ok(FileTail::Torn { bytes: source.length() - position }),
    }
}

/// Judges a file that ends within the header of the log, which begins at `position`.
fn judge_torn_head<R: Read + Seek>(source: &mut Source<R>, position: u64) -> Result<FileTail, ReadError> {
    let mut head = Vec::new();
    source.read_at(position, RECORD_HEAD_BYTES.min(source.length().saturating_sub(position)), &mut head)?;
    let mut fields = Fields::new(&head);
    let is_begun = match (fields.u8(), fields.u64()) {
        (None, _) => true,
        (Some(opcode), length) => opcode == op::HEADER && length.is_none_or(|length| length <= MAX_LOG_HEAD_BYTES),
    };
    let is_nothing = is_begun || is_zero_from(source, position)?;
    Ok(if is_nothing { FileTail::Nothing } else { FileTail::Other })
}

/// Whether the file holds only zeros from `position` on.
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

/// Whether the rest of a reader holds only zeros, or nothing.
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
