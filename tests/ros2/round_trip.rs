//! What is written is read.

use std::collections::BTreeMap;
use std::io::{self, Cursor, Write};
use std::sync::{Arc, Mutex};

use realitysim::ros2::messages::{CompressedImage, FrameTag};
use realitysim::ros2::{
    Durability, LogReader, LogWriter, Message, RawChannel, Selection, attachments, examine, survey,
};

use super::samples::{START_NS, compressed_image, every_message, read_all};

#[test]
fn every_message_comes_back() {
    let (log, written) = every_message();
    let (messages, damage) = read_all(&log, Selection::All);
    assert!(damage.is_none(), "{damage:?}");
    assert_eq!(messages.len(), written.len());
    for (i, (message, written)) in messages.iter().zip(&written).enumerate() {
        assert_eq!(message.channel.topic, written["topic"]);
        assert_eq!(message.channel.type_name, written["type"]);
        assert_eq!(message.log_time_ns, written["log_time"]);
        assert_eq!(message.publish_time_ns, message.log_time_ns - 5);
        assert_eq!(message.sequence, i as u32);
        assert!(message.channel.is_ros2());
        assert_eq!(message.channel.is_latched(), i < 2, "{}", message.channel.topic);
    }
    let tag = messages.iter().find(|message| message.channel.topic == "/frame_tag").unwrap();
    assert_eq!(tag.channel.definition.as_ref(), FrameTag::DEFINITION.as_bytes());
    let decoded = FrameTag::decode(&tag.data).unwrap();
    let expected = written.iter().find(|written| written["topic"] == "/frame_tag").unwrap();
    assert_eq!(serde_json::to_value(decoded).unwrap(), expected["fields"]);
}

#[test]
fn golden_bytes_of_a_log() {
    let log = LogWriter::new(Vec::new()).unwrap().finish().unwrap();
    let head =
        [&b"\x89MCAP0\r\n"[..], b"\x01\x16\0\0\0\0\0\0\0\x04\0\0\0ros2\x0a\0\0\0realitysim", b"\x0f\x04\0\0\0\0\0\0\0"]
            .concat();
    assert_eq!(log[..head.len()], head);
    assert!(log.ends_with(b"\x89MCAP0\r\n"));
    let (messages, damage) = read_all(&log, Selection::All);
    assert!(messages.is_empty() && damage.is_none());
}

#[test]
fn quality_of_service_as_rosbag2_writes_it() {
    let mut writer = LogWriter::new(Vec::new()).unwrap();
    let channel = writer.add_channel::<FrameTag>("/tag", Durability::TransientLocal).unwrap();
    writer.write(channel, 0, 0, 0, &FrameTag::default().encode()).unwrap();
    let (messages, _) = read_all(&writer.finish().unwrap(), Selection::All);
    let expected = "\
- history: 1
  depth: 1
  reliability: 1
  durability: 1
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: 1
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false";
    assert_eq!(messages[0].channel.metadata["offered_qos_profiles"], expected);
}

#[test]
fn selected_topics_only() {
    let (log, _) = every_message();
    let (messages, damage) = read_all(&log, Selection::topics(["/diagnostics", "/absent"]));
    assert!(damage.is_none());
    assert_eq!(messages.len(), 2);
    assert!(messages.iter().all(|message| message.channel.topic == "/diagnostics"));
    let (none, _) = read_all(&log, Selection::topics(["/absent"]));
    assert!(none.is_empty());
}

#[test]
fn a_survey_tells_what_is_there() {
    let (log, written) = every_message();
    let found = survey(Cursor::new(&log)).unwrap();
    assert!(found.indexed && found.damage.is_none(), "{:?}", found.damage);
    assert_eq!(found.attachments, ["session.toml"]);
    let [session] = found.metadata.as_slice() else { panic!("{found:?}") };
    assert_eq!((session.name.as_str(), session.values["field"].as_str()), ("session", "kid"));
    assert_eq!(found.compressions.iter().collect::<Vec<_>>(), ["none"]);
    assert_eq!(found.topics.iter().map(|topic| topic.messages).sum::<u64>(), written.len() as u64);
    let diagnostics = found.topics.iter().find(|topic| topic.topic == "/diagnostics").unwrap();
    assert_eq!(diagnostics.type_name, "diagnostic_msgs/msg/DiagnosticArray");
    assert_eq!(diagnostics.messages, 2);
    assert_eq!(diagnostics.first_log_time_ns, Some(START_NS + 14_000_000));
    assert_eq!(diagnostics.last_log_time_ns, Some(START_NS + 16_000_000));
    assert_eq!(found.topics.iter().filter(|topic| topic.latched).count(), 2);
    assert_eq!(examine(Cursor::new(&log)).unwrap(), found, "the index tells the truth");
    // Without the summary, everything is found by reading all of it.
    let torn = survey(Cursor::new(&log[..log.len() - 1])).unwrap();
    assert!(torn.damage.torn && !torn.indexed);
    assert_eq!((&torn.topics, &torn.attachments), (&found.topics, &found.attachments));
    assert_eq!((&torn.metadata, &torn.compressions), (&found.metadata, &found.compressions));
}

#[test]
fn attachments_come_back_from_torn_logs_too() {
    let (log, _) = every_message();
    for end in [log.len(), log.len() / 2] {
        let found = attachments(Cursor::new(&log[..end])).unwrap();
        assert_eq!(found.damage.torn, end < log.len());
        let [attachment] = found.list.as_slice() else { panic!("{found:?}") };
        assert_eq!(attachment.name, "session.toml");
        assert_eq!(attachment.media_type, "application/toml");
        assert_eq!(attachment.data, b"[camera]\n");
        assert_eq!(attachment.log_time_ns, START_NS);
    }
}

#[test]
fn what_was_flushed_is_in_the_file() {
    let mut writer = LogWriter::new(Vec::new()).unwrap();
    let channel = writer.add_channel::<CompressedImage>("/image", Durability::Volatile).unwrap();
    assert_eq!(writer.add_channel::<CompressedImage>("/image", Durability::Volatile).unwrap(), channel);
    writer.write(channel, 1, START_NS, START_NS, &compressed_image(5).encode()).unwrap();
    let before = writer.bytes_written();
    writer.flush_chunk().unwrap();
    let flushed = writer.bytes_written();
    assert!(flushed > before + 5);
    writer.write(channel, 2, START_NS, START_NS, &compressed_image(5).encode()).unwrap();
    assert_eq!(writer.bytes_written(), flushed);
    let log = writer.finish().unwrap();
    let (messages, damage) = read_all(&log[..flushed as usize], Selection::All);
    assert_eq!(messages.len(), 1);
    assert!(damage.torn);
    assert_eq!((damage.bytes_skipped, damage.first_error), (0, None));
}

#[test]
fn other_encodings_are_passed_on_and_named() {
    let metadata = BTreeMap::from([("k".to_owned(), "v".to_owned())]);
    let json = RawChannel {
        topic: "/note",
        type_name: "Note",
        message_encoding: "json",
        schema_encoding: "jsonschema",
        definition: b"{}",
        metadata: &metadata,
    };
    let bare = RawChannel { topic: "/bare", type_name: "", schema_encoding: "", definition: b"", ..json };
    let mut writer = LogWriter::new(Vec::new()).unwrap();
    for (sequence, channel) in [json, bare].iter().enumerate() {
        let id = writer.add_raw_channel(channel).unwrap();
        writer.write(id, sequence as u32, -1, 1, b"{\"a\": 1}").unwrap();
    }
    let (messages, damage) = read_all(&writer.finish().unwrap(), Selection::All);
    assert!(damage.is_none());
    assert_eq!(messages[0].channel.schema_encoding, "jsonschema");
    assert_eq!(messages[0].channel.metadata, metadata);
    assert_eq!((messages[0].log_time_ns, messages[0].publish_time_ns), (0, 1));
    assert_eq!(messages[0].data, b"{\"a\": 1}");
    assert!(!messages[0].channel.is_ros2() && !messages[1].channel.is_ros2());
    assert_eq!(messages[1].channel.type_name, "");
}

/// Takes so many bytes, fails once, and would take more.
#[derive(Clone)]
struct Full {
    taken: Arc<Mutex<Vec<u8>>>,
    room: usize,
}

impl Write for Full {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.room == 0 {
            self.room = usize::MAX;
            return Err(io::ErrorKind::StorageFull.into());
        }
        let taken = bytes.len().min(self.room);
        self.room -= taken;
        self.taken.lock().unwrap().extend(&bytes[..taken]);
        Ok(taken)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_full_disk_is_an_error_and_what_is_there_can_be_read() {
    let image = compressed_image(3000).encode();
    for room in (0..11_000).step_by(37) {
        let disk = Full { taken: Arc::default(), room };
        let Ok(mut writer) = LogWriter::new(disk.clone()) else { continue };
        let mut written = 0;
        let mut run = || {
            writer.attach("a", "b", 0, &[1; 100])?;
            let channel = writer.add_channel::<CompressedImage>("/image", Durability::Volatile)?;
            writer.write(channel, 0, 0, 0, &image)?;
            writer.flush_chunk()?;
            written = 1;
            writer.write(channel, 0, 0, 0, &image)?;
            writer.metadata("m", &BTreeMap::new())?;
            written = 2;
            writer.flush_chunk()
        };
        let first = run();
        let second = writer.flush_chunk();
        assert_eq!(first.is_ok(), second.is_ok());
        if room % 2 == 0 {
            drop(writer);
        } else {
            let finished = writer.finish();
            assert!(first.is_ok() || finished.is_err());
        }
        let log = disk.taken.lock().unwrap();
        assert!(first.is_ok() || log.len() <= room);
        let (messages, damage) = read_all(&log, Selection::All);
        assert!(messages.len() >= written, "room for {room} bytes");
        assert!(messages.iter().all(|message| message.data == image));
        assert_eq!(damage.bad_chunks + damage.bad_records, 0, "room for {room} bytes: {damage:?}");
    }
}

#[test]
fn too_large_an_attachment_is_refused() {
    let mut writer = LogWriter::new(Vec::new()).unwrap();
    let error = writer.attach("a", "b", 0, &vec![0; 64 << 20]).unwrap_err().to_string();
    assert!(error.starts_with("attachment: expected at most 6710"), "{error}");
    writer.flush_chunk().unwrap();
}

#[test]
fn a_reader_can_be_sent_to_another_thread() {
    fn send<T: Send>(_: &T) {}
    let (log, _) = every_message();
    let reader = LogReader::open(Cursor::new(log), Selection::All).unwrap();
    send(&reader);
    assert!(reader.is_indexed());
    assert_eq!(reader.channels().count(), 16);
}
