//! One topic with several types or definitions: each keeps its own.

use std::sync::Arc;

use realitysim::ros2::{Channel, LogMessage};

use super::support::{IMAGE, IMU, ODOMETRY, Room, assert_same, on, read_capture, segments, walk};

/// Beside each message of a topic another one on the same topic, which no program of ours knows.
fn with_strangers(topic: &str, change: impl Fn(&mut Channel)) -> Vec<LogMessage> {
    let mut messages = Vec::new();
    for message in &walk().messages {
        messages.push(message.clone());
        if message.channel.topic == topic {
            let mut channel = message.channel.as_ref().clone();
            channel.id += 100;
            change(&mut channel);
            messages.push(LogMessage {
                channel: Arc::new(channel),
                data: b"\0\x01\0\0stranger".to_vec(),
                ..message.clone()
            });
        }
    }
    messages
}

fn stranger(channel: &mut Channel) {
    channel.type_name = "acme_msgs/msg/Stranger".to_owned();
    channel.definition = b"uint8[8] text\n".as_slice().into();
}

#[test]
fn two_types_on_one_topic_keep_their_names_definitions_and_counts() {
    for topic in [IMAGE, IMU, ODOMETRY] {
        let messages = with_strangers(topic, stranger);
        let room = Room::with_log(&messages);
        let replayed = room.replay("log.mcap --set recording.segment_s=2");
        assert_eq!(replayed.run.code, Some(0), "{topic}: {:?}", replayed.run);
        assert_same(&replayed.tags, &walk().tags, topic);
        assert_eq!(replayed.count("frames"), walk().frames(), "{topic}: what is no image is no frame");
        assert!(segments(&replayed.session).len() > 1);
        let capture = read_capture(&replayed.session);
        let kinds = |messages: &[LogMessage]| -> Vec<(String, Arc<[u8]>, Vec<u8>)> {
            on(messages, topic)
                .map(|m| (m.channel.type_name.clone(), m.channel.definition.clone(), m.data.clone()))
                .collect()
        };
        assert!(kinds(&capture) == kinds(&messages), "{topic}");
        let yaml = std::fs::read_to_string(replayed.session.join("metadata.yaml")).unwrap();
        let entry = format!("name: \"{topic}\"\n        type: \"acme_msgs/msg/Stranger\"");
        assert!(yaml.contains(&entry), "{yaml}");
    }
}

#[test]
fn another_definition_or_encoding_of_the_same_type_is_kept_as_well() {
    let changes: [fn(&mut Channel); 2] = [
        |channel| channel.definition = b"# as another program writes it\n".as_slice().into(),
        |channel| channel.message_encoding = "json".to_owned(),
    ];
    for change in changes {
        let messages = with_strangers("/initialpose", change);
        let room = Room::with_log(&messages);
        let capture = read_capture(&room.replay("log.mcap").session);
        let kinds = |messages: &[LogMessage]| -> Vec<(String, Arc<[u8]>)> {
            on(messages, "/initialpose")
                .map(|m| (m.channel.message_encoding.clone(), m.channel.definition.clone()))
                .collect()
        };
        assert_eq!(kinds(&capture), kinds(&messages));
    }
}
