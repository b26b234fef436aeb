//! `falsify`: what is tagged while something false is said of a walk.

use realitysim::ros2::messages::PoseStamped;
use serde_json::Value;

use super::support::{Room, TRUTH, changed, walk, without};

/// Of real turf, twelve frames at 10 a second.
const WORN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/turf/worn.mcap");

#[test]
fn nothing_false_gives_a_valid_tag_that_is_wrong() {
    let room = Room::new();
    room.write("log.mcap", std::fs::read(WORN).expect("a log"));
    let report = room.run("measure falsify log.mcap --field kid-2020 --for 0.55 --json").succeeds().json();
    let controls = report["sources"][0]["controls"].as_array().expect("controls");
    let of_truth: Vec<&Value> = controls.iter().filter(|control| control["is_true"] == true).collect();
    assert_eq!(of_truth.len(), 2, "with the start announced and without");
    let frames = of_truth[0]["frames"].as_u64().expect("a number");
    assert!(frames >= 6 && of_truth[0]["valid"] == frames, "{}", of_truth[0]);
    let said = |what: &str| controls.iter().filter(|control| control["said"] == what).count();
    assert_eq!((said("field kid-2009"), said("field kid-2020"), said("focal length +10 %")), (2, 0, 2));
    assert_eq!(
        (report["wrong"].as_u64(), report["frames"].as_u64()),
        (Some(0), Some(frames * (controls.len() as u64 - 2)))
    );
}

/// A camera that stands 5 cm higher than it is said to is found from the lines: its tags are valid, here far from the truth.
#[test]
fn valid_tags_far_from_the_truth_are_a_failure() {
    let elsewhere = changed::<PoseStamped>(&walk().messages, TRUTH, |truth| truth.pose.position.x += 1.0);
    let run = Room::with_log(&elsewhere).run("measure falsify log.mcap --for 0.5 --json").fails(1, &[]);
    let report = run.json();
    assert!(report["wrong"].as_u64() > Some(0), "{report}");
    assert_eq!(report["wrong"], report["valid"], "{report}");
}

#[test]
fn a_log_without_truth_is_told_what_it_lacks() {
    let room = Room::with_log(&without(&walk().messages, TRUTH));
    room.run("measure falsify log.mcap").fails(2, &["log.mcap", "no ground truth"]);
}
