//! A suite of logs and scenes, held to its limits.

use mcap::WriteOptions;
use realitysim::ros2::messages::{Odometry, PoseStamped, PoseWithCovarianceStamped};

use super::support::{IMAGE, Room, TRUTH, changed, decode_all, foreign_log, message, on, own_log, walk, without};

/// Limits that the walk keeps with ease.
const EASY: &str = "mean_cm = 5.0, max_cm = 20.0, valid_share = 0.9";

fn case(source: &str, rest: &str) -> String {
    format!("[[case]]\nsource = \"{source}\"\n{rest}\n")
}

fn room_with(suite: &str) -> Room {
    let room = Room::with_walk();
    room.write("suite.toml", suite);
    room
}

#[test]
fn a_log_and_a_scene_that_keep_their_limits_pass() {
    let limits = format!("limits = {{ {EASY}, p99_ratio = 1000.0 }}\n");
    let suite = limits + &case("log.mcap", "") + &case("scene.toml", "limits = { p99_ratio = inf }");
    let room = room_with(&suite);
    room.write_scene("scene.toml", |text| text);
    let run = room.run("check suite.toml --junit out.xml").succeeds();
    for word in ["log", "scene", "p99 ratio", "2 of 2 cases keep their limits"] {
        assert!(run.stdout.contains(word), "{word}: {run:?}");
    }
    for word in ["1/2", "2/2", "timing alone: log"] {
        assert!(run.stderr.contains(word), "{word}: {run:?}");
    }
    let junit = std::fs::read_to_string(room.path("out.xml")).unwrap();
    assert!(junit.contains("tests=\"2\" failures=\"0\"") && junit.contains("name=\"scene\""), "{junit}");

    let report = room.run("check suite.toml --json -j 1 -o kept").succeeds().json();
    let [log, scene] = &report["cases"].as_array().unwrap()[..] else { panic!("{report}") };
    assert_eq!((&log["name"], &log["outcome"]), (&"log".into(), &"kept".into()));
    assert_eq!(log["position_cm"], scene["position_cm"], "a scene and its log give the same tags");
    assert!(log["p99_ratio"].as_f64().unwrap() > 0.0 && scene["p99_ratio"].is_null(), "{report}");
    assert!(room.path(log["capture"].as_str().unwrap()).join("session.json").exists(), "{report}");
}

#[test]
fn a_broken_limit_is_named_and_fails() {
    let wrong = "limits = { mean_cm = 0.0001, yaw_median_deg = 5.0, p99_ratio = 0.0001 }";
    let room =
        room_with(&(case("log.mcap", wrong) + &case("log.mcap", &format!("name = \"x\"\nlimits = {{ {EASY} }}"))));
    let run = room.run("check suite.toml --junit out.xml");
    let run = run.fails(1, &["log: mean_cm is", "at most 0.0001", "log: p99_ratio is"]);
    assert!(!run.stderr.contains("yaw_median_deg") && run.stdout.contains("1 of 2 cases"), "{run:?}");
    let junit = std::fs::read_to_string(room.path("out.xml")).unwrap();
    assert!(junit.contains("tests=\"2\" failures=\"1\"") && junit.contains("mean_cm is"), "{junit}");
    let report = room.run("check suite.toml --json --only log").json();
    assert_eq!(report["cases"].as_array().unwrap().len(), 1);
    assert_eq!((&report["passed"], &report["cases"][0]["outcome"]), (&false.into(), &"broken".into()));
    assert_eq!(report["cases"][0]["broken"][0]["limit"], "mean_cm");
}

#[test]
fn a_case_that_cannot_run_fails_and_the_others_go_on() {
    let room = room_with(
        &(format!("limits = {{ {EASY} }}\n")
            + &case("missing.mcap", "")
            + &case("log.mcap", "")
            + &case("bad.toml", "")),
    );
    room.write("bad.toml", "[scene]\n");
    let run = room.run("check suite.toml").fails(1, &["missing: ", "missing.mcap", "bad: ", "missing field"]);
    assert!(run.stdout.contains("1 of 3 cases") && run.stdout.contains("FAILED"), "{run:?}");
}

#[test]
fn a_suite_that_makes_no_sense_is_refused_before_anything_runs() {
    for (suite, words) in [
        (case("log.mcap", "limits = { mean = 1 }"), vec!["suite.toml", "line 3", "unknown field `mean`", "mean_cm"]),
        (case("log.mcap", ""), vec!["suite.toml", "no limit at all"]),
        (case("log.mcap", "limits = { mean_cm = -1 }"), vec!["mean_cm is -1", "above 0"]),
    ] {
        room_with(&suite).run("check suite.toml").fails(2, &words);
    }
    let room = room_with(&case("log.mcap", "limits = { mean_cm = 1 }"));
    room.run("check none.toml").fails(2, &["none.toml"]);
    room.run("check suite.toml --only zebra").fails(2, &["zebra", "no case"]);
}

/// The judged process is another one: only its poses are there, on a topic of its own.
#[test]
fn poses_of_any_process_can_be_judged() {
    let mut messages = walk().messages.clone();
    let truth: Vec<PoseStamped> = decode_all(&messages, TRUTH);
    let times: Vec<i64> = on(&messages, TRUTH).map(|message| message.log_time_ns).collect();
    for (index, (pose, time)) in truth.iter().zip(&times).enumerate() {
        let mut odometry = Odometry { header: pose.header.clone(), ..Odometry::default() };
        odometry.pose.pose = pose.pose;
        odometry.pose.pose.position.x += 0.03;
        messages.push(message(77, "/their/odometry", *time, &odometry));
        let mut posed = PoseWithCovarianceStamped { header: pose.header.clone(), ..Default::default() };
        posed.pose.pose = pose.pose;
        posed.pose.pose.position.y += if index % 2 == 0 { 0.01 } else { -0.01 };
        (posed.pose.covariance[0], posed.pose.covariance[7]) = (1e-4, 1e-4);
        messages.push(message(78, "/their/pose", *time, &posed));
    }
    let room = Room::with_log(&messages);
    let three = "name = \"odometry\"\nposes = \"/their/odometry\"\nlimits = { max_cm = 3.1, valid_share = 1.0 }";
    let none = "name = \"none\"\nposes = \"/nobody\"\nlimits = { max_cm = 3.1 }";
    room.write("suite.toml", case("log.mcap", three) + &case("log.mcap", none));
    let run = room.run("check suite.toml --json");
    let report = run.fails(1, &["none: ", "/nobody"]).json();
    let [kept, failed] = &report["cases"].as_array().unwrap()[..] else { panic!("{report}") };
    assert_eq!((&kept["outcome"], &failed["outcome"]), (&"kept".into(), &"failed".into()));
    assert!((kept["position_cm"]["mean"].as_f64().unwrap() - 3.0).abs() < 1e-6, "{report}");

    let judged = room.run("eval log.mcap --poses /their/pose --truth log.mcap --json").succeeds().json();
    assert!((judged["position_cm"]["mean"].as_f64().unwrap() - 1.0).abs() < 1e-6, "{judged}");
    assert!((judged["nees"].as_f64().unwrap() - 1.0).abs() < 1e-6, "{judged}");
    let run = room.run("eval log.mcap --poses /their/odometry --truth log.mcap").succeeds();
    assert!(run.stdout.contains("state no covariance"), "{run:?}");
    room.run("eval log.mcap --poses /imu/data --truth log.mcap").fails(1, &["/imu/data", "sensor_msgs/msg/Imu"]);
}

#[test]
fn what_comes_late_or_in_between_can_be_left_out() {
    let broken = changed::<PoseStamped>(&walk().messages, TRUTH, |truth| {
        let second = truth.header.stamp.to_nanoseconds() / 100_000_000 % 10;
        if second < 2 {
            truth.pose.position.x += 1.0;
        }
    });
    let room = Room::with_log(&broken);
    let spans: Vec<String> = (0..20).map(|second| format!("[{second}.0, {second}.2]")).collect();
    let except = format!("except_s = [{}]", spans.join(", "));
    room.write("suite.toml", case("log.mcap", &format!("{except}\nlimits = {{ {EASY} }}")));
    room.run("check suite.toml").succeeds();
    room.write("suite.toml", case("log.mcap", &format!("limits = {{ {EASY} }}")));
    room.run("check suite.toml").fails(1, &["max_cm is"]);
}

/// A minute of replays is no time to find that out after.
#[test]
fn results_that_could_not_be_written_are_refused_before_anything_runs() {
    let room = room_with(&(format!("limits = {{ {EASY} }}\n") + &case("log.mcap", "")));
    let run = room.run("check suite.toml --junit none/out.xml").fails(2, &["none/out.xml", "make it first"]);
    assert!(!run.stderr.contains("1/1"), "{run:?}");
    room.run("replay log.mcap --check tags.jsonl --junit none/out.xml").fails(2, &["none/out.xml", "make it first"]);
}

#[test]
fn a_case_is_held_to_its_reference() {
    let room = room_with(&case("log.mcap", "reference = \"tags.jsonl\""));
    room.run("check suite.toml").fails(1, &["log: tags.jsonl: cannot be read"]);
    room.run("replay log.mcap --check tags.jsonl --bless").succeeds();
    let report = room.run("check suite.toml --json").succeeds().json();
    assert_eq!(
        (&report["cases"][0]["outcome"], &report["cases"][0]["reference"]["same"]),
        (&"kept".into(), &true.into())
    );

    // One tag more is no longer valid.
    let blessed = std::fs::read_to_string(room.path("tags.jsonl")).unwrap();
    let lines: Vec<&str> = blessed.lines().collect();
    let columns: serde_json::Value = serde_json::from_str(lines[0]).unwrap();
    let yaw = columns["columns"].as_array().unwrap().iter().position(|name| name == "yaw").unwrap();
    let mut frame: Vec<serde_json::Value> = serde_json::from_str(lines[5]).unwrap();
    frame[yaw] = 3.25.into();
    let frame = serde_json::to_string(&frame).unwrap();
    room.write("tags.jsonl", blessed.replace(lines[5], &frame));
    let run = room.run("check suite.toml --junit out.xml");
    let run = run.fails(1, &["log: reference: 1 frames differ, the first is 4: yaw was 3.25"]);
    assert!(run.stdout.contains("BROKEN"), "{run:?}");
    assert!(std::fs::read_to_string(room.path("out.xml")).unwrap().contains("reference: 1 frames differ"));
    room.write("tags.jsonl", lines[..lines.len() - 1].join("\n"));
    room.run("check suite.toml").fails(1, &["log: tags.jsonl: ", "is it whole?"]);
}

#[test]
fn a_reference_of_another_log_seed_or_version_is_named_not_compared() {
    let room = room_with(&case("log.mcap", "reference = \"tags.jsonl\""));
    room.write_scene("scene.toml", |text| text);
    room.run("replay scene.toml --check tags.jsonl --bless").succeeds();
    room.run("check suite.toml").fails(1, &["log: tags.jsonl: not compared", "another log or scene"]);
    room.run("replay log.mcap --seed 77 --check tags.jsonl --bless").succeeds();
    room.run("check suite.toml").fails(1, &["log: tags.jsonl: not compared", "seed 77"]);
    room.run("replay log.mcap --check tags.jsonl --bless").succeeds();
    let text = std::fs::read_to_string(room.path("tags.jsonl")).unwrap();
    let software = concat!("realitysim ", env!("CARGO_PKG_VERSION"));
    room.write("tags.jsonl", text.replacen(software, "realitysim 0.0.1", 1));
    room.run("check suite.toml").fails(1, &["log: tags.jsonl: not compared", "made by realitysim 0.0.1"]);
}

#[test]
fn errors_of_the_frames_that_have_a_truth_do_not_pass_for_those_of_all() {
    let messages = &walk().messages;
    let middle = on(messages, TRUTH).nth(walk().frames() / 2).unwrap().log_time_ns;
    let half: Vec<_> = messages
        .iter()
        .filter(|message| message.channel.topic != TRUTH || message.log_time_ns < middle)
        .cloned()
        .collect();
    let room = Room::with_log(&half);
    room.write("suite.toml", case("log.mcap", &format!("limits = {{ {EASY} }}")));
    let run = room.run("check suite.toml --junit out.xml");
    let run = run.fails(1, &["log: judged_share is 0.", "at least 0.9", "have no truth near their time"]);
    assert!(run.stdout.contains("no truth") && run.stdout.contains("BROKEN"), "{run:?}");
    assert!(std::fs::read_to_string(room.path("out.xml")).unwrap().contains("judged_share"));
    room.write("suite.toml", case("log.mcap", &format!("limits = {{ {EASY}, judged_share = 0.4 }}")));
    let report = room.run("check suite.toml --json").succeeds().json();
    assert!(report["cases"][0]["without_truth"].as_u64().unwrap() > 5, "{report}");
}

/// On `/p`: the true poses of every other frame.
fn every_other_pose() -> Vec<realitysim::ros2::LogMessage> {
    let mut messages = walk().messages.clone();
    let truth: Vec<PoseStamped> = decode_all(&messages, TRUTH);
    let times: Vec<i64> = on(&messages, TRUTH).map(|message| message.log_time_ns).collect();
    for (pose, time) in truth.iter().zip(&times).step_by(2) {
        messages.push(message(77, "/p", *time, pose));
    }
    messages
}

#[test]
fn the_valid_share_of_poses_is_of_the_camera_s_frames() {
    let room = Room::with_log(&every_other_pose());
    let rest = "poses = \"/p\"\nlimits = { max_cm = 1, valid_share = 0.9 }";
    room.write("suite.toml", case("log.mcap", rest));
    room.run("check suite.toml").fails(1, &["log: valid_share is 0.5", "at least 0.9"]);
    room.write("suite.toml", case("log.mcap", &rest.replace("0.9", "0.45")));
    let report = room.run("check suite.toml --json").succeeds().json();
    assert_eq!(report["cases"][0]["frames"].as_u64().unwrap(), walk().frames() as u64);
    // The output alone has no images; the log that it was made from has.
    room.write("out.mcap", own_log(&without(&every_other_pose(), IMAGE)));
    room.write("suite.toml", case("out.mcap", &format!("truth = \"log.mcap\"\n{rest}")));
    room.run("check suite.toml").fails(1, &["out: valid_share is 0.5"]);
    room.write("suite.toml", case("out.mcap", rest));
    room.run("check suite.toml").fails(1, &["out: limits.valid_share is of the camera's frames", "out.mcap", "images"]);
    room.write("suite.toml", case("out.mcap", "poses = \"/p\"\nlimits = { max_cm = 1 }"));
    assert!(room.run("check suite.toml --json").succeeds().json()["cases"][0]["valid_share"].is_null());
}

#[test]
fn a_truncated_log_is_told_and_does_not_pass_for_whole() {
    let room = Room::new();
    let whole = foreign_log(WriteOptions::new().profile("ros2").chunk_size(Some(1 << 15)), &walk().messages);
    room.write("log.mcap", &whole[..whole.len() * 2 / 3]);
    room.write("suite.toml", case("log.mcap", &format!("limits = {{ {EASY} }}")));
    let run = room.run("check suite.toml --junit out.xml").fails(3, &["log: log.mcap", "damaged"]);
    assert!(run.stdout.contains("ok, DATA LOST"), "{run:?}");
    assert!(std::fs::read_to_string(room.path("out.xml")).unwrap().contains("failures=\"1\""));
    let report = room.run("check suite.toml --json");
    assert_eq!((&report.json()["passed"], report.code), (&false.into(), Some(3)));
}

#[test]
fn a_result_is_not_written_over_what_a_suite_reads() {
    let room = room_with(&format!(
        "config = \"robot.toml\"\n{}",
        case("log.mcap", "truth = \"truth.mcap\"\nreference = \"tags.jsonl\"\nlimits = { max_cm = 20 }")
    ));
    room.write("truth.mcap", &walk().log);
    room.write("robot.toml", "robot = \"r\"\n");
    let files = ["log.mcap", "truth.mcap", "robot.toml", "suite.toml"];
    let before = files.map(|file| std::fs::read(room.path(file)).unwrap());
    for file in files.into_iter().chain(["tags.jsonl", "./tags.jsonl"]) {
        let name = file.trim_start_matches("./");
        room.run(&format!("check suite.toml --junit {file}")).fails(2, &[name, "choose another place"]);
    }
    assert_eq!(files.map(|file| std::fs::read(room.path(file)).unwrap()), before);
    assert!(!room.path("tags.jsonl").exists());
    // Nobody knows what a suite reads that cannot be read.
    room.write("suite.toml", "nonsense");
    room.run("check suite.toml --junit log.mcap").fails(2, &["suite.toml"]);
    assert_eq!(std::fs::read(room.path("log.mcap")).unwrap(), before[0]);
}

#[test]
fn a_suite_that_cannot_run_leaves_no_passing_result() {
    let room = room_with(&case("log.mcap", &format!("limits = {{ {EASY} }}")));
    room.run("check suite.toml --junit out.xml").succeeds();
    let failed = || std::fs::read_to_string(room.path("out.xml")).unwrap().contains("failures=\"1\"");
    assert!(!failed());
    room.run("check suite.toml --only zebra --junit out.xml").fails(2, &["zebra"]);
    assert!(failed());
    room.run("check suite.toml --junit out.xml").succeeds();
    room.write("suite.toml", "nonsense");
    room.run("check suite.toml --junit out.xml").fails(2, &["suite.toml"]);
    assert!(failed());
}

#[test]
fn poses_of_another_frame_are_judged_with_a_warning() {
    let mut messages = walk().messages.clone();
    let truth: Vec<PoseStamped> = decode_all(&messages, TRUTH);
    let times: Vec<i64> = on(&messages, TRUTH).map(|message| message.log_time_ns).collect();
    for (pose, time) in truth.iter().zip(&times) {
        let mut odometry = Odometry { header: pose.header.clone(), ..Odometry::default() };
        odometry.header.frame_id = "odom".to_owned();
        odometry.child_frame_id = "base_footprint".to_owned();
        odometry.pose.pose = pose.pose;
        messages.push(message(77, "/walk", *time, &odometry));
        odometry.header.frame_id = "map".to_owned();
        odometry.child_frame_id = "camera_link".to_owned();
        messages.push(message(78, "/right", *time, &odometry));
    }
    let room = Room::with_log(&messages);
    let words = ["warning", "/walk", "\"odom\"", "\"base_footprint\"", "\"camera_link\" in \"map\""];
    let run = room.run("eval log.mcap --poses /walk --truth log.mcap --json").fails(0, &words);
    assert!(run.json()["warning"].as_str().unwrap().contains("base_footprint"), "{run:?}");
    let run = room.run("eval log.mcap --poses /right --truth log.mcap").succeeds();
    assert!(!run.stderr.contains("warning"), "{run:?}");
    room.write("suite.toml", case("log.mcap", "poses = \"/walk\"\nlimits = { max_cm = 1 }"));
    room.run("check suite.toml").fails(0, &words);
}

#[test]
fn where_nothing_was_judged_no_error_is_shown() {
    let room = room_with(&case("log.mcap", "reference = \"tags.jsonl\""));
    room.run("replay log.mcap --check tags.jsonl --bless").succeeds();
    let run = room.run("check suite.toml").succeeds();
    let row = run.stdout.lines().find(|line| line.starts_with("log ")).unwrap();
    assert!(row.matches(" - ").count() >= 5 && !row.contains("0.00"), "{row}");
}
