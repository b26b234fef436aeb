//! Captures are read by programs that are not ours, and these find in them what we find.

use std::process::Command;
use std::sync::Arc;

use realitysim::ros2::messages::{DiagnosticArray, FrameTag};
use realitysim::ros2::{Channel, LogMessage, Message};
use serde_json::json;

use super::support::{IMAGE, Replayed, Room, message, own_log, read_capture, segments, walk};

/// Names a Python interpreter that has mcap, mcap-ros2-support and rosbags.
const INTERPRETER: &str = "REALITYSIM_PYTHON";

fn stamp(tag: &FrameTag) -> String {
    format!("{}.{:09}", tag.header.stamp.sec, tag.header.stamp.nanosec)
}

fn check(room: &Room, replayed: &Replayed, python: &std::ffi::OsStr) {
    let messages = read_capture(&replayed.session);
    let mut counts = std::collections::BTreeMap::<String, usize>::new();
    for message in &messages {
        *counts.entry(message.channel.topic.clone()).or_default() += 1;
    }
    let valid: Vec<String> = replayed.tags.iter().filter(|tag| tag.valid).map(stamp).collect();
    let all: Vec<String> = replayed.tags.iter().map(stamp).collect();
    let files = segments(&replayed.session);
    let expected = json!({"counts": counts, "valid": valid, "frames": all, "image_topic": IMAGE, "files": files});
    room.write("expected.json", expected.to_string());
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/replay/check_capture.py");
    let arguments = [replayed.session.as_path(), &room.path("source.mcap"), &room.path("expected.json")];
    let output = Command::new(python).arg(script).args(arguments).output().unwrap();
    let said = format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{said}");
    println!("{said}");
}

fn without_metadata(mut message: LogMessage) -> LogMessage {
    message.channel = Arc::new(Channel { metadata: Default::default(), ..message.channel.as_ref().clone() });
    message
}

#[test]
fn other_programs_read_captures() {
    let Some(python) = std::env::var_os(INTERPRETER) else {
        assert!(
            std::env::var("CI").as_deref() != Ok("true"),
            "{INTERPRETER} must name an interpreter where CI is true"
        );
        println!("skipped: {INTERPRETER} names no interpreter");
        return;
    };
    // The walk, with a frame in the middle that gets an invalid tag.
    let mut number = 0;
    let messages =
        super::support::changed::<realitysim::ros2::messages::CompressedImage>(&walk().messages, IMAGE, |image| {
            number += 1;
            if number == 20 {
                image.data.truncate(100);
            }
        });
    let room = Room::with_log(&messages);
    room.write("source.mcap", own_log(&messages));
    let whole = room.replay("log.mcap");
    assert_eq!(whole.count("valid") + 1, whole.count("frames"), "{}", whole.report);
    check(&room, &whole, &python);
    let parts = room.replay("log.mcap --set recording.segment_s=1");
    check(&room, &parts, &python);

    // A robot's own diagnostics, their definition written otherwise than ours, beside which ours are written.
    let mut with_own = messages.clone();
    let mut report = message(77, "/diagnostics", messages[9].log_time_ns, &DiagnosticArray::default());
    report.channel = Arc::new(Channel {
        definition: format!("# of the robot\n{}", DiagnosticArray::DEFINITION).into_bytes().into(),
        ..report.channel.as_ref().clone()
    });
    with_own.insert(10, report);
    room.write("log.mcap", own_log(&with_own));
    room.write("source.mcap", own_log(&with_own));
    check(&room, &room.replay("log.mcap"), &python);

    // A log whose channels say nothing about quality of service: metadata.yaml must not either.
    let bare: Vec<_> = messages.iter().cloned().map(without_metadata).collect();
    room.write("log.mcap", own_log(&bare));
    room.write("source.mcap", own_log(&bare));
    check(&room, &room.replay("log.mcap"), &python);
}
