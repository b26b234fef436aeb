//! How many views a second the page shows while somebody walks. docs/howto/page.md has the figure.

use std::fs;
use std::path::Path;
use std::process::Command;

use super::Served;
use crate::replay::support::{Room, session_name};

const INTERPRETER: &str = "REALITYSIM_PYTHON";
/// What the page must show on a machine that does nothing else.
const LEAST_VIEWS_PER_S: f64 = 20.0;

#[test]
#[ignore = "a measurement, for a machine that does nothing else: docs/howto/page.md"]
fn twenty_views_a_second_of_640_by_480_in_a_browser() {
    let room = Room::new();
    room.write("scene.toml", fs::read_to_string("replay/scenes/straight.toml").expect("a scene"));
    room.run("scene render scene.toml -o log.mcap").succeeds();
    let session = session_name(&room.replay("log.mcap"));
    room.run(&format!("db add {session} --db db")).succeeds();
    let served = Served::of(room, "");
    let page = format!("http://{}/#walk?x=0&y=0.1&z=0.49&yaw=2&pitch=17", served.address);
    let python = std::env::var_os(INTERPRETER).expect("an interpreter with websockets");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/service/view_rate.py");
    let output = Command::new(python).arg("-B").arg(script).args([&page, "chromium"]).output().expect("python");
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{said}{}", String::from_utf8_lossy(&output.stderr));
    println!("{said}");
    let figures: serde_json::Value = serde_json::from_str(&said).expect("JSON");
    assert_eq!(figures["size"], "640x480");
    assert!(figures["mean"].as_f64().is_some_and(|mean| mean >= LEAST_VIEWS_PER_S), "{said}");
}
