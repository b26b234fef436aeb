//! Other readers must find in our logs what we wrote: the ones that people use in Python.

use std::process::Command;

use super::samples::every_message;

/// Names a Python interpreter that has mcap, mcap-ros2-support and rosbags.
const INTERPRETER: &str = "REALITYSIM_PYTHON";

#[test]
fn python_readers_agree() {
    let Some(python) = std::env::var_os(INTERPRETER) else {
        println!("skipped: {INTERPRETER} names no interpreter");
        return;
    };
    let directory = tempfile::tempdir().unwrap();
    let (log, written) = every_message();
    let (log_path, expected_path) = (directory.path().join("log.mcap"), directory.path().join("expected.json"));
    std::fs::write(&log_path, log).unwrap();
    std::fs::write(&expected_path, serde_json::to_vec(&written).unwrap()).unwrap();
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/ros2/check_readers.py");
    let output = Command::new(python).arg(script).arg(log_path).arg(expected_path).output().unwrap();
    let said = format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{said}");
    println!("{said}");
}
