//! Writes MCAP logs. A log is only appended to, so everything that was flushed before a power loss can be read.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashSet};
use std::io::{self, Seek, SeekFrom, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use mcap::records::{MessageHeader, Metadata};
use mcap::{McapError, WriteOptions, Writer};
use thiserror::Error;

use super::cdr::MAX_MESSAGE_BYTES;
use super::mcap_read::{Channel, MAX_ATTACHMENT_BYTES, QOS_KEY};
use super::messages::Message;

/// Size beyond which a chunk is closed, bytes. A power loss costs the messages of the open chunk.
const CHUNK_BYTES: u64 = 1 << 20;

/// Why a log could not be written.
#[derive(Debug, Error)]
pub enum WriteError {
    /// The writer below failed.
    #[error("cannot write the log: {0}")]
    Io(io::Error),
    /// The MCAP library refused what was to be written.
    #[error("cannot write the log: {0}")]
    Mcap(McapError),
    /// A message or attachment is larger than a reader would accept.
    #[error("{what}: expected at most {limit} bytes, found {found}")]
    TooLarge {
        /// `message` or `attachment`.
        what: &'static str,
        /// Largest size, bytes.
        limit: u64,
        /// Size that was found, bytes.
        found: u64,
    },
}

impl From<McapError> for WriteError {
    fn from(error: McapError) -> Self {
        match error {
            McapError::Io(error) => Self::Io(error),
            error => Self::Mcap(error),
        }
    }
}

/// The number of a channel in one [`LogWriter`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ChannelId(u16);

/// The durability of a topic in ROS: whether late subscribers get the last message.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Durability {
    /// Late subscribers get only messages that come after them.
    #[default]
    Volatile,
    /// Late subscribers get the last message, as on `/tf_static`.
    TransientLocal,
}

/// Writes one log.
///
/// If it is dropped without [`finish`](Self::finish), it closes the log as well as it can. After an I/O error it leaves the
/// log as it is and refuses every further write.
pub struct LogWriter<W: Write> {
    writer: Writer<Counted<W>>,
    bytes: Arc<AtomicU64>,
    /// Numbers of the channels added so far.
    channels: HashSet<u16>,
    /// Whether the open chunk has definitions and no message yet.
    definitions_open: bool,
}

impl<W: Write> LogWriter<W> {
    /// Begins a log and writes the head of the file.
    pub fn new(writer: W) -> Result<Self, WriteError> {
        let options = WriteOptions::new()
            .profile("ros2")
            .library("realitysim")
            .compression(None)
            .chunk_size(Some(CHUNK_BYTES))
            .disable_seeking(true)
            .calculate_chunk_crcs(true);
        let bytes = Arc::new(AtomicU64::new(0));
        let writer = options.create(Counted { writer, bytes: Arc::clone(&bytes), failed: false })?;
        Ok(Self { writer, bytes, channels: HashSet::new(), definitions_open: false })
    }

    /// Adds a topic of a message type of this crate; adding it again gives the same channel.
    pub fn add_channel<M: Message>(&mut self, topic: &str, durability: Durability) -> Result<ChannelId, WriteError> {
        let metadata = channel_metadata(durability);
        let schema = self.writer.add_schema(M::TYPE, "ros2msg", M::DEFINITION.as_bytes())?;
        self.add(schema, topic, "cdr", &metadata)
    }

    /// Adds a topic of any type, so that messages of another log can be passed on.
    pub fn add_raw_channel(&mut self, channel: &RawChannel<'_>) -> Result<ChannelId, WriteError> {
        // A type without a definition has a schema all the same, with its name and an empty encoding.
        let schema = match (channel.type_name, channel.schema_encoding) {
            ("", "") => 0,
            (name, encoding) => self.writer.add_schema(name, encoding, channel.definition)?,
        };
        self.add(schema, channel.topic, channel.message_encoding, channel.metadata)
    }

    fn add(
        &mut self,
        schema: u16,
        topic: &str,
        encoding: &str,
        metadata: &BTreeMap<String, String>,
    ) -> Result<ChannelId, WriteError> {
        let id = self.writer.add_channel(schema, topic, encoding, metadata)?;
        self.definitions_open |= self.channels.insert(id);
        Ok(ChannelId(id))
    }

    /// Writes one encoded message. Times are nanoseconds since 1970; earlier ones become 0.
    pub fn write(
        &mut self,
        channel: ChannelId,
        sequence: u32,
        log_time_ns: i64,
        publish_time_ns: i64,
        message: &[u8],
    ) -> Result<(), WriteError> {
        refuse_above(MAX_MESSAGE_BYTES as u64, "message", message)?;
        if self.definitions_open {
            // Definitions get a small chunk of their own: without an index, no message of a channel can be read whose
            // definition was in a damaged chunk.
            self.flush_chunk()?;
        }
        let (log_time, publish_time) = (unsigned_time(log_time_ns), unsigned_time(publish_time_ns));
        let header = MessageHeader { channel_id: channel.0, sequence, log_time, publish_time };
        Ok(self.writer.write_to_known_channel(&header, message)?)
    }

    /// Closes the open chunk, then writes an attachment. If it comes before any message, it survives a torn tail.
    pub fn attach(&mut self, name: &str, media_type: &str, log_time_ns: i64, data: &[u8]) -> Result<(), WriteError> {
        // The record also holds times, lengths, names and checksum.
        let head_bytes = (36 + name.len() + media_type.len()) as u64;
        refuse_above(MAX_ATTACHMENT_BYTES.saturating_sub(head_bytes), "attachment", data)?;
        let time = unsigned_time(log_time_ns);
        Ok(self.writer.attach(&mcap::Attachment {
            log_time: time,
            create_time: time,
            name: name.to_owned(),
            media_type: media_type.to_owned(),
            data: Cow::Borrowed(data),
        })?)
    }

    /// Closes the open chunk, then writes a metadata record.
    pub fn metadata(&mut self, name: &str, metadata: &BTreeMap<String, String>) -> Result<(), WriteError> {
        Ok(self.writer.write_metadata(&Metadata { name: name.to_owned(), metadata: metadata.clone() })?)
    }

    /// Closes the open chunk, so that everything written so far can be read once the bytes are on the disk.
    pub fn flush_chunk(&mut self) -> Result<(), WriteError> {
        self.definitions_open = false;
        Ok(self.writer.flush()?)
    }

    /// Returns how many bytes went to the writer below so far, without those of the open chunk.
    pub fn bytes_written(&self) -> u64 {
        self.bytes.load(Ordering::Relaxed)
    }

    /// Ends the log with its index and footer, and returns the writer below.
    pub fn finish(mut self) -> Result<W, WriteError> {
        self.writer.finish()?;
        let mut counted = self.writer.into_inner();
        counted.flush().map_err(WriteError::Io)?;
        Ok(counted.writer)
    }
}

/// The description of a topic of any type, for instance that of a [`Channel`] of another log.
#[derive(Clone, Copy, Debug)]
pub struct RawChannel<'a> {
    /// Name of the topic.
    pub topic: &'a str,
    /// Type of its messages, `package/msg/Name`; empty if it is not known.
    pub type_name: &'a str,
    /// Encoding of its messages: `cdr` in ROS 2 logs.
    pub message_encoding: &'a str,
    /// Form of the definition, `ros2msg` or `ros2idl`; empty if there is none.
    pub schema_encoding: &'a str,
    /// Definition of the type.
    pub definition: &'a [u8],
    /// Metadata of the channel, where rosbag2 keeps the quality of service.
    pub metadata: &'a BTreeMap<String, String>,
}

impl<'a> From<&'a Channel> for RawChannel<'a> {
    fn from(channel: &'a Channel) -> Self {
        Self {
            topic: &channel.topic,
            type_name: &channel.type_name,
            message_encoding: &channel.message_encoding,
            schema_encoding: &channel.schema_encoding,
            definition: &channel.definition,
            metadata: &channel.metadata,
        }
    }
}

/// Converts a time to that of MCAP, which has none before 1970.
fn unsigned_time(nanoseconds: i64) -> u64 {
    u64::try_from(nanoseconds).unwrap_or(0)
}

/// Refuses data of more than `limit` bytes.
fn refuse_above(limit: u64, what: &'static str, data: &[u8]) -> Result<(), WriteError> {
    let found = data.len() as u64;
    if found > limit { Err(WriteError::TooLarge { what, limit, found }) } else { Ok(()) }
}

/// Returns the metadata of a channel as rosbag2 writes it.
pub fn channel_metadata(durability: Durability) -> BTreeMap<String, String> {
    BTreeMap::from([(QOS_KEY.to_owned(), qos_profile(durability))])
}

/// Returns a quality of service profile in YAML, as rosbag2 writes it.
///
/// Policies are the numbers of rmw, which all versions of rosbag2 read; names are read from version 9 of its metadata on.
pub fn qos_profile(durability: Durability) -> String {
    const FOREVER: &str = "\n    sec: 9223372036\n    nsec: 854775807";
    let (depth, durability) = match durability {
        Durability::TransientLocal => (1, 1),
        Durability::Volatile => (10, 2),
    };
    format!(
        "- history: 1\n  depth: {depth}\n  reliability: 1\n  durability: {durability}\n  deadline:{FOREVER}\n  \
         lifespan:{FOREVER}\n  liveliness: 1\n  liveliness_lease_duration:{FOREVER}\n  \
         avoid_ros_namespace_conventions: false"
    )
}

/// A writer that counts its bytes, so that it knows its position without seeking: the file below may be a pipe.
///
/// After a failure it refuses every write, because nothing behind half a record can be read.
struct Counted<W> {
    writer: W,
    /// Bytes written; shared with the [`LogWriter`], which cannot reach this writer below the MCAP library.
    bytes: Arc<AtomicU64>,
    failed: bool,
}

impl<W> Counted<W> {
    /// Runs an operation of the writer below, unless an earlier one failed.
    fn attempt<T>(&mut self, operation: impl FnOnce(&mut W) -> io::Result<T>) -> io::Result<T> {
        if self.failed {
            return Err(io::Error::other("an earlier write failed"));
        }
        let result = operation(&mut self.writer);
        self.failed = matches!(&result, Err(error) if error.kind() != io::ErrorKind::Interrupted);
        result
    }
}

impl<W: Write> Write for Counted<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.attempt(|writer| match writer.write(bytes)? {
            0 if !bytes.is_empty() => Err(io::ErrorKind::WriteZero.into()),
            written => Ok(written),
        })?;
        self.bytes.fetch_add(written as u64, Ordering::Relaxed);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.attempt(Write::flush)
    }
}

impl<W> Seek for Counted<W> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let position = self.bytes.load(Ordering::Relaxed);
        if to == SeekFrom::Current(0) || to == SeekFrom::Start(position) {
            return Ok(position);
        }
        Err(io::Error::new(io::ErrorKind::Unsupported, format!("expected to append only, found a seek to {to:?}")))
    }
}
