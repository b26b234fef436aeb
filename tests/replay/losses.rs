//! Damaged and incomplete captures and logs: what is left is used, what is lost is named, and the exit code is 3.

use std::fs;
use std::path::Path;

use mcap::WriteOptions;
use realitysim::ros2::messages::{CompressedImage, FrameTag, Image};
use realitysim::ros2::{LogMessage, Message};
use serde_json::Value;

use super::support::{
    IMAGE, Room, TAG, decode_all, foreign_log, message, on, own_log, read_capture, segments, session_name, walk,
};

const PARTS: &str = "log.mcap --set recording.segment_s=1";

/// A capture in parts, and its path as the program is given it.
fn in_parts() -> (Room, String) {
    let room = Room::with_walk();
    let session = session_name(&room.replay(PARTS));
    (room, session)
}

/// The bytes of a file, changed.
fn edit(path: &Path, change: impl FnOnce(&mut Vec<u8>)) {
    let mut bytes = fs::read(path).unwrap();
    change(&mut bytes);
    fs::write(path, bytes).unwrap();
}

/// Flips a bit in the middle of a file's middle image.
fn flip_in_an_image(path: &Path) {
    let messages = super::support::read_log(path);
    let image = on(&messages, IMAGE).nth(on(&messages, IMAGE).count() / 2).unwrap();
    let inside = &image.data[image.data.len() / 2..][..64];
    edit(path, |bytes| {
        let place = bytes.windows(64).position(|window| window == inside).unwrap();
        bytes[place] ^= 0x10;
    });
}

/// Every command that reads captures says these words, ends with 3, and uses what is left.
fn assert_told(room: &Room, session: &str, words: &[&str]) {
    let frames = walk().frames();
    let judged = room.run(&format!("eval {session} --truth log.mcap --json")).fails(3, words).json();
    let left = judged["frames"].as_u64().unwrap() as usize;
    assert!(left > 0 && left < frames, "{judged}");
    assert!(judged["position_cm"]["mean"].as_f64().unwrap() < 10.0, "{judged}");
    assert!(!judged["lost"].as_array().unwrap().is_empty(), "{judged}");
    let tum = room.run(&format!("export {session} --to tum -o tags.tum --json")).fails(3, words).json();
    assert!(tum["written"].as_u64().unwrap() > 0 && !tum["lost"].as_array().unwrap().is_empty(), "{tum}");
    let images = room.run(&format!("export {session} --to images -o frames --json")).fails(3, words).json();
    let written = images["written"].as_u64().unwrap() as usize;
    assert!(written > 0 && written <= left, "{images}");
    assert!(!images["lost"].as_array().unwrap().is_empty(), "{images}");
    assert_rows_fit_their_images(room, "frames");
    fs::remove_dir_all(room.path("frames")).expect("removable: an export wants a folder of its own");
    let info = room.run(&format!("log info {session}"));
    assert_eq!(info.code, Some(3), "{info:?}");
    // There the file's name stands in a line of its own.
    for word in words.iter().flat_map(|words| words.splitn(2, ": ")) {
        assert!(info.stdout.contains(word), "{word:?} is missing: {info:?}");
    }
}

/// Each row's file is the source's image of that stamp.
fn assert_rows_fit_their_images(room: &Room, folder: &str) {
    let images: Vec<CompressedImage> = decode_all(&walk().messages, IMAGE);
    let rows = fs::read_to_string(room.path(folder).join("tags.jsonl")).unwrap();
    for row in rows.lines().map(|line| serde_json::from_str::<Value>(line).unwrap()) {
        let of_stamp = |image: &&CompressedImage| row["stamp_ns"] == image.header.stamp.to_nanoseconds();
        let file = fs::read(room.path(folder).join(row["file"].as_str().unwrap())).unwrap();
        assert!(images.iter().find(of_stamp).unwrap().data == file, "{row}");
    }
}

#[test]
fn a_flipped_bit_in_a_segment_is_told() {
    let (room, session) = in_parts();
    flip_in_an_image(&segments(&room.path(&session))[1]);
    assert_told(&room, &session, &["0001.mcap: damaged: 1 bad chunk", "checksum"]);
}

#[test]
fn a_torn_segment_is_told() {
    let (room, session) = in_parts();
    edit(&segments(&room.path(&session))[1], |bytes| bytes.truncate(bytes.len() / 2));
    assert_told(&room, &session, &["0001.mcap", "its end is missing", "manifest.jsonl says"]);
}

#[test]
fn a_segment_that_is_gone_is_told() {
    let (room, session) = in_parts();
    fs::remove_file(&segments(&room.path(&session))[1]).unwrap();
    assert_told(&room, &session, &["0001.mcap: missing: manifest.jsonl lists it with", "frames"]);
    // One that is looked at alone is whole.
    room.run(&format!("log info {session}/0000.mcap")).succeeds();
    room.run(&format!("eval {session}/0000.mcap --truth log.mcap")).succeeds();
}

/// As a killed agent leaves it: no line in the manifest, and the file's end still in memory.
#[test]
fn a_segment_that_was_never_finished_is_told() {
    let (room, session) = in_parts();
    let last = segments(&room.path(&session)).pop().unwrap();
    edit(&last, |bytes| bytes.truncate(bytes.len() / 2));
    fs::rename(&last, last.with_extension("mcap.active")).unwrap();
    edit(&room.path(&session).join("manifest.jsonl"), |text| {
        let lines = text.iter().filter(|byte| **byte == b'\n').count();
        *text = text.split_inclusive(|byte| *byte == b'\n').take(lines - 1).flatten().copied().collect();
    });
    let name = format!("{}.active: never finished: its end is missing", last.file_name().unwrap().display());
    assert_told(&room, &session, &[&name]);
    // Killed before the first byte of the next one was on disk.
    fs::write(room.path(&session).join("0009.mcap.active"), "").unwrap();
    assert_told(
        &room,
        &session,
        &[&name, "0009.mcap.active: never finished: its end is missing (found an empty file)"],
    );
    let replayed = room.replay(&session);
    assert_eq!(replayed.run.code, Some(3));
}

#[test]
fn nothing_left_is_a_failure_that_says_why() {
    let (room, session) = in_parts();
    for segment in &segments(&room.path(&session)) {
        edit(segment, |bytes| bytes.truncate(40));
    }
    let words = ["/frame_tag", "0000.mcap", "its end is missing"];
    room.run(&format!("eval {session} --truth log.mcap")).fails(1, &words);
    room.run(&format!("export {session} --to images -o frames")).fails(1, &words);
}

#[test]
fn a_damaged_truth_is_told() {
    let (room, session) = in_parts();
    room.write("torn.mcap", &walk().log[..walk().log.len() - 1000]);
    room.run(&format!("eval {session} --truth torn.mcap")).fails(3, &["torn.mcap: damaged: its end is missing"]);
}

#[test]
fn one_lost_image_costs_its_own_row_only() {
    let room = Room::with_walk();
    let mut messages = read_capture(&room.replay("log.mcap").session);
    let place = messages.iter().position(|message| message.channel.topic == IMAGE).unwrap();
    messages.remove(place);
    room.write("part.mcap", own_log(&messages));
    let run = room.run("export part.mcap --to images -o frames --json");
    let report = run.fails(3, &["part.mcap: 1 of", "tags have no image on", IMAGE]).json();
    assert_eq!(report["written"], walk().frames() - 1);
    assert_rows_fit_their_images(&room, "frames");
    room.write("none.mcap", own_log(&on(&messages, TAG).cloned().collect::<Vec<_>>()));
    room.run("export none.mcap --to images -o none").fails(1, &["none.mcap", "no single topic of images"]);
}

#[test]
fn a_frame_that_does_not_decode_costs_its_own_row_only() {
    let room = Room::with_walk();
    let mut messages = read_capture(&room.replay("log.mcap").session);
    let frames = messages.iter_mut().filter(|message| message.channel.topic == IMAGE);
    for (number, old) in frames.enumerate() {
        let header = CompressedImage::decode(&old.data).unwrap().header;
        let encoding = if number == 3 { "odd" } else { "mono8" }.to_owned();
        let image = Image { header, width: 2, height: 2, encoding, is_bigendian: 0, step: 2, data: vec![9; 4] };
        *old = message(900, "/camera/image_raw", old.log_time_ns, &image);
    }
    room.write("raw.mcap", own_log(&messages));
    let run = room.run("export raw.mcap --to images -o frames --json");
    let words = ["raw.mcap: 1 frames on /camera/image_raw do not decode", "frame 3", "\"odd\""];
    assert_eq!(run.fails(3, &words).json()["written"], walk().frames() - 1);
}

#[test]
fn info_checks_what_the_index_leads_to() {
    let options = || WriteOptions::new().profile("ros2").chunk_size(Some(1 << 15)).compression(None);
    let room = Room::new();
    room.write("flipped.mcap", foreign_log(options(), &walk().messages));
    flip_in_an_image(&room.path("flipped.mcap"));
    let info = room.run("log info flipped.mcap").fails(3, &[]);
    assert!(info.stdout.contains("damaged: 1 bad chunk") && info.stdout.contains("checksum"), "{info:?}");
    let json = room.run("log info flipped.mcap --json").fails(3, &[]).json();
    assert_eq!((&json["checked"], &json["files"][0]["bad_chunks"]), (&Value::Bool(true), &Value::from(1)));
    assert!(json["messages"].as_u64().unwrap() < walk().messages.len() as u64, "what can be read is counted");
    let quick = room.run("log info flipped.mcap --quick").succeeds();
    assert!(quick.stdout.contains("messages were not checked"), "it says what it did not do: {quick:?}");
    let json = room.run("log info flipped.mcap --quick --json").succeeds().json();
    assert_eq!((&json["checked"], &json["files"][0]["chunks_without_checksum"]), (&Value::Bool(false), &Value::Null));

    room.write("bare.mcap", foreign_log(options().calculate_chunk_crcs(false), &walk().messages));
    let bare = room.run("log info bare.mcap").succeeds();
    assert!(bare.stdout.contains("of its chunks have no checksum"), "{bare:?}");
    room.write("loose.mcap", foreign_log(options().use_chunks(false), &walk().messages));
    let loose = room.run("log info loose.mcap").succeeds();
    assert!(loose.stdout.contains("no chunks, and so no checksums"), "{loose:?}");
}

#[test]
fn info_checks_attachments() {
    let (room, session) = in_parts();
    edit(&segments(&room.path(&session))[1], |bytes| {
        let place = bytes.windows(8).position(|window| window == b"RSIMCKPT").unwrap();
        bytes[place + 200] ^= 4;
    });
    let info = room.run(&format!("log info {session}")).fails(3, &[]);
    assert!(info.stdout.contains("attachment \"filter_state\": expected the checksum"), "{info:?}");
}

#[test]
fn tags_of_another_version_are_named() {
    let room = Room::with_walk();
    let mut messages: Vec<LogMessage> = read_capture(&room.replay("log.mcap").session);
    messages.iter_mut().filter(|message| message.channel.topic == TAG).for_each(|message| message.data.truncate(30));
    assert!(FrameTag::decode(&on(&messages, TAG).next().unwrap().data).is_err());
    room.write("old.mcap", own_log(&messages));
    room.run("eval old.mcap --truth log.mcap").fails(1, &["old.mcap", TAG]);
}
