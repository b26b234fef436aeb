//! The truth in a log is for judging only: it is never read, and tags are near it.

use realitysim::ros2::messages::PoseStamped;
use serde_json::Value;

use super::support::{Room, TRUTH, assert_same, changed, on, read_capture, walk, without};

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
    let info = room.run(&format!("info {} --json", replayed.session.display())).succeeds().json();
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
