//! A suite of logs and scenes, held to its limits.

use realitysim::ros2::messages::PoseStamped;
use realitysim::ros2::messages::{Odometry, PoseWithCovarianceStamped};

use super::support::{Room, TRUTH, changed, decode_all, message, on, walk};

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
fn a_case_s_reference_of_another_log_seed_or_version_is_named_and_not_compared() {
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
