//! What goes from the agent to the recorder, in order.

use std::path::PathBuf;

use realitysim_ros2::mcap_read::LogMessage;

pub(super) enum Entry {
    /// A segment begins here, with the filter's state.
    Begin(Beginning),
    Message(LogMessage, Kind),
    /// Something could not be written here.
    Gap(Gap),
    /// The frame before it can have no tag.
    Untagged(String),
    /// A frame that is tagged and not wanted.
    Thinned,
    /// A small file beside the sessions.
    State(PathBuf, Vec<u8>),
}

#[derive(Clone)]
pub(super) struct Beginning {
    pub log_time_ns: i64,
    pub name: String,
    pub state: Vec<u8>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Kind {
    Frame,
    /// Opens every later segment as well.
    Latched,
    /// Where the tag is valid, metres in `map`.
    Tag(Option<[f64; 2]>),
    Other,
}

/// What was dropped between two messages of the log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Gap {
    pub cause: String,
    pub frames: u64,
    /// Other than frames.
    pub messages: u64,
    /// Tags among these.
    pub untagged: u64,
    pub first_ns: i64,
    pub last_ns: i64,
}

/// Beside its bytes a message takes about this: the entry itself, its place in a queue, its record's head.
const ENTRY_BYTES: usize = 192;

impl Entry {
    pub fn is_frame(&self) -> bool {
        matches!(self, Self::Message(_, Kind::Frame))
    }

    /// Memory that it holds.
    pub fn bytes(&self) -> usize {
        ENTRY_BYTES
            + match self {
                Self::Begin(beginning) => beginning.state.capacity(),
                Self::Message(message, _) => message.data.capacity(),
                Self::State(_, data) => data.capacity(),
                Self::Gap(_) | Self::Untagged(_) | Self::Thinned => 0,
            }
    }
}

impl Entry {
    /// Whether it says again what is latched.
    pub fn repeats(&self, latched: &LogMessage) -> bool {
        matches!(self, Self::Message(message, Kind::Latched)
            if message.channel.topic == latched.channel.topic && message.data == latched.data)
    }

    /// When it was logged, if it is a message.
    pub fn log_time_ns(&self) -> Option<i64> {
        match self {
            Self::Message(message, _) => Some(message.log_time_ns),
            _ => None,
        }
    }
}
