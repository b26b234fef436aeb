//! Pictures that look like a real field: blades of turf, greyish paint, sun and shade (tests/data/turf).

use serde_json::Value;

use super::support::{Room, session_name};

#[test]
fn faint_lines_on_turf_are_seen() {
    for name in ["worn", "lamps", "goal-in-sun", "goal-at-night"] {
        let room = Room::new();
        let log = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/turf");
        room.write("log.mcap", std::fs::read(format!("{log}/{name}.mcap")).expect("a log"));
        let replayed = room.replay("log.mcap --set field=kid-2020");
        let reasons: Vec<&str> = replayed.tags.iter().map(|tag| tag.reason.as_str()).collect();
        assert!(replayed.tags.iter().all(|tag| tag.valid), "{name}: {reasons:?}");
        let judged = room.run(&format!("eval {} --truth log.mcap --json", session_name(&replayed))).succeeds().json();
        println!("{name}: {}", judged["position_cm"]);
        let of = |pointer: &str| judged.pointer(pointer).and_then(Value::as_f64).expect("judged");
        assert!(of("/position_cm/mean") < 1.0 && of("/position_cm/max") < 3.0, "{name}: {judged}");
    }
}

/// The lines of one field are not those of another.
#[test]
fn turf_is_not_taken_for_another_field() {
    for (name, field) in [("worn", "kid-2009"), ("lamps", "kid-2014")] {
        let room = Room::new();
        let log = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/turf");
        room.write("log.mcap", std::fs::read(format!("{log}/{name}.mcap")).expect("a log"));
        let replayed = room.replay(&format!("log.mcap --set field={field}"));
        assert!(replayed.tags.iter().all(|tag| !tag.valid), "{name} on {field}");
    }
}
