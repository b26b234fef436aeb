//! `accuracy`: marks of a robot that stands on crossings, from the log to the page.

use std::fs;

use realitysim::ros2::LogMessage;
use realitysim::ros2::messages::{CompressedImage, DiagnosticArray, DiagnosticStatus, Header, KeyValue, PoseStamped};

use super::support::{IMAGE, Room, TRUTH, changed, decode_all, message, read_log, session_name};

/// A walk to a penalty mark, on past it, and back: it stands there from 1.6 to 3.6 s with heading 0, and from 8 to 10 s with 180.
fn stood() -> Vec<LogMessage> {
    let room = Room::new();
    room.write_scene("scene.toml", |text| {
        text.replace("[[-2.0, 0.1], [-1.1, 0.3]]", "[[-1.6, 0.0], [-1.2, 0.0], [-1.15, 0.0], [-1.2, 0.0]]")
            .replace("turn_deg_s = 30.0", "turn_deg_s = 90.0\nstand_s = 2.0")
    });
    room.run("scene render scene.toml -o log.mcap").succeeds();
    read_log(&room.path("log.mcap"))
}

/// The log with marks as the recorder writes them, at seconds after its first frame.
fn marked(messages: &[LogMessage], marks: &[(f64, &str)]) -> Vec<LogMessage> {
    let truths: Vec<PoseStamped> = decode_all(messages, TRUTH);
    let first_ns = truths[0].header.stamp.to_nanoseconds();
    let mut messages = messages.to_vec();
    for (second, text) in marks {
        let stamp_ns = first_ns + (second * 1e9) as i64;
        let status = DiagnosticStatus {
            name: "realitysim: mark".to_owned(),
            message: (*text).to_owned(),
            values: vec![KeyValue { key: "event".to_owned(), value: "mark".to_owned() }],
            ..DiagnosticStatus::default()
        };
        let report = DiagnosticArray { header: Header::at(stamp_ns, ""), status: vec![status] };
        messages.push(message(900, "/diagnostics", stamp_ns, &report));
    }
    messages.sort_by_key(|message| message.log_time_ns);
    messages
}

#[test]
fn taped_places_are_judged_and_marks_that_cannot_be_used_are_named() {
    let marks = [
        (2.6, "at penalty_mark_-x 0"),
        (4.8, "at penalty_mrk_-x 0"),
        (7.0, "at centre 90"),
        (8.5, "half time"),
        (9.0, "at Penalty_Mark_-x 180"),
    ];
    let room = Room::with_log(&marked(&stood(), &marks));
    let session = session_name(&room.replay("log.mcap"));
    let run = room.run(&format!("accuracy {session} -o report.html --json"));
    let report = run.json();
    let run = run.fails(1, &["did you mean penalty_mark_-x", "the robot moved by"]);
    assert!(!run.stderr.contains("half time"), "{run:?}");
    let taped = &report["taped"];
    assert_eq!(
        (taped["stands"].as_array().unwrap().len(), &taped["crossings"], &taped["gross"]),
        (2, &1.into(), &0.into())
    );
    assert!(taped["rms_cm"].as_f64().unwrap() < 4.0, "{taped}");
    assert!(taped["held_out"]["missing"].as_str().unwrap().contains("1 crossings"), "{taped}");
    assert_eq!((&report["turned"]["pairs"], report["refused"].as_array().unwrap().len()), (&1.into(), 2));
    for half in report["split_half"].as_array().unwrap() {
        assert!((0.1..3.0).contains(&half["claimed"].as_f64().unwrap()), "{half}");
    }
    assert_ne!(report["verdicts"][0]["verdict"], "yes", "one crossing shows nothing: {report}");
    // A replay of the capture keeps what a person has marked.
    let again = room.run(&format!("replay {session} -o again --json")).succeeds().json();
    let again = room.run(&format!("accuracy {} --json", again["session"].as_str().unwrap())).json();
    assert_eq!((&again["taped"], &again["refused"]), (taped, &report["refused"]));
    let page = fs::read_to_string(room.path("report.html")).unwrap();
    assert!(page.contains("penalty_mark_-x") && page.contains("did you mean") && page.contains("</svg>"));
    assert!(!page.contains("src=\"http"), "nothing is loaded from elsewhere");
}

#[test]
fn a_capture_without_marks_or_tags_says_what_is_missing() {
    let messages = stood();
    let room = Room::with_log(&messages);
    let session = session_name(&room.replay("log.mcap"));
    let run = room.run(&format!("accuracy {session}")).succeeds();
    for words in
        ["taped places: missing", "recorder mark \"at CROSSING HEADING\"", "labels: not shown", "noise of a tag"]
    {
        assert!(run.stdout.contains(words), "{words}: {run:?}");
    }
    room.run(&format!("accuracy {session} -o {session}/report.html")).fails(2, &["report.html"]);
    room.run("accuracy nowhere").fails(1, &["nowhere"]);
    room.run("accuracy").fails(2, &["CAPTURE"]);
    let broken = changed(&messages, IMAGE, |image: &mut CompressedImage| image.data = vec![0; 9]);
    let room = Room::with_log(&broken);
    let session = session_name(&room.replay("log.mcap"));
    room.run(&format!("accuracy {session}")).fails(1, &["none of its", "explain"]);
}

#[test]
fn the_crossings_of_a_field_are_listed() {
    let room = Room::new();
    let run = room.run("accuracy --crossings kid-2020 -o places.html").succeeds();
    assert!(run.stdout.contains("penalty_area_corner_+x-y"), "{run:?}");
    assert!(fs::read_to_string(room.path("places.html")).unwrap().contains("at corner_-x-y HEADING"));
    room.run("accuracy --crossings kid-202").fails(2, &["kid-202", "did you mean"]);
}
