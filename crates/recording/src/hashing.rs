//! A writer that hashes the bytes handed to it, so that the hash in the manifest is that of what was meant to be
//! written.

use std::io::{self, BufWriter, Write};

/// Buffered writer with the BLAKE3 hash of everything that was written.
pub(super) struct HashingWriter<W: Write> {
    file: BufWriter<W>,
    hash: blake3::Hasher,
}

impl<W: Write> HashingWriter<W> {
    pub(super) fn new(file: W) -> Self {
        Self { file: BufWriter::with_capacity(1 << 16, file), hash: blake3::Hasher::new() }
    }

    /// Flushes the buffer and returns the number of bytes and their hash, hexadecimal.
    pub(super) fn end(mut self) -> io::Result<(u64, String)> {
        self.file.flush()?;
        Ok((self.hash.count(), self.hash.finalize().to_hex().to_string()))
    }
}

impl<W: Write> Write for HashingWriter<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let taken = self.file.write(bytes)?;
        self.hash.update(&bytes[..taken]);
        Ok(taken)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}
