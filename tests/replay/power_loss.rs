//! An agent that is killed leaves a capture that can be replayed, and a state to go on from.

use std::fs;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use super::support::{CAPTURES, Room, assert_same, walk};

/// Far less than the walk lasts, far more than a busy machine needs to write a megabyte.
const PATIENCE: Duration = Duration::from_secs(30);

#[test]
fn a_killed_agent_leaves_its_frames_and_its_state() {
    let room = Room::with_walk();
    let mut agent = Command::new(env!("CARGO_BIN_EXE_realitysim"))
        // Four threads: frames are under way at every moment, and the state must be saved nevertheless.
        .args(["replay", "log.mcap", "-o", CAPTURES, "--realtime", "--threads", "4"])
        .args(["--set", "recording.sync_interval_ms=100"])
        .current_dir(room.path(""))
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let state = room.path(CAPTURES).join("last_state.bin");
    let begun = Instant::now();
    // The state at the first message holds no pose yet; with particles it is far larger.
    while fs::metadata(&state).map_or(0, |file| file.len()) < 10_000 && begun.elapsed() < PATIENCE {
        std::thread::sleep(Duration::from_millis(20));
    }
    std::thread::sleep(Duration::from_millis(300));
    let ended = agent.try_wait().unwrap();
    agent.kill().unwrap();
    agent.wait().unwrap();
    assert!(ended.is_none(), "the state is saved while the agent runs, not only at its end");

    let session = fs::read_dir(room.path(CAPTURES)).unwrap().map(|entry| entry.unwrap().path()).find(|p| p.is_dir());
    let session = session.unwrap();
    assert!(session.join("0000.mcap.active").is_file(), "an unfinished file can be told by its name");
    let left = room.replay(&format!("captures/{}", session.file_name().unwrap().to_str().unwrap()));
    assert_eq!(left.run.code, Some(3), "{:?}", left.run);
    assert!(left.tags.len() >= 5, "{} frames on disk", left.tags.len());
    // The last one lacks the measurements after it.
    let known = left.tags.len() - 1;
    assert_same(&left.tags[..known], &walk().tags[..known], "from the unfinished file");
}
