//! Lists what a log holds: by its summary if that says enough, otherwise, or on demand, by reading all of it.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{Read, Seek};
use std::sync::Arc;

use mcap::records::{ChunkIndex, Record as Parsed, op};

use super::attachments::{
    MetadataRecord, find_side_records, read_attachment_name, read_metadata, read_sound_attachments, walk_records,
};
use super::channels::{Channel, Channels, Selection};
use super::chunk::nanoseconds;
use super::error::{Damage, ReadError};
use super::fields::Fields;
use super::lengths::parse_record;
use super::source::{Record, Source};
use super::summary::Summary;
use super::{LogReader, Order};

/// Largest message index that is used, bytes; beyond it the messages are counted by reading them.
const MAX_MESSAGE_INDEX_BYTES: u64 = 64 << 20;

/// The topics, attachments and metadata of a log, and its damage.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Survey {
    /// Topics, sorted by name.
    pub topics: Vec<Topic>,
    /// Names of the attachments, in the order of the file.
    pub attachments: Vec<String>,
    /// Metadata records, in the order of the file.
    pub metadata: Vec<MetadataRecord>,
    /// Compressions of the chunks: `none`, `zstd`, `lz4` or another name in the file; empty without chunks.
    pub compressions: BTreeSet<String>,
    /// Whether messages can be read in the order of their log times.
    pub indexed: bool,
    /// Number of chunks without a checksum, in which [`examine`] cannot see a wrong value. [`survey`] does not count them.
    pub unprotected_chunks: u64,
    /// Damage that was found. If the log has an index, [`survey`] does not read the chunks, so it finds no damage in them.
    pub damage: Damage,
}

/// One topic of a log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Topic {
    /// Name of the topic.
    pub topic: String,
    /// Type of the messages, `package/msg/Name`; empty if the log does not say.
    pub type_name: String,
    /// Encoding of the messages: `cdr` in ROS 2 logs.
    pub message_encoding: String,
    /// Form of the type's definition: `ros2msg` or `ros2idl` in ROS 2 logs; empty if there is none.
    pub schema_encoding: String,
    /// Whether late subscribers got the last message (transient local).
    pub latched: bool,
    /// Quality of service of the first channel in YAML; empty if the log does not say.
    pub qos_profiles: String,
    /// Number of messages.
    pub messages: u64,
    /// Log time of the first message, nanoseconds.
    pub first_log_time_ns: Option<i64>,
    /// Log time of the last message, nanoseconds.
    pub last_log_time_ns: Option<i64>,
}

/// The number of messages of a channel, and the first and last of their log times.
#[derive(Clone, Copy, Default)]
struct ChannelCounts {
    messages: u64,
    times: Option<(i64, i64)>,
}

impl ChannelCounts {
    /// Extends the span of log times.
    fn extend(&mut self, first: i64, last: i64) {
        self.times = Some(self.times.map_or((first, last), |(from, to)| (from.min(first), to.max(last))));
    }
}

/// Lists what a log holds, by its index if it has one.
pub fn survey<R: Read + Seek>(reader: R) -> Result<Survey, ReadError> {
    survey_log(reader, false)
}

/// Lists what a log holds by reading every chunk and attachment, so that all damage is found.
pub fn examine<R: Read + Seek>(reader: R) -> Result<Survey, ReadError> {
    survey_log(reader, true)
}

/// Lists what a log holds. `reads_all` demands that every chunk and attachment is read.
fn survey_log<R: Read + Seek>(reader: R, reads_all: bool) -> Result<Survey, ReadError> {
    let mut source = Source::open(reader)?;
    let (mut channels, mut damage) = (Channels::new(Selection::All), Damage::default());
    damage.torn = !source.ends_with_magic()?;
    let summary = Summary::read(&mut source, &mut channels, &mut damage)?;
    // A walk would find the same damage between records as the reading below, so it is not counted here.
    let records = find_side_records(summary.as_ref(), &mut source, &mut Damage::default())?;
    if let (true, Some(summary)) = (reads_all, &summary) {
        summary.check_side_places(&mut source, &mut damage)?;
    }
    let index = match summary {
        Some(summary) if summary.leads_to_all_messages(&channels, &mut source)? => Some(summary),
        _ => None,
    };
    let mut survey = Survey { indexed: index.is_some(), ..Survey::default() };
    survey.metadata = read_metadata(&mut source, &records, &mut damage)?;
    for record in records.iter().filter(|record| record.opcode == op::ATTACHMENT) {
        survey.attachments.extend(read_attachment_name(&mut source, record)?);
    }
    let channel_counts = match &index {
        Some(index) if !reads_all => count_by_index(index, &mut source)?,
        _ => None,
    };
    match (channel_counts, index) {
        (Some(channel_counts), Some(index)) => {
            survey.compressions = index.chunks.iter().map(|chunk| compression_name(&chunk.compression)).collect();
            survey.topics = merge_topics(channels.iter(), &channel_counts);
        }
        (_, index) => {
            if reads_all {
                read_sound_attachments(&mut source, &records, &mut damage)?;
            }
            for chunk in walk_records(&mut source, &[op::CHUNK], &mut Damage::default())? {
                let Some(ChunkHead { has_checksum, compression }) = read_chunk_head(&mut source, &chunk)? else {
                    continue;
                };
                survey.unprotected_chunks += u64::from(reads_all && !has_checksum);
                survey.compressions.insert(compression);
            }
            let order = index.map_or_else(Order::by_file, |index| Order::by_index(index.chunks, &channels));
            let mut reader = LogReader { source, channels, damage, order, place: None };
            let mut channel_counts: BTreeMap<u16, ChannelCounts> = BTreeMap::new();
            for message in &mut reader {
                let message = message?;
                let counts = channel_counts.entry(message.channel.id).or_default();
                counts.messages += 1;
                counts.extend(message.log_time_ns, message.log_time_ns);
            }
            survey.topics = merge_topics(reader.channels(), &channel_counts);
            damage = reader.damage;
        }
    }
    survey.damage = damage;
    Ok(survey)
}

/// Reads the metadata records of a log, finished or not, as far as they are sound.
pub fn metadata_records<R: Read + Seek>(reader: R) -> Result<Vec<MetadataRecord>, ReadError> {
    let mut source = Source::open(reader)?;
    let summary = Summary::read(&mut source, &mut Channels::new(Selection::default()), &mut Damage::default())?;
    let records = find_side_records(summary.as_ref(), &mut source, &mut Damage::default())?;
    read_metadata(&mut source, &records, &mut Damage::default())
}

/// Takes the counts from the statistics, and the times from the message indexes of those chunks that can hold the first and
/// the last message; `None` if the file lacks these.
fn count_by_index<R: Read + Seek>(
    summary: &Summary,
    source: &mut Source<R>,
) -> Result<Option<BTreeMap<u16, ChannelCounts>>, ReadError> {
    let Some(statistics) = &summary.statistics else { return Ok(None) };
    let mut channel_counts = BTreeMap::new();
    for (&channel, &messages) in &statistics.channel_message_counts {
        let mut counts = ChannelCounts { messages, times: None };
        let mut chunks: Vec<(&ChunkIndex, u64)> = Vec::new();
        chunks.extend(summary.chunks.iter().filter_map(|c| Some((c, *c.message_index_offsets.get(&channel)?))));
        if messages > 0 {
            chunks.sort_by_key(|(chunk, _)| chunk.message_start_time);
            for (chunk, offset) in &chunks {
                if counts.times.is_some_and(|(first, _)| nanoseconds(chunk.message_start_time) >= first) {
                    break;
                }
                let Some((first, last)) = indexed_times(chunk, channel, *offset, source)? else { return Ok(None) };
                counts.extend(first, last);
            }
            chunks.sort_by_key(|(chunk, _)| std::cmp::Reverse(chunk.message_end_time));
            for (chunk, offset) in &chunks {
                if counts.times.is_some_and(|(_, last)| nanoseconds(chunk.message_end_time) <= last) {
                    break;
                }
                let Some((first, last)) = indexed_times(chunk, channel, *offset, source)? else { return Ok(None) };
                counts.extend(first, last);
            }
            if counts.times.is_none() {
                return Ok(None);
            }
        }
        channel_counts.insert(channel, counts);
    }
    Ok(Some(channel_counts))
}

/// Reads the first and last log time of a channel in a chunk; `None` if the message index is not plausible.
fn indexed_times<R: Read + Seek>(
    chunk: &ChunkIndex,
    channel: u16,
    offset: u64,
    source: &mut Source<R>,
) -> Result<Option<(i64, i64)>, ReadError> {
    let Ok(record) = source.record_at(offset)? else { return Ok(None) };
    if record.opcode != op::MESSAGE_INDEX || record.length > chunk.message_index_length.min(MAX_MESSAGE_INDEX_BYTES) {
        return Ok(None);
    }
    let mut body = Vec::new();
    source.read_at(record.body(), record.length, &mut body)?;
    let Ok(Parsed::MessageIndex(index)) = parse_record(op::MESSAGE_INDEX, &body) else { return Ok(None) };
    let span = chunk.message_start_time..=chunk.message_end_time;
    if index.channel_id != channel || index.records.iter().any(|entry| !span.contains(&entry.log_time)) {
        return Ok(None);
    }
    let times = || index.records.iter().map(|entry| nanoseconds(entry.log_time));
    Ok(times().min().zip(times().max()))
}

/// Merges channels of the same topic, type and encoding.
fn merge_topics<'a>(
    channels: impl Iterator<Item = &'a Arc<Channel>>,
    channel_counts: &BTreeMap<u16, ChannelCounts>,
) -> Vec<Topic> {
    let mut found: BTreeMap<(&str, &str, &str), Topic> = BTreeMap::new();
    for channel in channels {
        let key = (channel.topic.as_str(), channel.type_name.as_str(), channel.message_encoding.as_str());
        let topic = found.entry(key).or_insert_with(|| Topic {
            topic: channel.topic.clone(),
            type_name: channel.type_name.clone(),
            message_encoding: channel.message_encoding.clone(),
            schema_encoding: channel.schema_encoding.clone(),
            latched: false,
            qos_profiles: channel.qos_profiles().to_owned(),
            messages: 0,
            first_log_time_ns: None,
            last_log_time_ns: None,
        });
        topic.latched |= channel.is_latched();
        let counts = channel_counts.get(&channel.id).copied().unwrap_or_default();
        topic.messages = topic.messages.saturating_add(counts.messages);
        if let Some((first, last)) = counts.times {
            topic.first_log_time_ns = Some(topic.first_log_time_ns.map_or(first, |time| time.min(first)));
            topic.last_log_time_ns = Some(topic.last_log_time_ns.map_or(last, |time| time.max(last)));
        }
    }
    found.into_values().collect()
}

/// Names a compression; MCAP has an empty name for none.
fn compression_name(name: &str) -> String {
    if name.is_empty() { "none".to_owned() } else { name.to_owned() }
}

/// The fields of a chunk that tell its protection and compression.
struct ChunkHead {
    has_checksum: bool,
    compression: String,
}

/// Reads the head of a chunk, but not its records.
fn read_chunk_head<R: Read + Seek>(source: &mut Source<R>, chunk: &Record) -> Result<Option<ChunkHead>, ReadError> {
    /// Length of the head, bytes: two times, a size, a checksum, and the name of the compression.
    const HEAD_BYTES: u64 = 8 + 8 + 8 + 4 + 4 + 32;
    let mut head = Vec::new();
    source.read_at(chunk.body(), chunk.length.min(HEAD_BYTES), &mut head)?;
    let mut fields = Fields::new(&head);
    Ok((|| {
        fields.bytes(24)?;
        let has_checksum = fields.u32()? != 0;
        Some(ChunkHead { has_checksum, compression: compression_name(fields.string()?) })
    })())
}
