//! The channels that a log defines, and the selection of topics to read.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;

use mcap::records::{self, Record, op};

use super::lengths::parse_record;
use crate::messages::Message;

/// Largest size of all definitions of a log together, bytes; those of real logs take some kilobytes.
const MAX_DEFINITIONS_BYTES: usize = 64 << 20;

/// The topics to read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Selection {
    /// Every topic.
    #[default]
    All,
    /// The topics of these names.
    Topics(BTreeSet<String>),
}

impl Selection {
    /// Selects topics by their names.
    pub fn topics<T: Into<String>>(topics: impl IntoIterator<Item = T>) -> Self {
        Self::Topics(topics.into_iter().map(Into::into).collect())
    }

    /// Whether a topic is selected.
    pub(super) fn wants(&self, topic: &str) -> bool {
        match self {
            Self::All => true,
            Self::Topics(topics) => topics.contains(topic),
        }
    }
}

/// A channel of a log: a topic as one writer described it. A topic may have several channels.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Channel {
    /// Number of the channel in its log.
    pub id: u16,
    /// Name of the topic.
    pub topic: String,
    /// Type of the messages, `package/msg/Name`; empty if the log does not say.
    pub type_name: String,
    /// Encoding of the messages: `cdr` in ROS 2 logs.
    pub message_encoding: String,
    /// Form of the definition: `ros2msg` or `ros2idl` in ROS 2 logs; empty if there is none.
    pub schema_encoding: String,
    /// Definition of the type, nested types included.
    pub definition: Arc<[u8]>,
    /// Metadata of the channel, where rosbag2 keeps the quality of service.
    pub metadata: BTreeMap<String, String>,
}

impl Channel {
    /// Makes a channel for a message type of this crate.
    pub fn of<M: Message>(id: u16, topic: &str, metadata: BTreeMap<String, String>) -> Self {
        Self {
            id,
            topic: topic.to_owned(),
            type_name: M::TYPE.to_owned(),
            message_encoding: "cdr".to_owned(),
            schema_encoding: "ros2msg".to_owned(),
            definition: M::DEFINITION.as_bytes().into(),
            metadata,
        }
    }
}

impl Channel {
    /// Whether the messages are CDR and their type is defined in a form of ROS 2.
    pub fn is_ros2(&self) -> bool {
        self.message_encoding == "cdr" && matches!(self.schema_encoding.as_str(), "ros2msg" | "ros2idl")
    }

    /// Returns the quality of service in YAML, as rosbag2 writes it; empty if the log does not say.
    pub fn qos_profiles(&self) -> &str {
        self.metadata.get(super::QOS_KEY).map(String::as_str).unwrap_or_default()
    }

    /// Whether late subscribers got the last message (durability transient_local), as on `/tf_static`.
    pub fn is_latched(&self) -> bool {
        self.qos_profiles()
            .lines()
            .filter_map(|line| line.trim_start_matches([' ', '-']).strip_prefix("durability:"))
            .any(|durability| matches!(durability.trim().trim_matches(['"', '\'']), "1" | "transient_local"))
    }
}

/// A schema or channel record, parsed but not yet entered into [`Channels`].
pub(super) enum Definition {
    Schema { id: u16, schema: Schema },
    Channel(records::Channel),
}

/// The type of a channel.
#[derive(Clone, PartialEq, Eq)]
pub(super) struct Schema {
    name: String,
    encoding: String,
    definition: Arc<[u8]>,
}

impl Definition {
    /// Returns the number of a channel, or `None` for a schema.
    pub fn channel_id(&self) -> Option<u16> {
        match self {
            Self::Schema { .. } => None,
            Self::Channel(channel) => Some(channel.id),
        }
    }

    /// Parses a record; `None` if it is neither a schema nor a channel.
    pub fn parse(opcode: u8, body: &[u8]) -> Result<Option<Self>, String> {
        if !matches!(opcode, op::SCHEMA | op::CHANNEL) {
            return Ok(None);
        }
        match parse_record(opcode, body) {
            Ok(Record::Schema { header, data }) => {
                let schema = Schema { name: header.name, encoding: header.encoding, definition: data.as_ref().into() };
                Ok(Some(Self::Schema { id: header.id, schema }))
            }
            Ok(Record::Channel(channel)) => Ok(Some(Self::Channel(channel))),
            Ok(_) => Ok(None),
            Err(error) => Err(format!("expected a definition, found {error}")),
        }
    }
}

/// The schemas and channels read so far.
pub(super) struct Channels {
    selection: Selection,
    schemas: HashMap<u16, Schema>,
    /// Channels by number, and whether each is selected.
    channels: HashMap<u16, (Arc<Channel>, bool)>,
    /// Size of all definitions together.
    bytes: usize,
}

impl Channels {
    pub fn new(selection: Selection) -> Self {
        Self { selection, schemas: HashMap::new(), channels: HashMap::new(), bytes: 0 }
    }

    /// Enters a definition. It replaces an earlier one of the same number.
    pub fn define(&mut self, definition: Definition) -> Result<(), String> {
        match definition {
            Definition::Schema { id, schema } => {
                if self.schemas.get(&id) != Some(&schema) {
                    self.spend(schema.name.len() + schema.encoding.len() + schema.definition.len())?;
                    self.schemas.insert(id, schema);
                }
            }
            Definition::Channel(record) => {
                let channel = self.resolve(record);
                if self.channels.get(&channel.id).is_none_or(|(known, _)| **known != channel) {
                    let metadata: usize = channel.metadata.iter().map(|(key, value)| key.len() + value.len()).sum();
                    self.spend(channel.topic.len() + channel.type_name.len() + metadata)?;
                    let wanted = self.selection.wants(&channel.topic);
                    self.channels.insert(channel.id, (Arc::new(channel), wanted));
                }
            }
        }
        Ok(())
    }

    /// Joins a channel record with its schema.
    fn resolve(&self, record: records::Channel) -> Channel {
        let schema = self.schemas.get(&record.schema_id).cloned();
        let schema = schema.unwrap_or_else(|| Schema {
            name: String::new(),
            encoding: String::new(),
            definition: Arc::default(),
        });
        Channel {
            id: record.id,
            topic: record.topic,
            type_name: schema.name,
            message_encoding: record.message_encoding,
            schema_encoding: schema.encoding,
            definition: schema.definition,
            metadata: record.metadata,
        }
    }

    /// Counts bytes of definitions, up to the limit.
    fn spend(&mut self, bytes: usize) -> Result<(), String> {
        if self.bytes + bytes > MAX_DEFINITIONS_BYTES {
            return Err(format!("expected at most {MAX_DEFINITIONS_BYTES} bytes of definitions"));
        }
        self.bytes += bytes;
        Ok(())
    }

    /// Returns the channel of a number.
    pub fn get(&self, id: u16) -> Option<&Arc<Channel>> {
        self.channels.get(&id).map(|(channel, _)| channel)
    }

    /// Whether a channel is selected; `None` if it is not known.
    pub fn wanted(&self, id: u16) -> Option<bool> {
        self.channels.get(&id).map(|(_, wanted)| *wanted)
    }

    /// Returns all channels, selected or not.
    pub fn iter(&self) -> impl Iterator<Item = &Arc<Channel>> {
        self.channels.values().map(|(channel, _)| channel)
    }
}
