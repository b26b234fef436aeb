//! An agent that starts again goes on from where the last one ended, but believes it only after it has seen lines.

use std::fs;

use super::support::{CAPTURES, INITIAL, Room, farthest_apart, walk, without};

#[test]
fn a_warm_start_goes_on_unconfirmed_and_becomes_valid() {
    let half = walk().messages.len() / 2;
    let rest = without(&walk().messages, INITIAL).split_off(half);
    let constants = walk().messages[..2].iter().cloned();
    let rest: Vec<_> = constants.chain(rest).collect();

    let room = Room::new();
    room.write("first.mcap", super::support::own_log(&walk().messages[..half]));
    room.write("rest.mcap", super::support::own_log(&rest));
    let first = room.replay("first.mcap");
    assert!(room.path(CAPTURES).join("last_state.bin").is_file());

    let warm = room.replay("rest.mcap --warm-start");
    let reasons: Vec<&str> = warm.tags.iter().map(|tag| tag.reason.as_str()).collect();
    assert!(!warm.tags[0].valid && reasons[0] == "unconfirmed", "{reasons:?}");
    let confirmed = warm.tags.iter().position(|tag| tag.valid).unwrap_or(usize::MAX);
    assert!(confirmed <= 6, "{reasons:?}");
    assert!(warm.tags[confirmed..].iter().filter(|tag| tag.valid).count() + confirmed + 2 >= warm.tags.len());
    // Known, not found by search: the mirror pose does not come into question.
    assert!(warm.tags.iter().all(|tag| !tag.ambiguous));
    let expected = &walk().tags[first.tags.len()..];
    let apart = farthest_apart(&warm.tags[confirmed..], &expected[confirmed..]);
    assert!(apart < 0.3, "{apart} m from where an agent that never stopped is");
}

#[test]
fn a_warm_start_without_a_state_is_a_cold_one() {
    let room = Room::with_walk();
    let warm = room.replay("log.mcap --field kid-2009 --warm-start");
    super::support::assert_same(&warm.tags, &walk().tags, "first start");
}

/// The walk's own start, a warning that names the file, and a sound file in its place.
fn assert_starts_anew(room: &Room, word: &str) {
    let replayed = room.replay("log.mcap --field kid-2009 --warm-start");
    let run = &replayed.run;
    assert_eq!(run.code, Some(0), "nothing of the log is lost: {run:?}");
    super::support::assert_same(&replayed.tags, &walk().tags, "a cold start");
    let warnings = replayed.report["warnings"].as_array().unwrap();
    assert_eq!(warnings.len(), 1, "{warnings:?}");
    for said in [warnings[0].as_str().unwrap(), &run.stderr] {
        assert!(said.contains("captures/last_state.bin") && said.contains(word), "{word}: {said}");
        assert!(said.contains("the filter began without it"), "{said}");
    }
    let again = room.replay("log.mcap --field kid-2009 --warm-start");
    assert_eq!(again.report["warnings"], serde_json::json!([]), "the file is sound again");
}

#[test]
fn a_last_state_that_cannot_be_used_is_told_and_the_start_a_cold_one() {
    let room = Room::with_walk();
    room.replay("log.mcap");
    let path = room.path(CAPTURES).join("last_state.bin");
    let whole = fs::read(&path).unwrap();
    let mut flipped = whole.clone();
    flipped[whole.len() / 2] ^= 1;
    for (damaged, word) in [
        (flipped, "damaged"),
        (whole[..whole.len() / 2].to_vec(), "damaged"),
        (Vec::new(), "not a checkpoint"),
        (b"a text".to_vec(), "not a checkpoint"),
    ] {
        fs::write(&path, damaged).unwrap();
        assert_starts_anew(&room, word);
    }
    // Of an older version of this program.
    let mut older = whole.clone();
    older[8..12].copy_from_slice(&1u32.to_le_bytes());
    fs::write(&path, older).unwrap();
    assert_starts_anew(&room, "version 1");
    // Whoever does not ask for it is not troubled by it.
    fs::write(&path, "a text").unwrap();
    assert_eq!(room.replay("log.mcap --field kid-2009").report["warnings"], serde_json::json!([]));
}

#[cfg(unix)]
#[test]
fn a_last_state_that_cannot_be_read_is_told_and_the_start_a_cold_one() {
    let room = Room::with_walk();
    fs::create_dir(room.path(CAPTURES)).unwrap();
    // A link that leads in a circle: nobody can read that, not even root.
    std::os::unix::fs::symlink("last_state.bin", room.path(CAPTURES).join("last_state.bin")).unwrap();
    assert_starts_anew(&room, "symbolic links");
}
