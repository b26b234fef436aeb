//! Bags that rosbag2 wrote as SQLite databases: the command that the program tells converts them.

use std::process::Command;

use super::support::{Room, assert_same, walk};

/// Names a Python interpreter that has rosbags.
const INTERPRETER: &str = "REALITYSIM_PYTHON";

#[test]
fn the_command_that_is_told_converts_a_bag() {
    let Some(python) = std::env::var_os(INTERPRETER) else {
        assert!(std::env::var("CI").is_err(), "{INTERPRETER} is not set: `./dev test` sets it");
        println!("skipped: {INTERPRETER} names no interpreter");
        return;
    };
    let converter = std::path::Path::new(&python).with_file_name("rosbags-convert");
    let room = Room::with_walk();
    let convert = |arguments: &str| {
        let output = Command::new(&converter).args(arguments.split(' ')).current_dir(room.path(".")).output().unwrap();
        assert!(output.status.success(), "{arguments}: {}", String::from_utf8_lossy(&output.stderr));
    };
    convert("--src log.mcap --dst bag --dst-storage sqlite3");
    for (bag, new) in [("bag/bag.db3", "from_file"), ("bag", "from_folder")] {
        let refused = room.run(&format!("replay {bag} -o captures")).fails(1, &["bag.db3", "SQLite"]);
        let (_, told) = refused.stderr.split_once("rosbags-convert ").expect("a command");
        convert(&told.trim_end().replace("BAG", bag).replace("NEW", new));
        assert_same(&room.replay(new).tags, &walk().tags, bag);
    }
}
