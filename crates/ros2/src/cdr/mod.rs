//! CDR (XCDR1), the encoding of ROS 2 messages.
//!
//! A message is a 4-byte encapsulation header and then its fields in order. Each field is aligned to its size, counted from
//! the end of the header.

mod reader;
mod wire;
mod writer;

use thiserror::Error;

pub use reader::{CdrReader, MAX_MESSAGE_BYTES};
pub use wire::Wire;
pub(crate) use wire::wire_struct;
pub use writer::CdrWriter;

#[cfg(test)]
pub(crate) use wire::{Sample, SampleSource};

/// Length of the encapsulation header, bytes: representation identifier and options take two each.
pub const ENCAPSULATION_BYTES: usize = 4;

/// An error in the bytes of a message. Offsets count from the start of the message, header included.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum CdrError {
    /// The encapsulation header is neither that of big-endian nor that of little-endian CDR.
    #[error("expected a CDR header (00 00 or 00 01), found {found:02x?}")]
    Encapsulation {
        /// The header, or the whole message if it is shorter than one.
        found: Vec<u8>,
    },
    /// The message ends within a field.
    #[error("{what} at byte {offset}: expected {needed} bytes, found {found}")]
    Truncated {
        /// Type of the field.
        what: &'static str,
        /// Offset of the field, bytes.
        offset: usize,
        /// Bytes that the field takes, padding included.
        needed: usize,
        /// Bytes that are left.
        found: usize,
    },
    /// A sequence claims more elements than the rest of the message can hold.
    #[error(
        "sequence at byte {offset}: {count} elements expected, the {found} bytes that are left hold at most {most}"
    )]
    SequenceTooLong {
        /// Offset of the first element, bytes.
        offset: usize,
        /// Number of elements that the sequence claims.
        count: usize,
        /// Largest number of elements that the rest can hold.
        most: usize,
        /// Bytes that are left.
        found: usize,
    },
    /// A string is not UTF-8.
    #[error("string at byte {offset}: expected UTF-8, found byte {found:#04x} at its position {position}")]
    NotUtf8 {
        /// Offset of the string, bytes.
        offset: usize,
        /// Position of the first wrong byte within the string.
        position: usize,
        /// The first wrong byte.
        found: u8,
    },
    /// A bool is neither 0 nor 1.
    #[error("bool at byte {offset}: expected 0 or 1, found {found}")]
    NotBool {
        /// Offset of the bool, bytes.
        offset: usize,
        /// The byte that was found.
        found: u8,
    },
    /// More bytes follow the last field than padding explains.
    #[error("expected the message to end, found {found} more bytes")]
    Trailing {
        /// Bytes behind the last field.
        found: usize,
    },
    /// The message is larger than [`MAX_MESSAGE_BYTES`].
    #[error("expected a message of at most {limit} bytes, found {found}")]
    TooLarge {
        /// Largest size, bytes.
        limit: usize,
        /// Size of the message, bytes.
        found: usize,
    },
}
