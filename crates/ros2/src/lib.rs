//! ROS 2 logs: messages in CDR, files in MCAP. Pure: readers and writers are handed in, no clock is read.

pub mod cdr;
pub mod mcap_read;
pub mod mcap_write;
pub mod messages;
pub mod topics;

pub use cdr::CdrError;
pub use mcap_read::{
    Attachment, Attachments, Channel, Damage, LogMessage, LogReader, MetadataRecord, ReadError, Selection, Survey,
    Topic, attachments, examine, survey,
};
pub use mcap_write::{ChannelId, Durability, LogWriter, RawChannel, WriteError};
pub use messages::Message;
