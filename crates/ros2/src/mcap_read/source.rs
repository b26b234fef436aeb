//! Reads a file as a sequence of records, each with an opcode and a length.

use std::io::{self, BufReader, Read, Seek, SeekFrom};

use super::error::{MAGIC, ReadError, check_magic};

/// Size of the read-ahead buffer, bytes. Small records come out of it, large ones are read directly. A walk over the heads of
/// large records reads this much at each.
const BUFFER_BYTES: usize = 16 << 10;

/// Length of the head of a record, bytes: opcode and length.
pub(super) const RECORD_HEAD_BYTES: u64 = 9;

/// Number of first bytes by which other file formats are recognized.
const RECOGNISED_BYTES: u64 = 32;

/// A file of records.
pub(super) struct Source<R> {
    reader: BufReader<R>,
    /// File offset of the reader.
    position: u64,
    /// Length of the file, bytes.
    length: u64,
}

/// The head of a record, and where it stands in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Record {
    /// Kind of the record.
    pub opcode: u8,
    /// File offset of the opcode.
    pub offset: u64,
    /// Length of the body, bytes.
    pub length: u64,
}

impl Record {
    /// Returns the file offset of the body.
    pub fn body(&self) -> u64 {
        self.offset + RECORD_HEAD_BYTES
    }

    /// Returns the file offset behind the record.
    pub fn end(&self) -> u64 {
        self.body() + self.length
    }

    /// Returns the length of the whole record, bytes.
    pub fn bytes(&self) -> u64 {
        RECORD_HEAD_BYTES + self.length
    }
}

impl<R: Read + Seek> Source<R> {
    /// Opens a file; fails if it is no MCAP.
    pub fn open(reader: R) -> Result<Self, ReadError> {
        let mut reader = BufReader::with_capacity(BUFFER_BYTES, reader);
        let length = reader.seek(SeekFrom::End(0))?;
        reader.seek(SeekFrom::Start(0))?;
        let mut source = Self { reader, position: 0, length };
        let mut first = Vec::new();
        source.read_at(0, RECOGNISED_BYTES.min(length), &mut first)?;
        check_magic(&first)?;
        Ok(source)
    }

    /// Returns the length of the file, bytes.
    pub fn length(&self) -> u64 {
        self.length
    }

    /// Whether the file ends as a finished one does.
    pub fn ends_with_magic(&mut self) -> io::Result<bool> {
        let magic_bytes = MAGIC.len() as u64;
        if self.length < 2 * magic_bytes {
            return Ok(false);
        }
        let mut last = Vec::new();
        Ok(self.read_at(self.length - magic_bytes, magic_bytes, &mut last)? && last == MAGIC)
    }

    /// Replaces the content of the buffer by `length` bytes of the file; returns false if the file has fewer there.
    pub fn read_at(&mut self, offset: u64, length: u64, buffer: &mut Vec<u8>) -> io::Result<bool> {
        buffer.clear();
        if offset.checked_add(length).is_none_or(|end| end > self.length) {
            return Ok(false);
        }
        let Ok(capacity) = usize::try_from(length) else { return Ok(false) };
        match i64::try_from(i128::from(offset) - i128::from(self.position)) {
            Ok(distance) => self.reader.seek_relative(distance)?,
            Err(_) => drop(self.reader.seek(SeekFrom::Start(offset))?),
        }
        self.position = offset;
        buffer.reserve_exact(capacity);
        let read = self.reader.by_ref().take(length).read_to_end(buffer)?;
        self.position += read as u64;
        Ok(read == capacity)
    }

    /// Reads the head of the record at `offset`, or says why there is none.
    pub fn record_at(&mut self, offset: u64) -> io::Result<Result<Record, String>> {
        let mut head = Vec::new();
        if !self.read_at(offset, RECORD_HEAD_BYTES, &mut head)? {
            return Ok(Err("expected a record, found the end of the file".to_owned()));
        }
        let Some((&opcode, length)) = head.split_first() else { return Ok(Err("found no opcode".to_owned())) };
        let mut length_bytes = [0; 8];
        length_bytes.copy_from_slice(length);
        let length = u64::from_le_bytes(length_bytes);
        let left = self.length - offset - RECORD_HEAD_BYTES;
        if opcode == 0 {
            return Ok(Err("expected a record, found opcode 0".to_owned()));
        }
        if length > left {
            return Ok(Err(format!("opcode {opcode:#04x}: expected {length} bytes, found {left}")));
        }
        Ok(Ok(Record { opcode, offset, length }))
    }
}
