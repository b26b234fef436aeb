//! The truth in a log is for judging only: it is never read, and tags are near it.

use realitysim::ros2::messages::PoseStamped;
use serde_json::Value;

use super::support::{Room, TRUTH, assert_same, changed, on, own_log, read_capture, session_name, walk, without};

#[test]
fn tags_do_not_depend_on_the_truth() {
    let blind = Room::with_log(&without(&walk().messages, TRUTH));
    assert_same(&blind.replay("log.mcap").tags, &walk().tags, "without the truth");

    let mut sign = 1.0;
    let nonsense = changed::<PoseStamped>(&walk().messages, TRUTH, |truth| {
        sign = -sign;
        truth.pose.position.x = 100.0 * sign;
        truth.pose.orientation.z = f64::NAN;
        truth.header.frame_id = "moon".into();
    });
    let misled = Room::with_log(&nonsense);
    assert_same(&misled.replay("log.mcap").tags, &walk().tags, "with nonsense as truth");
}

#[test]
fn a_capture_holds_no_truth() {
    assert_eq!(on(&walk().messages, TRUTH).count(), walk().frames(), "there is something to leak");
    let room = Room::with_walk();
    let replayed = room.replay("log.mcap");
    assert_eq!(on(&read_capture(&replayed.session), TRUTH).count(), 0);
    let info = room.run(&format!("log info {} --json", replayed.session.display())).succeeds().json();
    assert!(!info.to_string().contains("ground_truth"), "{info}");
}

/// Bounds of about three times what is found today: they are to catch what breaks, not to measure.
#[test]
fn tags_of_the_walk_are_near_the_truth() {
    let room = Room::with_walk();
    let replayed = room.replay("log.mcap");
    let run = room.run(&format!("eval {} --truth log.mcap --json", replayed.session.display())).succeeds();
    let judged = run.json();
    let number =
        |path: &str| judged.pointer(path).and_then(Value::as_f64).unwrap_or_else(|| panic!("{path}: {judged}"));
    println!("{judged}");
    assert_eq!(number("/frames") as usize, walk().frames());
    assert_eq!(number("/without_truth"), 0.0);
    assert!(number("/valid") >= 0.9 * number("/frames"), "{judged}");
    for (path, bound) in [
        ("/position_cm/mean", 10.0),
        ("/position_cm/median", 10.0),
        ("/position_cm/p95", 18.0),
        ("/position_cm/max", 25.0),
        ("/yaw_deg/mean", 3.0),
        ("/yaw_deg/max", 10.0),
        ("/tilt_deg/mean", 2.0),
        ("/roll_deg/mean", 2.0),
        ("/pitch_deg/mean", 2.0),
        ("/nees", 6.0),
    ] {
        assert!(number(path) < bound, "{path} is {}, above {bound}: {judged}", number(path));
    }
    assert!(number("/position_cm/mean") > 0.1, "too good to be found by the filter: {judged}");
    assert!(number("/ellipse95_share") > 0.5, "{judged}");
}

/// The walk's truth, changed, as `truth.mcap`.
fn with_truth(change: impl FnMut(&mut PoseStamped)) -> (Room, String) {
    let room = Room::with_walk();
    let session = session_name(&room.replay("log.mcap"));
    let truth: Vec<_> = on(&walk().messages, TRUTH).cloned().collect();
    room.write("truth.mcap", own_log(&changed::<PoseStamped>(&truth, TRUTH, change)));
    (room, session)
}

#[test]
fn the_truth_of_another_time_is_an_error_that_says_so() {
    let (room, session) = with_truth(|truth| truth.header.stamp.sec += 3600);
    let words =
        ["truth.mcap", "the tags are of 2025-10-09 08:53:20", "the truth is of 2025-10-09 09:53:20", "another walk"];
    room.run(&format!("eval {session} --truth truth.mcap")).fails(1, &words);
}

#[test]
fn the_truth_of_another_walk_at_the_same_time_is_doubted() {
    let (room, session) = with_truth(|truth| truth.pose.position.y += 3.0);
    let run = room.run(&format!("eval {session} --truth truth.mcap --json")).fails(0, &["truth.mcap", "another walk"]);
    assert!(run.json()["warning"].as_str().unwrap().contains("median 3."), "{run:?}");
    let right = room.run(&format!("eval {session} --truth log.mcap --json")).succeeds();
    assert!(right.json()["warning"].is_null() && right.stderr.is_empty(), "{right:?}");
}

#[test]
fn tags_in_the_other_half_of_the_field_are_told_from_wrong_ones() {
    let (room, session) = with_truth(|truth| {
        let pose = &mut truth.pose;
        (pose.position.x, pose.position.y) = (-pose.position.x, -pose.position.y);
        // Half a turn about z.
        let q = pose.orientation;
        (pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w) = (-q.y, q.x, q.w, -q.z);
    });
    room.run(&format!("eval {session} --truth truth.mcap")).fails(0, &["other half of the field", "--initial"]);
}
