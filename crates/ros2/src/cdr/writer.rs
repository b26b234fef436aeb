//! Writes little-endian CDR.

use super::ENCAPSULATION_BYTES;

/// Encapsulation header of little-endian CDR.
const HEADER: [u8; ENCAPSULATION_BYTES] = [0, 1, 0, 0];

/// Writes a message, field by field, into a buffer.
#[derive(Debug)]
pub struct CdrWriter<'a> {
    message: &'a mut Vec<u8>,
}

impl<'a> CdrWriter<'a> {
    /// Empties the buffer and writes the encapsulation header.
    pub fn new(buffer: &'a mut Vec<u8>) -> Self {
        buffer.clear();
        buffer.extend_from_slice(&HEADER);
        Self { message: buffer }
    }

    /// Writes a number of N bytes, aligned to N.
    pub(super) fn number<const N: usize>(&mut self, little_endian: [u8; N]) {
        let position = self.message.len() - ENCAPSULATION_BYTES;
        self.message.resize(ENCAPSULATION_BYTES + position.next_multiple_of(N), 0);
        self.message.extend_from_slice(&little_endian);
    }

    /// Writes a uint32.
    pub fn u32(&mut self, value: u32) {
        self.number(value.to_le_bytes());
    }

    /// Writes a string up to its first NUL: other readers end a string there.
    pub fn str(&mut self, text: &str) {
        let text = text.split('\0').next().unwrap_or_default();
        self.count(text.len() + 1);
        self.raw(text.as_bytes());
        self.raw(&[0]);
    }

    /// Writes a sequence of bytes.
    pub fn bytes(&mut self, bytes: &[u8]) {
        self.count(bytes.len());
        self.raw(bytes);
    }

    /// Writes bytes without a count.
    pub fn raw(&mut self, bytes: &[u8]) {
        self.message.extend_from_slice(bytes);
    }

    /// Writes the element count of a sequence. Messages are refused long before they hold 2^32 elements.
    pub fn count(&mut self, count: usize) {
        self.u32(u32::try_from(count).unwrap_or(u32::MAX));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn golden_bytes() {
        let mut buffer = vec![1, 2, 3];
        let mut writer = CdrWriter::new(&mut buffer);
        writer.number([5]);
        writer.str("ab");
        writer.number(1.0f64.to_le_bytes());
        writer.bytes(&[8, 9]);
        let expected = [
            &[0, 1, 0, 0][..],
            &[5, 0, 0, 0, 3, 0, 0, 0, b'a', b'b', 0, 0, 0, 0, 0, 0],
            &[0, 0, 0, 0, 0, 0, 0xf0, 0x3f],
            &[2, 0, 0, 0, 8, 9],
        ];
        assert_eq!(buffer, expected.concat());
    }

    #[test]
    fn a_string_ends_at_its_first_nul() {
        let mut buffer = Vec::new();
        CdrWriter::new(&mut buffer).str("a\0b");
        assert_eq!(buffer, [0, 1, 0, 0, 2, 0, 0, 0, b'a', 0]);
    }
}
