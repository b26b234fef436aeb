//! Reading by the index: in the order of log times, across chunks that overlap.

use std::io::{Read, Seek};

use mcap::records::{ChunkIndex, op};

use super::channels::Channels;
use super::chunk::{Chunk, MAX_CHUNK_BYTES, Placed};
use super::error::{Damage, ReadError};
use super::source::{RECORD_HEAD_BYTES, Source};
use super::unpacking::Unpacking;

/// How much of overlapping chunks to hold. Beyond that, order gives way: no message is lost.
const MAX_OPEN_BYTES: usize = 384 << 20;

pub(super) struct IndexOrder {
    /// By the log time of their first message, the next one last.
    waiting: Vec<ChunkIndex>,
    open: Vec<(u64, Chunk)>,
    last_log_time: u64,
    max_open_bytes: usize,
    unpacking: Unpacking,
}

impl IndexOrder {
    pub fn new(mut chunks: Vec<ChunkIndex>, channels: &Channels) -> Self {
        chunks.retain(|chunk| {
            let mut ids = chunk.message_index_offsets.keys();
            // Without message indexes, a chunk may hold anything; an unknown channel may be defined in the chunk.
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

    pub fn next<R: Read + Seek>(
        &mut self,
        source: &mut Source<R>,
        channels: &mut Channels,
        damage: &mut Damage,
    ) -> Result<Option<Placed>, ReadError> {
        loop {
            let earliest = self.earliest();
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

    /// Log time, chunk offset and place of the open chunk whose turn it is.
    fn earliest(&mut self) -> Option<(u64, u64, usize)> {
        self.open.retain(|(_, chunk)| chunk.log_time().is_some());
        let heads = self.open.iter().enumerate();
        heads.filter_map(|(i, (offset, chunk))| Some((chunk.log_time()?, *offset, i))).min()
    }
}

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

    /// Chunks of two messages each: one of its own time, one from the far future.
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
            let mut most = 0;
            let mut times = Vec::new();
            while let Some(message) = reader.next() {
                times.push(message.unwrap().log_time_ns);
                let Order::LogTime(order) = &reader.order else { panic!("not indexed") };
                most = most.max(order.open.len());
            }
            assert_eq!(times.is_sorted(), ordered);
            assert_eq!(reader.damage().out_of_order == 0, ordered);
            assert!(ordered || most < 8, "{most}");
            times.sort_unstable();
            assert_eq!(times, (0..20).chain(981..1001).collect::<Vec<i64>>());
        }
    }
}
