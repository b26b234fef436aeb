//! Reads CDR of either byte order. Strings and bytes are borrowed from the message.

use super::{CdrError, ENCAPSULATION_BYTES};

/// Largest message that is read or written, bytes; no camera frame comes near it.
pub const MAX_MESSAGE_BYTES: usize = 128 << 20;

/// Largest number of bytes behind the last field. Middleware pads messages to a multiple of 4 or 8; more bytes mean another type.
const MAX_PADDING_BYTES: usize = 7;

/// A cursor in a CDR message. Each method reads the next field and fails if the message ends within it.
#[derive(Clone, Debug)]
pub struct CdrReader<'a> {
    /// The message behind its encapsulation header.
    body: &'a [u8],
    position: usize,
    big_endian: bool,
}

impl<'a> CdrReader<'a> {
    /// Begins to read a message: its encapsulation header says the byte order.
    pub fn new(message: &'a [u8]) -> Result<Self, CdrError> {
        if message.len() > MAX_MESSAGE_BYTES {
            return Err(CdrError::TooLarge { limit: MAX_MESSAGE_BYTES, found: message.len() });
        }
        let Some((header, body)) = message.split_first_chunk::<ENCAPSULATION_BYTES>() else {
            return Err(CdrError::Encapsulation { found: message.to_vec() });
        };
        match header[..2] {
            [0, order @ (0 | 1)] => Ok(Self { body, position: 0, big_endian: order == 0 }),
            _ => Err(CdrError::Encapsulation { found: header.to_vec() }),
        }
    }

    /// Checks that the message ends here, except for padding.
    pub fn finish(self) -> Result<(), CdrError> {
        let found = self.remaining();
        if found > MAX_PADDING_BYTES { Err(CdrError::Trailing { found }) } else { Ok(()) }
    }

    /// Returns how many bytes are left.
    pub fn remaining(&self) -> usize {
        self.body.len() - self.position
    }

    /// Returns the offset of the cursor in the message, header included.
    fn offset(&self) -> usize {
        self.position + ENCAPSULATION_BYTES
    }

    /// Takes the next bytes; `what` names them in an error.
    fn take(&mut self, what: &'static str, needed: usize) -> Result<&'a [u8], CdrError> {
        let rest = &self.body[self.position..];
        match rest.split_at_checked(needed) {
            Some((taken, _)) => {
                self.position += needed;
                Ok(taken)
            }
            None => Err(CdrError::Truncated { what, offset: self.offset(), needed, found: rest.len() }),
        }
    }

    /// Reads a number of N bytes, aligned to N, and returns its bytes in little-endian order.
    pub(super) fn number<const N: usize>(&mut self, what: &'static str) -> Result<[u8; N], CdrError> {
        let padding = self.position.next_multiple_of(N) - self.position;
        let found = self.remaining();
        if found < padding + N {
            return Err(CdrError::Truncated { what, offset: self.offset(), needed: padding + N, found });
        }
        self.position += padding;
        let mut number = [0; N];
        number.copy_from_slice(self.take(what, N)?);
        if self.big_endian {
            number.reverse();
        }
        Ok(number)
    }

    /// Reads a uint8.
    pub fn u8(&mut self) -> Result<u8, CdrError> {
        self.number("uint8").map(u8::from_le_bytes)
    }

    /// Reads a uint32.
    pub fn u32(&mut self) -> Result<u32, CdrError> {
        self.number("uint32").map(u32::from_le_bytes)
    }

    /// Reads a bool, which must be 0 or 1.
    pub fn bool(&mut self) -> Result<bool, CdrError> {
        let offset = self.offset();
        match self.u8()? {
            0 => Ok(false),
            1 => Ok(true),
            found => Err(CdrError::NotBool { offset, found }),
        }
    }

    /// Reads a string and drops its final NUL. As in the middleware, the NUL may be missing.
    pub fn str(&mut self) -> Result<&'a str, CdrError> {
        let length = self.u32()? as usize;
        let offset = self.offset();
        let bytes = self.take("string", length)?;
        let text = bytes.strip_suffix(&[0]).unwrap_or(bytes);
        str::from_utf8(text).map_err(|error| {
            let position = error.valid_up_to();
            CdrError::NotUtf8 { offset, position, found: text.get(position).copied().unwrap_or_default() }
        })
    }

    /// Reads a sequence of bytes.
    pub fn bytes(&mut self) -> Result<&'a [u8], CdrError> {
        let count = self.sequence(1)?;
        self.raw(count)
    }

    /// Reads the next `count` bytes.
    pub fn raw(&mut self, count: usize) -> Result<&'a [u8], CdrError> {
        self.take("bytes", count)
    }

    /// Reads the element count of a sequence whose elements take at least `element_bytes` each.
    ///
    /// The count is refused if the rest of the message cannot hold so many, so it never makes a caller allocate too much.
    pub fn sequence(&mut self, element_bytes: usize) -> Result<usize, CdrError> {
        let count = self.u32()? as usize;
        let found = self.remaining();
        let most = found / element_bytes.max(1);
        if count > most {
            return Err(CdrError::SequenceTooLong { offset: self.offset(), count, most, found });
        }
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn aligns_from_behind_the_header() {
        let message = [0, 1, 0, 0, 7, 0, 0, 0, 1, 2, 3, 4, 0, 0, 0, 0, 0, 0, 0xf0, 0x3f];
        let mut reader = CdrReader::new(&message[..12]).unwrap();
        assert_eq!(reader.u8(), Ok(7));
        assert_eq!(reader.u32(), Ok(0x0403_0201));
        reader.finish().unwrap();
        let mut reader = CdrReader::new(&message).unwrap();
        assert_eq!(reader.u8(), Ok(7));
        assert_eq!(reader.number::<8>("float64").map(f64::from_le_bytes).unwrap().to_bits(), 0x3ff0_0000_0000_0000);
    }

    #[test]
    fn reads_big_endian() {
        let message = [0, 0, 0, 0, 0, 0, 0, 3, b'a', b'b', 0, 0, 0, 0, 0, 1, 9];
        let mut reader = CdrReader::new(&message).unwrap();
        assert_eq!(reader.str(), Ok("ab"));
        assert_eq!(reader.bytes(), Ok(&[9][..]));
    }

    #[test]
    fn strings_without_nul_and_empty_ones() {
        let message = [0, 1, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, b'x'];
        let mut reader = CdrReader::new(&message).unwrap();
        assert_eq!(reader.str(), Ok(""));
        assert_eq!(reader.str(), Ok(""));
        assert_eq!(reader.str(), Ok("x"));
    }

    #[test]
    fn says_what_is_wrong() {
        let text = |message: &[u8]| CdrReader::new(message).and_then(|mut reader| reader.str().map(str::to_owned));
        assert_eq!(text(&[0, 2, 0, 0]), Err(CdrError::Encapsulation { found: vec![0, 2, 0, 0] }));
        assert_eq!(text(&[0, 1, 0]), Err(CdrError::Encapsulation { found: vec![0, 1, 0] }));
        let cut = text(&[0, 1, 0, 0, 255, 255, 255, 255, 1]).unwrap_err().to_string();
        assert_eq!(cut, "string at byte 8: expected 4294967295 bytes, found 1");
        let latin = text(&[0, 1, 0, 0, 2, 0, 0, 0, 0xe9, 0]).unwrap_err().to_string();
        assert_eq!(latin, "string at byte 8: expected UTF-8, found byte 0xe9 at its position 0");
        let mut reader = CdrReader::new(&[0, 1, 0, 0, 9, 0, 0, 0, 1]).unwrap();
        assert!(matches!(reader.bytes(), Err(CdrError::SequenceTooLong { count: 9, most: 1, .. })));
        let mut reader = CdrReader::new(&[0, 1, 0, 0, 2]).unwrap();
        assert_eq!(reader.bool(), Err(CdrError::NotBool { offset: 4, found: 2 }));
        assert_eq!(
            CdrReader::new(&[0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]).unwrap().finish(),
            Err(CdrError::Trailing { found: 8 })
        );
    }
}
