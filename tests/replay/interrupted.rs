//! A replay that cannot go on leaves what it has as a whole capture.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use super::support::{CAPTURES, Room, assert_same, own_log, walk};

fn only_session(room: &Room) -> PathBuf {
    let entries = fs::read_dir(room.path(CAPTURES)).unwrap().map(|entry| entry.unwrap().path());
    let sessions: Vec<PathBuf> = entries.filter(|path| path.join("session.json").is_file()).collect();
    assert_eq!(sessions.len(), 1, "{sessions:?}");
    sessions.into_iter().next().unwrap()
}

/// Nothing unfinished, and the manifest lists what is there.
fn assert_whole(session: &Path) {
    let mut names: Vec<String> =
        fs::read_dir(session).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    assert_eq!(names, ["0000.mcap", "coverage.json", "manifest.jsonl", "metadata.yaml", "session.json"]);
    assert!(fs::read_to_string(session.join("manifest.jsonl")).unwrap().contains("0000.mcap"));
}

#[test]
fn a_source_that_goes_away_in_the_middle_leaves_all_tags_until_then() {
    let room = Room::new();
    let messages = &walk().messages;
    let (first, second) = messages.split_at(messages.len() / 2);
    fs::create_dir(room.path("bag")).unwrap();
    room.write("bag/0.mcap", own_log(first));
    room.write("bag/1.mcap", own_log(second));
    let agent = Command::new(env!("CARGO_BIN_EXE_realitysim"))
        .args(["replay", "bag", "-o", CAPTURES, "--realtime"])
        .current_dir(room.path(""))
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // The second file is opened when the first has been read, which takes the time that it lasts.
    while !room.path(CAPTURES).exists() {
        std::thread::sleep(Duration::from_millis(5));
    }
    fs::remove_file(room.path("bag/1.mcap")).unwrap();
    let output = agent.wait_with_output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{said}");
    let session = only_session(&room);
    let name = session.file_name().unwrap().to_str().unwrap();
    assert!(
        said.contains("1.mcap") && said.contains(&format!("what came before is recorded in captures/{name}")),
        "{said}"
    );
    assert_whole(&session);
    let left = room.replay(&format!("{CAPTURES}/{name}"));
    assert_eq!(left.run.code, Some(0), "{:?}", left.run);
    // The last one lacks the measurements after it.
    let known = left.tags.len() - 1;
    assert!(known > walk().frames() / 3);
    assert_same(&left.tags[..known], &walk().tags[..known], "until the end of the first file");
}

#[test]
fn a_state_that_cannot_be_saved_stops_the_replay_and_not_the_segment() {
    let room = Room::with_walk();
    fs::create_dir_all(room.path(CAPTURES).join("last_state.bin/in the way")).unwrap();
    room.run("replay log.mcap -o captures").fails(1, &["last_state.bin", "what came before is recorded in captures/"]);
    assert_whole(&only_session(&room));
}
