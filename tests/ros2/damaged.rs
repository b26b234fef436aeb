//! Torn and damaged logs: no panic, nothing wrong is delivered, everything that is lost is told.

use std::io::Cursor;

use mcap::{Compression, WriteOptions};
use proptest::prelude::*;
use realitysim::ros2::messages::CompressedImage;
use realitysim::ros2::{
    Durability, LogMessage, LogReader, LogWriter, Message, ReadError, Selection, attachments, examine, survey,
};

use super::samples::{START_NS, compressed_image, read_all, small_log};

/// The small log in another packing.
fn repacked(options: WriteOptions) -> Vec<u8> {
    let (messages, _) = read_all(&small_log(), Selection::All);
    let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
    for message in &messages {
        let channel = &message.channel;
        let schema = writer.add_schema(&channel.type_name, &channel.schema_encoding, &channel.definition).unwrap();
        let id = writer.add_channel(schema, &channel.topic, &channel.message_encoding, &channel.metadata).unwrap();
        let header = mcap::records::MessageHeader {
            channel_id: id,
            sequence: message.sequence,
            log_time: message.log_time_ns as u64,
            publish_time: message.publish_time_ns as u64,
        };
        writer.write_to_known_channel(&header, &message.data).unwrap();
        if message.sequence % 2 == 1 {
            writer.flush().unwrap();
        }
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

pub fn variants() -> Vec<(&'static str, Vec<u8>)> {
    let options = WriteOptions::new;
    vec![
        ("own", small_log()),
        ("zstd", repacked(options().compression(Some(Compression::Zstd)).compression_threads(0))),
        ("lz4", repacked(options().compression(Some(Compression::Lz4)))),
        ("unindexed", repacked(options().compression(None).emit_chunk_indexes(false))),
    ]
}

/// Is every message one of the whole log, in order, none twice?
fn is_part_of(found: &[LogMessage], whole: &[LogMessage]) -> bool {
    let mut rest = whole.iter();
    found.iter().all(|message| {
        rest.any(|other| {
            (message.sequence, message.log_time_ns, message.publish_time_ns, &message.data)
                == (other.sequence, other.log_time_ns, other.publish_time_ns, &other.data)
                && message.channel.topic == other.channel.topic
                && message.channel.type_name == other.channel.type_name
        })
    })
}

#[test]
fn cut_at_every_byte() {
    for (name, log) in variants() {
        let (whole, _) = read_all(&log, Selection::All);
        assert_eq!(whole.len(), 6, "{name}");
        let mut most = 0;
        for cut in 0..log.len() {
            let part = &log[..cut];
            if cut == 0 {
                assert!(matches!(LogReader::open(Cursor::new(part), Selection::All), Err(ReadError::NotMcap { .. })));
                continue;
            }
            let (found, damage) = read_all(part, Selection::All);
            assert!(damage.torn, "{name} cut at {cut}");
            assert!(found.len() >= most, "{name} cut at {cut}");
            assert_eq!(found, whole[..found.len()], "{name} cut at {cut}");
            assert_eq!(damage.bad_chunks + damage.bad_records + damage.orphan_messages, 0, "{name} cut at {cut}");
            assert!(damage.bytes_skipped < cut as u64);
            most = found.len();
            assert!(examine(Cursor::new(part)).unwrap().damage.torn, "{name} cut at {cut}");
            let seen = survey(Cursor::new(part)).unwrap();
            assert_eq!(seen.topics.iter().map(|topic| topic.messages).sum::<u64>(), most as u64);
            assert!(attachments(Cursor::new(part)).unwrap().list.len() <= 1);
        }
        assert_eq!(most, 6);
    }
}

#[test]
fn one_bit_flipped_anywhere() {
    for (name, log) in variants() {
        let (whole, _) = read_all(&log, Selection::All);
        let whole_attachments = attachments(Cursor::new(&log)).unwrap().list;
        let mut flipped = log.clone();
        for (byte, bit) in (0..log.len()).flat_map(|byte| (0..8).map(move |bit| (byte, 1 << bit))) {
            flipped[byte] ^= bit;
            let reader = LogReader::open(Cursor::new(&flipped), Selection::All);
            if byte < 8 {
                assert!(matches!(reader, Err(ReadError::NotMcap { .. })));
            } else {
                let (found, damage) = read_all(&flipped, Selection::All);
                assert!(is_part_of(&found, &whole), "{name}: byte {byte} bit {bit}: {damage:?}");
                assert!(
                    found.len() == whole.len() || !damage.is_none(),
                    "{name}: byte {byte} bit {bit} lost messages in silence"
                );
                survey(Cursor::new(&flipped)).unwrap();
                let whole_by_eye = examine(Cursor::new(&flipped)).unwrap().damage.is_none();
                let attached = attachments(Cursor::new(&flipped)).unwrap().list;
                assert!(
                    !whole_by_eye || (found.len() == whole.len() && attached == whole_attachments),
                    "{name}: byte {byte} bit {bit} is not noticed by an examination"
                );
                for attachment in attached {
                    assert!(whole_attachments.contains(&attachment), "{name}: byte {byte}");
                }
            }
            flipped[byte] ^= bit;
        }
    }
}

#[test]
fn a_damaged_chunk_costs_only_its_own_messages() {
    for (name, log) in variants() {
        let chunk = log.windows(9).enumerate().filter(|(_, w)| w[0] == 6 && w[3..] == [0; 6]).nth(2).unwrap().0;
        let mut damaged = log.clone();
        damaged[chunk + 60] ^= 0x10;
        let (found, damage) = read_all(&damaged, Selection::All);
        assert_eq!(damage.bad_chunks, 1, "{name}: {damage:?}");
        assert_eq!(found.len(), 4, "{name}: {damage:?}");
        assert!(damage.bytes_skipped > 50 && damage.first_error.unwrap().starts_with("chunk at byte"));
    }
}

#[test]
fn a_wrong_length_before_the_chunks_costs_none_of_them() {
    for (name, mut log) in variants() {
        // Without its index: the header's length then leads into the middle of something, or out of the file.
        log.truncate(log.len() - 8);
        for byte in 9..17 {
            for bit in 0..8 {
                log[byte] ^= 1 << bit;
                let (found, damage) = read_all(&log, Selection::All);
                assert!(found.len() == 6 && !damage.is_none(), "{name}: byte {byte} bit {bit}: {damage:?}");
                assert!(damage.bytes_skipped < log.len() as u64, "{name}: byte {byte} bit {bit}: {damage:?}");
                log[byte] ^= 1 << bit;
            }
        }
    }
}

/// What was read of it, in bytes.
struct Counting<'a>(Cursor<&'a [u8]>, &'a std::cell::Cell<u64>);

impl std::io::Read for Counting<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let read = self.0.read(buffer)?;
        self.1.set(self.1.get() + read as u64);
        Ok(read)
    }
}

impl std::io::Seek for Counting<'_> {
    fn seek(&mut self, to: std::io::SeekFrom) -> std::io::Result<u64> {
        self.0.seek(to)
    }
}

#[test]
fn false_chunks_that_span_to_the_end_of_a_file_cost_bounded_reading() {
    const FAKES: u64 = 5_000;
    const EACH: u64 = 49;
    let mut log = LogWriter::new(Vec::new()).unwrap().finish().unwrap();
    // Magic and header.
    log.truncate(17 + usize::from(log[9]));
    let length = log.len() as u64 + FAKES * EACH + 1;
    for _ in 0..FAKES {
        let body = length - 1 - log.len() as u64 - 9;
        log.push(6);
        log.extend(body.to_le_bytes());
        log.extend([0; 24]);
        // A checksum that nothing has.
        log.extend(1u32.to_le_bytes());
        log.extend(0u32.to_le_bytes());
        log.extend((body - 40).to_le_bytes());
    }
    log.push(0);
    let read = std::cell::Cell::new(0);
    let reader = LogReader::open(Counting(Cursor::new(&log), &read), Selection::All).unwrap();
    assert_eq!(reader.count(), 0);
    assert!(read.get() < 200 * length, "{} times", read.get() / length);
}

#[test]
fn our_definitions_stand_apart_from_our_messages() {
    let mut writer = LogWriter::new(Vec::new()).unwrap();
    let channel = writer.add_channel::<CompressedImage>("/image", Durability::Volatile).unwrap();
    let mut ends = Vec::new();
    for sequence in 0..2 {
        writer.write(channel, sequence, START_NS, START_NS, &compressed_image(500).encode()).unwrap();
        writer.flush_chunk().unwrap();
        ends.push(writer.bytes_written() as usize);
    }
    let mut log = writer.finish().unwrap();
    log.truncate(ends[1]);
    // In the middle of the first message.
    log[ends[0] - 300] ^= 1;
    let (found, damage) = read_all(&log, Selection::All);
    assert_eq!(found.iter().map(|message| message.sequence).collect::<Vec<_>>(), [1]);
    assert_eq!((damage.bad_chunks, damage.orphan_messages, damage.torn), (1, 0, true));
}

/// Without checksums a flipped bit can go unseen, but it must not do harm.
fn unchecked_variants() -> Vec<(&'static str, Vec<u8>)> {
    let options = || WriteOptions::new().calculate_chunk_crcs(false).calculate_summary_section_crc(false);
    vec![
        ("plain", repacked(options().compression(None))),
        ("zstd", repacked(options().compression(Some(Compression::Zstd)).compression_threads(0))),
        ("lz4", repacked(options().compression(Some(Compression::Lz4)))),
        ("unindexed", repacked(options().compression(None).emit_chunk_indexes(false))),
        ("no chunks", repacked(options().use_chunks(false))),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn damage_all_over(
        which in 0usize..9,
        cut in prop::option::of(any::<prop::sample::Index>()),
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..12),
    ) {
        let checked = variants();
        let is_checked = which < checked.len();
        let mut logs = checked.into_iter().chain(unchecked_variants());
        let (name, mut log) = logs.nth(which).unwrap();
        let (whole, _) = read_all(&log, Selection::All);
        let attached = attachments(Cursor::new(&log)).unwrap().list;
        for (place, value) in damage {
            let place = 8 + place.index(log.len() - 8);
            log[place] = value;
        }
        if let Some(cut) = cut {
            log.truncate(8 + cut.index(log.len() - 8));
        }
        let (found, _) = read_all(&log, Selection::All);
        prop_assert!(!is_checked || is_part_of(&found, &whole), "{name}");
        survey(Cursor::new(&log)).unwrap();
        examine(Cursor::new(&log)).unwrap();
        let found = attachments(Cursor::new(&log)).unwrap();
        prop_assert!(!is_checked || found.list.iter().all(|attachment| attached.contains(attachment)));
    }
}

#[test]
fn a_tail_of_zeros() {
    let log = small_log();
    let mut zeroed = log[..log.len() / 2].to_vec();
    zeroed.resize(log.len(), 0);
    let (found, damage) = read_all(&zeroed, Selection::All);
    assert!(damage.torn && damage.bytes_skipped > 0);
    let (cut, _) = read_all(&log[..log.len() / 2], Selection::All);
    assert!(found.len() <= cut.len());
}

#[test]
fn random_bytes_behind_a_magic() {
    let mut state = 1u64;
    for length in 0..3000 {
        let mut bytes = b"\x89MCAP0\r\n".to_vec();
        for _ in 0..length % 300 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let byte = (state >> 56) as u8;
            // Small numbers make records that go on for longer.
            bytes.push(if state & 0x300_0000 == 0 { byte } else { byte % 12 * u8::from(state & 0x400_0000 == 0) });
        }
        let (found, _) = read_all(&bytes, Selection::All);
        assert!(found.is_empty());
        survey(Cursor::new(&bytes)).unwrap();
        examine(Cursor::new(&bytes)).unwrap();
        attachments(Cursor::new(&bytes)).unwrap();
    }
}
