//! CDR (XCDR1), the encoding of ROS 2 messages: a 4-byte encapsulation header, then the fields in order, each
//! aligned to its size counted from behind that header.

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

/// Length of the encapsulation header: representation identifier and options, two bytes each.
pub const ENCAPSULATION_BYTES: usize = 4;

/// Why bytes are not the message that was asked for. Offsets count from the start of the bytes.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum CdrError {
    #[error("expected a CDR header (00 00 or 00 01), found {found:02x?}")]
    Encapsulation { found: Vec<u8> },
    #[error("{what} at byte {offset}: expected {needed} bytes, found {found}")]
    Truncated { what: &'static str, offset: usize, needed: usize, found: usize },
    #[error(
        "sequence at byte {offset}: {count} elements expected, the {found} bytes that are left hold at most {most}"
    )]
    SequenceTooLong { offset: usize, count: usize, most: usize, found: usize },
    #[error("string at byte {offset}: expected UTF-8, found byte {found:#04x} at its position {position}")]
    NotUtf8 { offset: usize, position: usize, found: u8 },
    #[error("bool at byte {offset}: expected 0 or 1, found {found}")]
    NotBool { offset: usize, found: u8 },
    #[error("expected the message to end, found {found} more bytes")]
    Trailing { found: usize },
    #[error("expected a message of at most {limit} bytes, found {found}")]
    TooLarge { limit: usize, found: usize },
}
