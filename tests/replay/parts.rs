//! A capture that lacks a part is replayed as far as it goes, and says what is missing; none is written into.

use std::fs;
use std::path::PathBuf;

use super::support::{CAPTURES, Room, assert_same, segments, walk};

/// A capture in parts in `parts/session`.
fn capture(room: &Room) -> PathBuf {
    let whole = room.replay("log.mcap --set recording.segment_s=1");
    fs::create_dir(room.path("parts")).unwrap();
    fs::rename(&whole.session, room.path("parts/session")).unwrap();
    room.path("parts/session")
}

#[test]
fn a_segment_that_is_missing_is_named_and_counted() {
    let room = Room::with_walk();
    let session = capture(&room);
    assert_eq!(room.replay("parts/session").report["lost"], serde_json::json!([]));
    fs::remove_file(session.join("0001.mcap")).unwrap();
    let replayed = room.replay("parts/session");
    let losses = replayed.report["lost"].as_array().unwrap();
    assert_eq!(losses.len(), 1, "{losses:?}");
    assert_eq!(losses[0]["file"], "parts/session/0001.mcap");
    assert!(losses[0]["what"].as_str().unwrap().starts_with("missing: "), "{losses:?}");
    let left = replayed.tags.len();
    assert!(0 < left && left < walk().frames());
    replayed.run.fails(3, &["parts/session/0001.mcap: missing", "manifest.jsonl", "frames"]);
    // Each of the others alone lacks nothing.
    assert_eq!(room.replay("parts/session/0002.mcap").run.code, Some(0));
}

#[test]
fn a_segment_of_another_size_is_named() {
    let room = Room::with_walk();
    let session = capture(&room);
    let path = session.join("0001.mcap");
    let bytes = fs::read(&path).unwrap();
    // Sound in itself: only the manifest knows that something is gone.
    fs::write(&path, super::support::own_log(&super::support::read_bytes(&bytes)[..5])).unwrap();
    room.replay("parts/session").run.fails(3, &["parts/session/0001.mcap: has ", "manifest.jsonl says"]);
    // One frame places no robot.
    let words = ["parts/session/0001.mcap: has ", "none of the 1 tags is valid", "too few to find out why"];
    room.replay("parts/session/0001.mcap").run.fails(1, &words);
}

#[test]
fn a_capture_that_lost_its_images_says_what_was_there() {
    let room = Room::with_walk();
    let session = capture(&room);
    let files = segments(&session);
    files[1..].iter().for_each(|file| fs::remove_file(file).unwrap());
    // What is left has no image: all were in the others.
    let rest = super::support::without(&super::support::read_log(&files[0]), super::support::IMAGE);
    fs::write(&files[0], super::support::own_log(&rest)).unwrap();
    let words = ["parts/session: no camera images", "which may be why", "0000.mcap: has ", "more"];
    room.run("replay parts/session -o captures").fails(1, &words);
    fs::remove_file(&files[0]).unwrap();
    let words = ["parts/session: no segment of this capture is left", "0000.mcap: missing", "more"];
    room.run("replay parts/session -o captures").fails(1, &words);
}

#[test]
fn nothing_is_written_into_a_capture() {
    let room = Room::with_walk();
    let session = capture(&room);
    let listing = || {
        let mut names: Vec<_> = fs::read_dir(&session).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        names.sort();
        names
    };
    let before = listing();
    for (source, output) in [
        ("parts/session", "parts/session"),
        ("parts/session/0001.mcap", "parts/session"),
        ("parts/session", "parts/session/again"),
        ("log.mcap", "parts/session/../session/deep/er"),
    ] {
        let run = room.run(&format!("replay {source} -o {output}"));
        run.fails(2, &[output, "parts/session", "to which nothing is added", "--output"]);
        assert_eq!(listing(), before);
    }
    // Beside it is the right place.
    assert_same(&room.replay("parts/session").tags, &walk().tags, "replayed");
    room.run("replay parts/session -o parts").succeeds();
    assert!(room.path(CAPTURES).is_dir());
}
