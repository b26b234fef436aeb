//! A recorder of an older version, and browsers that watch the same one.

use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::stand_in::recorder;
use super::watch::Watch;
use crate::replay::support::Room;
use crate::service::client::get;

fn line(value: &Value) -> Vec<u8> {
    format!("{value}\n").into_bytes()
}

/// Knows no order `frame`, and says little of itself.
fn older(order: &str) -> Vec<u8> {
    match order {
        "status" => line(&json!({ "state": "recording", "recorder": { "frames_synced": 3 }, "rates": {} })),
        _ => line(&json!({ "error": "expected status, mark TEXT, place X,Y,YAW_DEG, start, stop or poses" })),
    }
}

/// Says what no present version understands.
fn newer(order: &str) -> Vec<u8> {
    match order {
        "status" => line(&json!({ "state": "dreaming" })),
        _ => [line(&json!({ "bytes": 4, "tag": { "sequence": 1 }, "lens": 5 })), b"\xff\xd8\xff\xd9".to_vec()].concat(),
    }
}

#[test]
fn an_older_recorder_is_shown_as_far_as_it_tells() {
    let room = Room::new();
    recorder(&room.path("control.sock"), older);
    let watch = Watch::of(&room.path(""), &["control.sock"]);
    let state = watch.waits_for("it is asked for a frame", |state| !state["no_frame"].is_null());
    assert_eq!((&state["connected"], &state["status"]["state"]), (&true.into(), &"recording".into()));
    assert!(state["words"][0].as_str().is_some_and(|words| words.starts_with("recording")), "{state}");
    assert_eq!(state["no_frame"], "the recorder on the robot is older and sends no pictures: update it");
    assert_eq!(get(watch.address(), "/v1/live/frame").status, 404);
    assert_eq!(get(watch.address(), "/").status, 200);
}

#[test]
fn a_recorder_that_is_not_understood_is_said_to_be() {
    let room = Room::new();
    recorder(&room.path("control.sock"), newer);
    let watch = Watch::of(&room.path(""), &["control.sock"]);
    let state = watch.waits_for("it is asked for a frame", |state| !state["no_frame"].is_null());
    assert!(state["words"][0].as_str().is_some_and(|words| words.contains("another version")), "{state}");
    assert!(state["no_frame"].as_str().is_some_and(|why| why.contains("its frames are not understood")), "{state}");
    assert_eq!(state["frame"], Value::Null, "what is shown is understood");
    assert_eq!(get(watch.address(), "/v1/live/frame").status, 404);
}

#[test]
fn many_browsers_ask_the_recorder_no_more_than_one_does() {
    let room = Room::new();
    let orders = recorder(&room.path("control.sock"), newer);
    let began = Instant::now();
    let watch = Watch::of(&room.path(""), &["control.sock"]);
    let address = watch.address();
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                while began.elapsed() < Duration::from_secs(2) {
                    assert_eq!(get(address, "/v1/live").status, 200);
                    let _ = get(address, "/v1/live/frame");
                }
            });
        }
    });
    watch.waits_for("a frame", |state| !state["no_frame"].is_null());
    let orders = orders.lock().expect("whole");
    let frames = orders.iter().filter(|order| order.starts_with("frame")).count();
    // Five a second, however many browsers look, and one that was under way.
    let limit = (5.0 * began.elapsed().as_secs_f64()) as usize + 1;
    assert!((1..=limit).contains(&frames), "{frames} of at most {limit}");
}
