//! A replay at the log's own pace: frames come when they came, and none is lost.

use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use super::support::{CAPTURES, IMAGE, Room, assert_same, on, own_log, walk};

fn logged_s() -> f64 {
    let messages = &walk().messages;
    (messages.last().unwrap().log_time_ns - messages[0].log_time_ns) as f64 * 1e-9
}

#[test]
fn a_replay_in_real_time_takes_as_long_as_the_log_and_loses_nothing() {
    let room = Room::with_walk();
    for threads in [1, 4] {
        let begun = Instant::now();
        let replayed = room.replay(&format!("log.mcap --realtime --threads {threads}"));
        let took_s = begun.elapsed().as_secs_f64();
        assert_eq!(replayed.run.code, Some(0), "{:?}", replayed.run);
        assert_same(&replayed.tags, &walk().tags, "in real time");
        assert!(took_s >= logged_s(), "{took_s} s");
        let wall_s = replayed.report["wall_s"].as_f64().unwrap();
        assert!(wall_s >= logged_s() && wall_s < logged_s() + 30.0, "{wall_s} s for {} s of log", logged_s());
    }
}

#[test]
fn frames_are_written_as_they_come_and_a_pause_is_kept() {
    // A pause of four seconds in the middle: until it is over only the first half is there.
    let half = walk().messages.len() / 2;
    let mut messages = walk().messages.clone();
    messages[half..].iter_mut().for_each(|message| message.log_time_ns += 4_000_000_000);
    let first = on(&messages[..half], IMAGE).count();
    let room = Room::new();
    room.write("log.mcap", own_log(&messages));
    let mut agent = Command::new(env!("CARGO_BIN_EXE_realitysim"))
        .args(["replay", "log.mcap", "-o", CAPTURES, "--realtime", "--set", "recording.sync_interval_ms=10"])
        .current_dir(room.path(""))
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    while !room.path(CAPTURES).exists() {
        std::thread::sleep(Duration::from_millis(5));
    }
    std::thread::sleep(Duration::from_secs_f64(logged_s() / 2.0 + 2.0));
    let session = std::fs::read_dir(room.path(CAPTURES)).unwrap().map(|entry| entry.unwrap().path());
    let session = session.filter(|path| path.is_dir()).last().unwrap();
    let open = std::fs::read(session.join("0000.mcap.active")).unwrap();
    let there = on(&super::support::read_bytes(&open), IMAGE).count();
    assert!(there + 2 >= first && there <= first, "{there} of {first} frames in the pause");
    assert!(agent.wait().unwrap().success());
    let capture = super::support::read_capture(&session);
    assert_eq!(on(&capture, IMAGE).count(), walk().frames());
}
