//! ROS 2 logs without a ROS installation: messages in CDR, files in MCAP.
//!
//! [`messages`] has the message types as structs, [`cdr`] their encoding. [`LogWriter`] writes an append-only log.
//! [`LogReader`] iterates over the messages of a log, which may be torn or damaged; [`Damage`] counts what it left out.
//! [`survey`] lists what a log holds, [`attachments`] reads the files inside it, and [`topics`] has the names of the topics
//! that this program writes. Readers and writers are passed in; nothing here opens a file or reads a clock.
//!
//! ```rust
//! use std::io::Cursor;
//! use realitysim_ros2::messages::{Header, Odometry};
//! use realitysim_ros2::{Durability, LogReader, LogWriter, Message, Selection};
//!
//! let mut log = LogWriter::new(Vec::new())?;
//! let channel = log.add_channel::<Odometry>("/odom", Durability::Volatile)?;
//! let odometry = Odometry { header: Header::at(1_000_000_000, "odom"), ..Odometry::default() };
//! log.write(channel, 0, 1_000_000_000, 1_000_000_000, &odometry.encode())?;
//!
//! let mut reader = LogReader::open(Cursor::new(log.finish()?), Selection::topics(["/odom"]))?;
//! let message = reader.next().expect("one message")?;
//! assert_eq!(message.channel.type_name, "nav_msgs/msg/Odometry");
//! assert_eq!(Odometry::decode(&message.data)?, odometry);
//! assert!(reader.next().is_none() && reader.damage().is_none());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

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
