//! A piece of a long recording, as a log of its own.

use std::fs;

use realitysim::ros2::messages::{DiagnosticArray, FrameTag};

use super::support::{
    CAMERA_INFO, IMAGE, ODOMETRY, Room, TF_STATIC, TRUTH, assert_same, decode_all, on, read_log, session_name,
    stamp_later, walk,
};

fn frames_of(path: &std::path::Path) -> usize {
    on(&read_log(path), IMAGE).count()
}

/// Of the walk's tags those with the piece's frames.
fn same_frames(piece: &[FrameTag]) -> Vec<FrameTag> {
    let stamps: Vec<_> = piece.iter().map(|tag| tag.header.stamp).collect();
    walk().tags.iter().filter(|tag| stamps.contains(&tag.header.stamp)).cloned().collect()
}

#[test]
fn a_piece_of_a_capture_replays_to_the_same_tags_bit_for_bit() {
    let room = Room::with_walk();
    let whole = room.replay("log.mcap --set recording.segment_s=2");
    let session = session_name(&whole);
    let report = room.run(&format!("log cut {session} --from 2.5 --to 3.5 -o piece.mcap --json")).succeeds().json();
    let begins = report["from_s"].as_f64().unwrap();
    assert!((1.4..=2.5).contains(&begins), "{report}");
    let piece = room.replay("piece.mcap");
    assert_same(&piece.tags, &same_frames(&piece.tags), "the piece");
    assert_eq!(piece.tags.len() as u64, report["frames"].as_u64().unwrap());
    assert!(piece.tags.len() >= 10 && piece.tags.len() < walk().frames(), "{}", piece.tags.len());
    assert!(piece.tags[0].sequence > 0, "the frames go on counting");
    assert_eq!(report["bytes"].as_u64().unwrap(), fs::metadata(room.path("piece.mcap")).unwrap().len());
    let messages = read_log(&room.path("piece.mcap"));
    for topic in [CAMERA_INFO, TF_STATIC] {
        assert_eq!(on(&messages, topic).count(), 1, "{topic}");
    }
    assert_eq!(on(&messages, "/frame_tag").count(), piece.tags.len(), "they say where a budget stopped a frame");
    assert!(on(&messages, ODOMETRY).last().unwrap().log_time_ns > on(&messages, IMAGE).last().unwrap().log_time_ns);
}

#[test]
fn a_piece_of_a_log_keeps_its_truth() {
    let room = Room::with_walk();
    let run = room.run("log cut log.mcap --from 1 --to 2 -o piece.mcap").succeeds();
    assert!(run.stdout.contains("piece.mcap") && run.stdout.contains("frames"), "{run:?}");
    let piece = room.replay("piece.mcap");
    assert_same(&piece.tags, &same_frames(&piece.tags), "the piece");
    assert_eq!(on(&read_log(&room.path("piece.mcap")), TRUTH).count(), frames_of(&room.path("piece.mcap")));
    let judged = room.run(&format!("eval {} --truth piece.mcap --json", session_name(&piece))).succeeds().json();
    assert_eq!(judged["without_truth"], 0);
    // A piece of a piece.
    room.run("log cut piece.mcap --from 0 --to 0.5 -o smaller.mcap").succeeds();
    let smaller = room.replay("smaller.mcap");
    assert_same(&smaller.tags, &same_frames(&smaller.tags), "the smaller piece");
    assert!(frames_of(&room.path("smaller.mcap")) < frames_of(&room.path("piece.mcap")));
}

#[test]
fn an_incident_of_five_seconds_out_of_a_long_recording_is_small() {
    // The walk five times in a row.
    let walk = walk();
    let last = walk.messages.last().unwrap().log_time_ns - walk.messages[0].log_time_ns + 20_000_000;
    let mut long = Vec::new();
    for lap in 0..5 {
        for message in &walk.messages {
            let mut message = message.clone();
            let constant = [TF_STATIC, CAMERA_INFO].contains(&message.channel.topic.as_str());
            if constant && lap > 0 {
                continue;
            }
            message.log_time_ns += lap * last;
            message.publish_time_ns += lap * last;
            stamp_later(&mut message, lap * last);
            long.push(message);
        }
    }
    let room = Room::with_log(&long);
    let from = 2.2 * last as f64 * 1e-9;
    room.run(&format!("log cut log.mcap --from {from} --to {} -o piece.mcap", from + 2.0)).succeeds();
    let (whole, piece) = (frames_of(&room.path("log.mcap")), frames_of(&room.path("piece.mcap")));
    assert!((20..=32).contains(&piece) && whole > 3 * piece, "{piece} of {whole}");
    let bytes = |name: &str| fs::metadata(room.path(name)).unwrap().len();
    assert!(bytes("piece.mcap") * 3 < bytes("log.mcap"));
    let tags = room.replay("log.mcap").tags;
    let again = room.replay("piece.mcap").tags;
    let wanted: Vec<FrameTag> =
        tags.into_iter().filter(|tag| again.iter().any(|other| other.header.stamp == tag.header.stamp)).collect();
    assert_same(&again, &wanted, "the incident");
}

/// A repository is no place for megabytes of sensor noise.
#[test]
fn a_piece_with_images_encoded_anew_is_smaller_and_a_test_of_its_own() {
    let bytes = |room: &Room, name: &str| fs::metadata(room.path(name)).unwrap().len();
    let raw = Room::new();
    raw.write_scene("scene.toml", |text| text.replace("jpeg_quality = 90\n", ""));
    raw.run("scene render scene.toml -o log.mcap").succeeds();
    // Beside a quarter of a usual picture's pixels what other sensors say counts.
    for (room, times) in [(Room::with_walk(), 1.5), (raw, 10.0)] {
        room.run("log cut log.mcap --from 1 --to 3 -o whole.mcap").succeeds();
        room.run("log cut log.mcap --from 1 --to 3 --jpeg-quality 50 -o small.mcap").succeeds();
        let (whole, small) = (bytes(&room, "whole.mcap"), bytes(&room, "small.mcap"));
        assert!(times * (small as f64) < whole as f64, "{small} of {whole}");
        let images = |name: &str| -> Vec<Vec<u8>> {
            let messages = read_log(&room.path(name));
            messages.into_iter().filter(|m| m.channel.type_name.ends_with("Image")).map(|m| m.data).collect()
        };
        assert_eq!(on(&read_log(&room.path("small.mcap")), TRUTH).count(), images("small.mcap").len());
        let [a, b] = ["whole.mcap", "small.mcap"].map(|piece| room.replay(piece).tags);
        let stamps = |tags: &[FrameTag]| tags.iter().map(|tag| tag.header.stamp).collect::<Vec<_>>();
        assert_eq!(stamps(&a), stamps(&b));
        for (a, b) in a.iter().zip(&b) {
            assert_eq!(a.valid, b.valid);
            let [a, b] = [a, b].map(|tag| tag.pose.pose.position);
            assert!((a.x - b.x).hypot(a.y - b.y) < 0.05, "{a:?} {b:?}");
        }
        // Once more would make nothing smaller: what is there stays, and the gate holds it.
        room.run("replay small.mcap --check tags.jsonl --bless").succeeds();
        room.run("log cut small.mcap --from 0 --to 3 --jpeg-quality 100 -o again.mcap").succeeds();
        assert!(images("small.mcap") == images("again.mcap"));
        room.run("replay small.mcap --check tags.jsonl").succeeds();
        for quality in ["0", "101", "x"] {
            room.run(&format!("log cut log.mcap --from 1 --to 2 --jpeg-quality {quality} -o x.mcap"))
                .fails(2, &["--jpeg-quality"]);
        }
    }
}

#[test]
fn what_is_not_there_cannot_be_cut() {
    let room = Room::with_walk();
    for (arguments, code, words) in [
        ("--from 3 --to 2 -o x.mcap", 2, vec!["--from 3 --to 2", "must begin"]),
        ("--from=-1 --to 2 -o x.mcap", 2, vec!["--from -1"]),
        ("--from nan --to 2 -o x.mcap", 2, vec!["--from NaN"]),
        ("--from 500 --to 600 -o x.mcap", 1, vec!["log.mcap: no frame between 500 and 600 s", "it lasts"]),
        ("--from 1 --to 2 -o log.mcap", 2, vec!["is read"]),
    ] {
        room.run(&format!("log cut log.mcap {arguments}")).fails(code, &words);
        assert!(!room.path("x.mcap").exists(), "{arguments}");
    }
    assert_eq!(fs::read(room.path("log.mcap")).unwrap(), walk().log);
    room.run("log cut none.mcap --from 1 --to 2 -o x.mcap").fails(1, &["none.mcap"]);
}

#[test]
fn a_piece_says_what_was_drawn_for_the_whole_scene() {
    const DRAWN: &str = "/scene/drawn";
    let room = Room::new();
    room.write_scene("scene.toml", |text| {
        let plain = text.split("[[effect]]").next().unwrap().to_owned();
        plain + "\n[[effect]]\nkind = \"light\"\ngain = { uniform = [0.7, 0.9], per = \"episode\" }\n"
    });
    room.run("scene render scene.toml -o log.mcap").succeeds();
    let told: Vec<DiagnosticArray> = decode_all(&read_log(&room.path("log.mcap")), DRAWN);
    assert_eq!(told.len(), 1);
    let session = session_name(&room.replay("log.mcap --set recording.segment_s=1"));
    for (source, piece) in [("log.mcap", "a.mcap"), (&session, "b.mcap"), ("a.mcap", "c.mcap")] {
        let (from, to) = if source == "a.mcap" { (0.5, 1.0) } else { (2.2, 3.8) };
        let report = room.run(&format!("log cut {source} --from {from} --to {to} -o {piece} --json")).succeeds().json();
        let messages = read_log(&room.path(piece));
        assert_eq!(decode_all::<DiagnosticArray>(&messages, DRAWN), told, "{source}");
        let spans = messages.last().unwrap().log_time_ns - messages[0].log_time_ns;
        assert!(spans < 3_500_000_000, "it begins where the piece does: {report}");
        room.run(&format!("replay {piece} -o captures")).succeeds();
    }
}
