//! A file with the hash of all that was handed to it, so that the manifest's is of what was meant to be written.

use std::io::{self, BufWriter, Write};

pub(super) struct Hashing<W: Write> {
    file: BufWriter<W>,
    hash: blake3::Hasher,
}

impl<W: Write> Hashing<W> {
    pub(super) fn new(file: W) -> Self {
        Self { file: BufWriter::with_capacity(1 << 16, file), hash: blake3::Hasher::new() }
    }

    /// Everything handed on; length and hash.
    pub(super) fn end(mut self) -> io::Result<(u64, String)> {
        self.file.flush()?;
        Ok((self.hash.count(), self.hash.finalize().to_hex().to_string()))
    }
}

impl<W: Write> Write for Hashing<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let taken = self.file.write(bytes)?;
        self.hash.update(&bytes[..taken]);
        Ok(taken)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}
