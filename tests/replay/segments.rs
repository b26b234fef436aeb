//! A capture in parts: each part can be replayed by itself, for it holds the state in which the filter was.

use std::fs;
use std::path::Path;

use realitysim::ros2::messages::FrameTag;
use realitysim::ros2::{LogMessage, LogWriter, attachments};
use realitysim::tagging::checkpoint::VERSION;

use super::support::{CAMERA_INFO, IMAGE, Room, TAG, TF_STATIC, assert_same, decode_all, on, read_log, segments, walk};

const PARTS: &str = "log.mcap --set recording.segment_s=1";

fn name(path: &Path) -> String {
    path.file_name().unwrap().to_str().unwrap().to_owned()
}

fn tags_of(segment: &Path) -> Vec<FrameTag> {
    decode_all(&read_log(segment), TAG)
}

#[test]
fn a_capture_in_parts_has_the_tags_of_one_in_a_piece() {
    let room = Room::with_walk();
    let whole = room.replay(PARTS);
    assert_same(&whole.tags, &walk().tags, "in parts");
    let files = segments(&whole.session);
    let names: Vec<String> = files.iter().map(|path| name(path)).collect();
    assert_eq!(names[..3], ["0000.mcap", "0001.mcap", "0002.mcap"]);
    for (index, file) in files.iter().enumerate() {
        let attached = attachments(fs::File::open(file).unwrap()).unwrap().list;
        let names: Vec<&str> = attached.iter().map(|attachment| attachment.name.as_str()).collect();
        assert_eq!(names, ["filter_state"]);
        let messages = read_log(file);
        for topic in [TF_STATIC, CAMERA_INFO] {
            assert_eq!(on(&messages, topic).count(), 1, "{topic} in part {index}: each part can be read by itself");
        }
    }
}

#[test]
fn a_part_replayed_alone_gives_its_tags_bit_for_bit() {
    let room = Room::with_walk();
    let whole = room.replay(PARTS);
    for file in &segments(&whole.session) {
        room.write("part.mcap", fs::read(file).unwrap());
        let alone = room.replay("part.mcap");
        assert_eq!(alone.run.code, Some(0), "{:?}", alone.run);
        assert_same(&alone.tags, &tags_of(file), &name(file));
        assert!(alone.tags.iter().all(|tag| tag.valid), "no warming up");
    }
}

#[test]
fn calibration_that_comes_with_every_frame_is_repeated_once_in_each_part() {
    // As most camera drivers send it.
    let info = on(&walk().messages, CAMERA_INFO).next().unwrap();
    let mut messages = Vec::new();
    for message in &walk().messages {
        messages.push(message.clone());
        if message.channel.topic == IMAGE {
            messages.push(LogMessage { log_time_ns: message.log_time_ns, ..info.clone() });
        }
    }
    let room = Room::with_log(&messages);
    let whole = room.replay(PARTS);
    assert_same(&whole.tags, &walk().tags, "calibrated again and again");
    for file in &segments(&whole.session)[1..] {
        let messages = read_log(file);
        assert_eq!(on(&messages, CAMERA_INFO).count(), on(&messages, IMAGE).count() + 1, "{}", name(file));
    }
}

#[test]
fn a_state_of_the_filter_that_cannot_be_used_is_told() {
    let room = Room::with_walk();
    let whole = room.replay(PARTS);
    let part = fs::read(&segments(&whole.session)[2]).unwrap();

    let mut flipped = part.clone();
    let magic = part.windows(8).position(|window| window == b"RSIMCKPT").unwrap();
    flipped[magic + 200] ^= 4;
    room.write("flipped.mcap", flipped);
    let frames = tags_of(&segments(&whole.session)[2]).len();
    let told = |log: &str, code: i32, word: &str| {
        let replayed = room.replay(log);
        assert_eq!(replayed.tags.len(), frames, "{log}");
        // Of a start from nothing all tags say that nobody knows which half of the field it is.
        assert!(replayed.tags.iter().all(|tag| !tag.valid || tag.ambiguous), "{log}");
        replayed.run.fails(code, &[log, "filter_state", word, "the filter began without it"]);
    };
    told("flipped.mcap", 3, "damaged");

    let with_state = |state: &[u8]| {
        let mut writer = LogWriter::new(Vec::new()).unwrap();
        writer.attach("filter_state", "application/octet-stream", 0, state).unwrap();
        for message in read_log(&segments(&whole.session)[2]) {
            let id = writer.add_raw_channel(&message.channel.as_ref().into()).unwrap();
            writer.write(id, 0, message.log_time_ns, message.publish_time_ns, &message.data).unwrap();
        }
        room.write("state.mcap", writer.finish().unwrap());
    };
    with_state(b"something else");
    told("state.mcap", 3, "not a checkpoint of this program");
    let of_version = |version: u32| with_state(&[&b"RSIMCKPT"[..], &version.to_le_bytes(), &[0; 20]].concat());
    of_version(VERSION + 1);
    // Of another time, not lost.
    told("state.mcap", 0, &format!("version {}", VERSION + 1));
    of_version(VERSION);
    told("state.mcap", 3, "damaged");
}
