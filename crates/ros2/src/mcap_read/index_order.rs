//! Reads a log by its index, in the order of log times, across chunks that overlap.

use std::io::{Read, Seek};

use mcap::records::{ChunkIndex, op};

use super::channels::Channels;
use super::chunk::{Chunk, MAX_CHUNK_BYTES, PlacedMessage};
use super::error::{Damage, ReadError};
use super::source::{RECORD_HEAD_BYTES, Source};
use super::unpacking::Unpacking;

/// Memory for overlapping chunks, bytes. Beyond it messages may come out of order, but none is lost.
const MAX_OPEN_BYTES: usize = 384 << 20;

/// The state of reading a log by its index.
pub(super) struct IndexOrder {
    /// Chunks that are not open yet, sorted by the log time of their first message, the earliest last.
    waiting: Vec<ChunkIndex>,
    /// Chunks in memory, each with its file offset.
    open: Vec<(u64, Chunk)>,
    /// Latest log time delivered so far.
    last_log_time: u64,
    /// [`MAX_OPEN_BYTES`], or less in tests.
    max_open_bytes: usize,
    unpacking: Unpacking,
}

impl IndexOrder {
    /// Begins with the chunks that may hold a selected message.
    pub fn new(mut chunks: Vec<ChunkIndex>, channels: &Channels) -> Self {
        chunks.retain(|chunk| {
            let mut ids = chunk.message_index_offsets.keys();
            // A chunk without message indexes may hold any channel, and may itself define an unknown one.
            chunk.message_index_offsets.is_empty() || ids.any(|&id| channels.wanted(id).unwrap_or(true))
        });
        chunks.sort_by_key(|chunk| std::cmp::Reverse((chunk.message_start_time, chunk.chunk_start_offset)));
        Self {
            waiting: chunks,
            open: Vec::new(),
            last_log_time: 0,
            max_open_bytes: MAX_OPEN_BYTES,
            unpacking: Unpacking::default(),
        }
    }

    /// Delivers the message with the earliest log time.
    pub fn next<R: Read + Seek>(
        &mut self,
        source: &mut Source<R>,
        channels: &mut Channels,
        damage: &mut Damage,
    ) -> Result<Option<PlacedMessage>, ReadError> {
        loop {
            let earliest = self.find_earliest();
            let held: usize = self.open.iter().map(|(_, chunk)| chunk.memory()).sum();
            let load = self.waiting.pop_if(|next| match earliest {
                None => true,
                Some((time, offset, _)) => {
                    held < self.max_open_bytes && (next.message_start_time, next.chunk_start_offset) < (time, offset)
                }
            });
            if let Some(index) = load {
                if let Some(chunk) = load_chunk(&index, source, &mut self.unpacking, channels, damage)? {
                    self.open.push((index.chunk_start_offset, chunk));
                }
                continue;
            }
            let Some((time, _, position)) = earliest else { return Ok(None) };
            let message = self.open[position].1.next(channels);
            if self.open[position].1.log_time().is_none() {
                self.open.swap_remove(position);
            }
            if time < self.last_log_time {
                damage.out_of_order += 1;
                damage.note(|| format!("log time {time} stands behind {}", self.last_log_time));
            }
            self.last_log_time = self.last_log_time.max(time);
            if message.is_some() {
                return Ok(message);
            }
        }
    }

    /// Returns log time, file offset and index in `open` of the chunk with the earliest message.
    fn find_earliest(&mut self) -> Option<(u64, u64, usize)> {
        self.open.retain(|(_, chunk)| chunk.log_time().is_some());
        let heads = self.open.iter().enumerate();
        heads.filter_map(|(i, (offset, chunk))| Some((chunk.log_time()?, *offset, i))).min()
    }
}

/// Reads a chunk that the index lists, and sorts its messages; `None` if it is damaged.
fn load_chunk<R: Read + Seek>(
    index: &ChunkIndex,
    source: &mut Source<R>,
    unpacking: &mut Unpacking,
    channels: &mut Channels,
    damage: &mut Damage,
) -> Result<Option<Chunk>, ReadError> {
    let offset = index.chunk_start_offset;
    let problem = match source.record_at(offset)? {
        Err(error) => Some(error),
        Ok(record) if record.opcode != op::CHUNK => {
            Some(format!("expected a chunk, found opcode {:#04x}", record.opcode))
        }
        Ok(record) if Some(record.length) != index.chunk_length.checked_sub(RECORD_HEAD_BYTES) => {
            Some(format!("expected {} bytes, found {}", index.chunk_length, record.bytes()))
        }
        Ok(record) if record.length > MAX_CHUNK_BYTES => {
            Some(format!("expected at most {MAX_CHUNK_BYTES} bytes, found {}", record.length))
        }
        Ok(_) => None,
    };
    let mut body = Vec::new();
    let problem = match problem {
        Some(problem) => Some(problem),
        None => {
            let start = offset + RECORD_HEAD_BYTES;
            let read = source.read_at(start, index.chunk_length - RECORD_HEAD_BYTES, &mut body)?;
            (!read).then(|| "expected a chunk, found the end of the file".to_owned())
        }
    };
    if let Some(problem) = problem {
        damage.bad_chunk(offset, index.chunk_length, &problem);
        return Ok(None);
    }
    let mut chunk = Chunk::unpack(body, offset, unpacking, channels, damage);
    chunk.iter_mut().for_each(Chunk::sort);
    Ok(chunk)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::io::Cursor;

    use mcap::WriteOptions;
    use mcap::records::MessageHeader;

    use super::super::{LogReader, Order, Selection};

    /// Makes a log of chunks that overlap: each has an early message and one from the far future.
    fn far_reaching_chunks() -> Vec<u8> {
        let mut writer = WriteOptions::new().compression(None).create(Cursor::new(Vec::new())).unwrap();
        let channel = writer.add_channel(0, "/a", "cdr", &BTreeMap::new()).unwrap();
        for i in 0..20 {
            for log_time in [i, 1000 - i] {
                let header = MessageHeader { channel_id: channel, sequence: 0, log_time, publish_time: 0 };
                writer.write_to_known_channel(&header, &[0; 100]).unwrap();
            }
            writer.flush().unwrap();
        }
        writer.finish().unwrap();
        writer.into_inner().into_inner()
    }

    #[test]
    fn order_gives_way_before_memory_does() {
        let log = far_reaching_chunks();
        for (limit, ordered) in [(usize::MAX, true), (1000, false)] {
            let mut reader = LogReader::open(Cursor::new(&log), Selection::All).unwrap();
            let Order::LogTime(order) = &mut reader.order else { panic!("not indexed") };
            order.max_open_bytes = limit;
            let mut max_open = 0;
            let mut times = Vec::new();
            while let Some(message) = reader.next() {
                times.push(message.unwrap().log_time_ns);
                let Order::LogTime(order) = &reader.order else { panic!("not indexed") };
                max_open = max_open.max(order.open.len());
            }
            assert_eq!(times.is_sorted(), ordered);
            assert_eq!(reader.damage().out_of_order == 0, ordered);
            assert!(ordered || max_open < 8, "{max_open}");
            times.sort_unstable();
            assert_eq!(times, (0..20).chain(981..1001).collect::<Vec<i64>>());
        }
    }
}
