//! Logs as other writers make them.

use std::collections::BTreeMap;
use std::io::Cursor;

use mcap::records::MessageHeader;
use mcap::{Compression, WriteOptions, Writer};
use realitysim::ros2::{LogReader, ReadError, Selection, attachments, survey};

use super::samples::read_all;

/// Message i has log time `times[i]`, its number as data and as sequence number; a chunk ends after every third.
fn log(options: WriteOptions, times: &[u64]) -> Vec<u8> {
    let mut writer = Writer::with_options(Cursor::new(Vec::new()), options).unwrap();
    let schema = writer.add_schema("std_msgs/msg/Empty", "ros2msg", b"").unwrap();
    let ids: Vec<u16> =
        ["/a", "/b"].map(|topic| writer.add_channel(schema, topic, "cdr", &BTreeMap::new()).unwrap()).into();
    for (i, &log_time) in times.iter().enumerate() {
        let sequence = i as u32;
        let header = MessageHeader { channel_id: ids[i % 2], sequence, log_time, publish_time: log_time };
        writer.write_to_known_channel(&header, &[i as u8; 50]).unwrap();
        if i % 3 == 2 {
            writer.flush().unwrap();
        }
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

fn sequences(log: &[u8]) -> Vec<u32> {
    let (messages, damage) = read_all(log, Selection::All);
    assert!(damage.is_none(), "{damage:?}");
    assert!(messages.iter().all(|message| message.data == [message.sequence as u8; 50]));
    messages.iter().map(|message| message.sequence).collect()
}

fn variants() -> Vec<(&'static str, WriteOptions)> {
    let options = WriteOptions::new;
    vec![
        ("zstd", options().compression(Some(Compression::Zstd))),
        ("lz4", options().compression(Some(Compression::Lz4))),
        ("plain", options().compression(None)),
        ("no checksums", options().compression(None).calculate_chunk_crcs(false).calculate_summary_section_crc(false)),
        ("zstd without checksums", options().calculate_chunk_crcs(false).calculate_summary_section_crc(false)),
        ("no message indexes", options().emit_message_indexes(false)),
        ("no chunk indexes", options().emit_chunk_indexes(false)),
        ("no statistics", options().emit_statistics(false)),
        ("no summary", options().emit_summary_records(false).emit_summary_offsets(false)),
        ("no repeated definitions", options().repeat_channels(false).repeat_schemas(false)),
        ("no chunks", options().use_chunks(false)),
    ]
}

#[test]
fn every_kind_of_file_is_read() {
    let times: Vec<u64> = (100..120).collect();
    for (name, options) in variants() {
        let log = log(options, &times);
        assert_eq!(sequences(&log), (0..20).collect::<Vec<u32>>(), "{name}");
        let (b, _) = read_all(&log, Selection::topics(["/b"]));
        assert_eq!(b.iter().map(|message| message.sequence).collect::<Vec<_>>(), [1, 3, 5, 7, 9, 11, 13, 15, 17, 19]);
        let found = survey(Cursor::new(&log)).unwrap();
        assert!(found.damage.is_none(), "{name}: {:?}", found.damage);
        assert_eq!(found.topics.len(), 2, "{name}");
        for (topic, first) in found.topics.iter().zip([100, 101]) {
            assert_eq!(topic.messages, 10, "{name}");
            assert_eq!((topic.first_log_time_ns, topic.last_log_time_ns), (Some(first), Some(first + 18)), "{name}");
        }
        let compression = match name {
            "no chunks" => None,
            "plain" | "no checksums" => Some("none"),
            "lz4" => Some("lz4"),
            _ => Some("zstd"),
        };
        assert_eq!(found.compressions.iter().next().map(String::as_str), compression, "{name}");
    }
}

#[test]
fn log_time_order_across_overlapping_chunks() {
    let times = [5, 1, 9, 4, 2, 9, 3, 30, 0, 9, 9, 6];
    let mut expected: Vec<u32> = (0..12).collect();
    expected.sort_by_key(|&i| times[i as usize]);
    assert_eq!(sequences(&log(WriteOptions::new(), &times)), expected);
    // Without an index, the order is that of the file.
    let unindexed = log(WriteOptions::new().emit_chunk_indexes(false), &times);
    assert_eq!(sequences(&unindexed), (0..12).collect::<Vec<u32>>());
}

#[test]
fn first_and_last_times_of_overlapping_chunks() {
    let times = [5, 1, 9, 4, 2, 9, 3, 30, 0, 9, 9, 6];
    let found = survey(Cursor::new(log(WriteOptions::new(), &times))).unwrap();
    let spans: Vec<_> = found.topics.iter().map(|topic| (topic.first_log_time_ns, topic.last_log_time_ns)).collect();
    assert_eq!(spans, [(Some(0), Some(9)), (Some(1), Some(30))]);
}

#[test]
fn messages_beside_chunks_are_not_forgotten() {
    let chunked = log(WriteOptions::new().compression(None), &[1, 2, 3]);
    // A message record behind the header, where no chunk index leads. Magic and header take 8 + 9 + n bytes.
    let header_end = 17 + u64::from_le_bytes(chunked[9..17].try_into().unwrap()) as usize;
    let mut mixed = chunked[..header_end].to_vec();
    mixed.extend([5, 24, 0, 0, 0, 0, 0, 0, 0, 1, 0, 7, 0, 0, 0]);
    mixed.extend([0; 18]);
    mixed.extend(&chunked[header_end..]);
    let (messages, damage) = read_all(&mixed, Selection::All);
    assert_eq!(messages.len(), 3);
    // The footer's offsets are wrong now, so its summary is; the message comes before its channel is defined.
    assert_eq!(damage.orphan_messages, 1);
}

#[test]
fn unknown_compression_is_damage_with_a_name() {
    let mut log = log(WriteOptions::new().emit_chunk_indexes(false), &[1, 2, 3]);
    let at = log.windows(4).position(|window| window == b"zstd").unwrap();
    log[at..at + 4].copy_from_slice(b"brot");
    let (messages, damage) = read_all(&log, Selection::All);
    assert!(messages.is_empty());
    assert_eq!(damage.bad_chunks, 1);
    assert!(damage.first_error.unwrap().contains("brot"));
}

#[test]
fn files_that_are_no_mcap() {
    let said = |bytes: &[u8]| match LogReader::open(Cursor::new(bytes), Selection::All) {
        Err(error @ ReadError::NotMcap { .. }) => error.to_string(),
        _ => panic!("taken for an MCAP"),
    };
    assert!(said(b"SQLite format 3\0rest").contains("rosbags-convert"));
    assert!(said(b"").contains("an empty file"));
    assert!(matches!(survey(Cursor::new(b"#ROSBAG V2.0\n")), Err(ReadError::NotMcap { .. })));
    assert!(matches!(attachments(Cursor::new(b"\x1f\x8b\x08\0")), Err(ReadError::NotMcap { .. })));
}
