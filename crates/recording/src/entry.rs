//! Entries: what goes from the agent to the recorder, in order.

use std::path::PathBuf;

use realitysim_ros2::mcap_read::LogMessage;

/// One thing that the recorder has to write or to count.
pub(super) enum Entry {
    /// The beginning of a segment, with the filter's state.
    Begin(SegmentStart),
    /// A message of the log.
    Message(LogMessage, Kind),
    /// A place where something could not be written.
    Gap(Gap),
    /// The frame before this entry can have no tag; with the cause.
    Untagged(String),
    /// A frame that is tagged and not written.
    Thinned,
    /// A small file beside the sessions: its path and its new content.
    State(PathBuf, Vec<u8>),
}

/// Beginning of a segment: the attachment with the filter's state.
#[derive(Clone)]
pub(super) struct SegmentStart {
    /// Log time of the beginning, ns.
    pub log_time_ns: i64,
    /// Name of the attachment.
    pub name: String,
    /// Content of the attachment.
    pub state: Vec<u8>,
}

/// What a message is to the counts and to later segments.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Kind {
    /// A frame.
    Frame,
    /// A message that also opens every later segment.
    Latched,
    /// A tag; with its position in `map`, metres, if it is valid.
    Tag(Option<[f64; 2]>),
    /// Any other message.
    Other,
}

/// What was dropped between two messages of the log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Gap {
    /// Name of the cause.
    pub cause: String,
    /// Number of frames that were dropped.
    pub frames: u64,
    /// Number of other messages that were dropped.
    pub messages: u64,
    /// Tags among these messages.
    pub untagged: u64,
    /// Log time of the first thing that was dropped, ns.
    pub first_ns: i64,
    /// Log time of the last thing that was dropped, ns.
    pub last_ns: i64,
}

/// Memory of a message besides its data, about, bytes: the entry, its place in a queue, the head of its record.
const ENTRY_BYTES: usize = 192;

impl Entry {
    /// Whether the entry is a frame.
    pub fn is_frame(&self) -> bool {
        matches!(self, Self::Message(_, Kind::Frame))
    }

    /// Memory that the entry holds, bytes.
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
    /// Whether the entry repeats the content of a latched message.
    pub fn repeats(&self, latched: &LogMessage) -> bool {
        matches!(self, Self::Message(message, Kind::Latched)
            if message.channel.topic == latched.channel.topic && message.data == latched.data)
    }

    /// Log time of a message, ns; `None` for other entries.
    pub fn log_time_ns(&self) -> Option<i64> {
        match self {
            Self::Message(message, _) => Some(message.log_time_ns),
            _ => None,
        }
    }
}
