//! Reads any ROS 2 log in MCAP: chunked or not, compressed or not, with or without an index, torn or damaged.

mod attachments;
mod channels;
mod chunk;
mod error;
mod fields;
mod file_order;
mod index_order;
mod lengths;
mod resync;
mod sound;
mod source;
mod summary;
mod survey;
mod unpacking;

use std::io::{Read, Seek};
use std::sync::Arc;

pub use attachments::{Attachment, Attachments, MAX_ATTACHMENT_BYTES, MetadataRecord, attachments};
pub use channels::{Channel, Selection};
pub use error::{Damage, ReadError};
pub use resync::{FileTail, file_tail};
pub use sound::{Part, Piece, Sound, sound_pieces};
pub use survey::{Survey, Topic, examine, metadata_records, survey};

use mcap::records::ChunkIndex;

use attachments::MAX_METADATA_BYTES;
use channels::Channels;
use file_order::FileOrder;
use index_order::IndexOrder;
use source::Source;
use summary::Summary;

/// Key of a channel's metadata under which rosbag2 keeps the quality of service.
pub(super) const QOS_KEY: &str = "offered_qos_profiles";

/// A message as it was logged. Its channel says how it is encoded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogMessage {
    /// Topic, type and encoding.
    pub channel: Arc<Channel>,
    /// Number that the writer counted; 0 where writers do not count.
    pub sequence: u32,
    /// Time at which it was logged, nanoseconds.
    pub log_time_ns: i64,
    /// Time at which it was published, nanoseconds; the log time where the writer did not know.
    pub publish_time_ns: i64,
    /// The encoded message.
    pub data: Vec<u8>,
}

/// An iterator over the messages of a log, with one chunk in memory at a time (more where chunks overlap).
///
/// With a sound index, messages come in the order of their log times, otherwise in the order of the file. The checksum of a
/// chunk, if there is one, is verified before any of its messages comes. After an I/O error the iterator ends.
pub struct LogReader<R> {
    source: Source<R>,
    channels: Channels,
    damage: Damage,
    order: Order,
    /// File offset of the last message's data.
    place: Option<u64>,
}

/// The order in which a log is read.
enum Order {
    LogTime(IndexOrder),
    File(FileOrder),
    Ended,
}

impl Order {
    fn by_index(chunks: Vec<ChunkIndex>, channels: &Channels) -> Self {
        Self::LogTime(IndexOrder::new(chunks, channels))
    }

    fn by_file() -> Self {
        Self::File(FileOrder::new())
    }
}

impl<R: Read + Seek> LogReader<R> {
    /// Opens a log to read the selected topics.
    ///
    /// # Errors
    ///
    /// Fails if the file is no MCAP or cannot be read. Damage is no error: see [`Self::damage`].
    pub fn open(reader: R, selection: Selection) -> Result<Self, ReadError> {
        let mut source = Source::open(reader)?;
        let (mut channels, mut damage) = (Channels::new(selection), Damage::default());
        damage.torn = !source.ends_with_magic()?;
        let summary = Summary::read(&mut source, &mut channels, &mut damage)?;
        let order = match summary {
            Some(summary) if summary.leads_to_all_messages(&channels, &mut source)? => {
                Order::by_index(summary.chunks, &channels)
            }
            _ => Order::by_file(),
        };
        Ok(Self { source, channels, damage, order, place: None })
    }

    /// Returns the damage found so far; it is complete once the iterator has ended.
    pub fn damage(&self) -> &Damage {
        &self.damage
    }

    /// Returns the offset in the file at which the data of the last message begins; `None` if it is compressed.
    pub fn place(&self) -> Option<u64> {
        self.place
    }

    /// Whether messages come in the order of their log times.
    pub fn is_indexed(&self) -> bool {
        matches!(self.order, Order::LogTime(_))
    }

    /// Returns the channels found so far, selected or not. With an index, all are known from the start.
    pub fn channels(&self) -> impl Iterator<Item = &Arc<Channel>> {
        self.channels.iter()
    }
}

impl<R: Read + Seek> Iterator for LogReader<R> {
    type Item = Result<LogMessage, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        let (source, channels, damage) = (&mut self.source, &mut self.channels, &mut self.damage);
        let next = match &mut self.order {
            Order::LogTime(order) => order.next(source, channels, damage),
            Order::File(order) => order.next(source, channels, damage),
            Order::Ended => Ok(None),
        };
        if !matches!(next, Ok(Some(_))) {
            self.order = Order::Ended;
        }
        let next = next.map(|next| {
            next.map(|(message, place)| {
                self.place = place;
                message
            })
        });
        next.transpose()
    }
}
