//! Memory does not grow with the length of a log.

#![cfg(target_os = "linux")]

use std::process::{Command, Stdio};

use realitysim::ros2::LogMessage;

use super::support::{CAPTURES, INITIAL, Room, own_log, stamp_later, walk};

/// The walk again and again, one after the other, its constants at every start.
fn repeated(times: usize) -> Vec<u8> {
    let (first, last) = (walk().messages[0].log_time_ns, walk().messages.last().unwrap().log_time_ns);
    let period = last - first + 10_000_000;
    let mut messages: Vec<LogMessage> = Vec::new();
    for round in 0..times {
        for message in walk().messages.iter().filter(|message| round == 0 || message.channel.topic != INITIAL) {
            let mut message = message.clone();
            message.log_time_ns += round as i64 * period;
            stamp_later(&mut message, round as i64 * period);
            messages.push(message);
        }
    }
    own_log(&messages)
}

/// Peak of the memory in use, in kilobytes.
fn peak_kb(room: &Room, log: &str) -> u64 {
    let mut program = Command::new(env!("CARGO_BIN_EXE_realitysim"))
        .args(["replay", log, "-o", CAPTURES, "--threads", "1", "--set", "recording.segment_s=4"])
        .current_dir(room.path(""))
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    // The kernel keeps the peak, so that looking now and then is enough; after the end it is gone.
    let status = format!("/proc/{}/status", program.id());
    let mut peak = 0;
    while program.try_wait().unwrap().is_none() {
        let text = std::fs::read_to_string(&status).unwrap_or_default();
        let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let now = line.and_then(|line| line.trim().strip_suffix("kB")?.trim().parse().ok());
        peak = peak.max(now.unwrap_or(0));
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    assert!(program.wait().unwrap().success());
    peak
}

#[test]
fn five_times_the_frames_need_no_more_memory() {
    let room = Room::new();
    room.write("short.mcap", repeated(3));
    room.write("long.mcap", repeated(15));
    let (short, long) = (peak_kb(&room, "short.mcap"), peak_kb(&room, "long.mcap"));
    println!("{short} kB for {} frames, {long} kB for {}", 3 * walk().frames(), 15 * walk().frames());
    assert!(short > 1000, "measured");
    // The frames alone that are added weigh 14 MB.
    assert!(long < short + 5000, "{short} kB, then {long} kB");
}
