//! Reading any ROS 2 MCAP: chunked or not, compressed or not, with or without an index, torn or damaged.

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
pub use resync::{Remains, remains};
pub use sound::{Part, Piece, Sound, sound_pieces};
pub use survey::{Survey, Topic, examine, metadata_records, survey};

use mcap::records::ChunkIndex;

use attachments::MAX_METADATA_BYTES;
use channels::Channels;
use file_order::FileOrder;
use index_order::IndexOrder;
use source::Source;
use summary::Summary;

/// Where rosbag2 keeps a channel's quality of service.
pub(super) const QOS_KEY: &str = "offered_qos_profiles";

/// A message as it was logged. Whether it can be decoded is for its channel to say.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogMessage {
    pub channel: Arc<Channel>,
    /// As its writer counted; 0 where writers do not.
    pub sequence: u32,
    /// When it was logged.
    pub log_time_ns: i64,
    /// When it was published; where the writer did not know, the log time.
    pub publish_time_ns: i64,
    pub data: Vec<u8>,
}

/// The messages of a log, one chunk in memory at a time (more where they overlap).
///
/// With a sound index they come in the order of their log times, otherwise in that of the file. A message comes only
/// after the checksum of its chunk was found right, if there is one. After an I/O error the log ends.
pub struct LogReader<R> {
    source: Source<R>,
    channels: Channels,
    damage: Damage,
    order: Order,
    place: Option<u64>,
}

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

    /// What was found wrong so far; all there is once the log has ended.
    pub fn damage(&self) -> &Damage {
        &self.damage
    }

    /// Where in the file the data of the message given out last begin; `None` if they are compressed there.
    pub fn place(&self) -> Option<u64> {
        self.place
    }

    /// Whether messages come in the order of their log times.
    pub fn is_indexed(&self) -> bool {
        matches!(self.order, Order::LogTime(_))
    }

    /// The channels met so far, selected or not; all of them from the start if the log has an index.
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
