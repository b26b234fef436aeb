//! Questions in SQL that the program answers by itself.

use std::fs;

use serde_json::Value;

use crate::replay::catalogue::{ask_documented_queries, catalogued, only_file};

#[test]
fn a_query_has_the_answer_of_duckdb() {
    ask_documented_queries(&[env!("CARGO_BIN_EXE_realitysim")]);
}

#[test]
fn sessions_are_listed_by_what_is_in_them() {
    let (room, replayed) = catalogued();
    let list = |condition: &str| room.run_words(&["sessions", "list", "--json", "--where", condition], &[]);
    let names = |condition: &str| {
        let rows: Vec<Value> = serde_json::from_str(&list(condition).succeeds().stdout).unwrap();
        rows.into_iter().map(|row| row["session"].as_str().unwrap().to_owned()).collect::<Vec<_>>()
    };
    let name = replayed.session.file_name().unwrap().to_str().unwrap();
    assert_eq!(names("valid and x_m < -1.5"), [name]);
    assert_eq!(names("x_m > 2 or robot = 'nobody'"), [""; 0]);
    assert_eq!(names("valid"), [name]);
    let job = |condition: &str| {
        room.run_words(&["job", "captures", "--step", "check", "-o", "results", "--json", "--where", condition], &[])
    };
    assert_eq!(job("x_m > 2").succeeds().json()["sessions"], 0);
    assert_eq!(job("valid").succeeds().json()["sessions"], 1);
    list("nothing > 2").fails(2, &["nothing", "the table is frames"]);
    room.replay("log.mcap");
    let run = list("valid").succeeds();
    assert!(run.stderr.contains("1 of 2 sessions are not in the catalogue and left out"), "{run:?}");
    fs::remove_dir_all(room.path("catalogue")).unwrap();
    list("valid").fails(2, &["--where", "catalogue rebuild"]);
}

#[test]
fn a_query_that_cannot_be_asked_is_a_wrong_call() {
    let (room, _) = catalogued();
    let ask = |folder: &str, sql: &str| room.run_words(&["catalogue", "query", folder, sql], &[]);
    let table = ask("catalogue", "select count(*) as frames from frames").succeeds().stdout;
    assert!(table.contains("| frames |"), "{table}");
    ask("catalogue", "select nothing from frames").fails(2, &["nothing", "the table is frames"]);
    ask("catalogue", "drop table frames").fails(2, &["the table is frames"]);
    ask("none", "select 1").fails(1, &["none"]);
    fs::write(only_file(&room), "PAR1").unwrap();
    ask("catalogue", "select count(x_m) from frames").fails(1, &["`realitysim catalogue show`"]);
}
