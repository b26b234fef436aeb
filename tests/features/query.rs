//! Questions in SQL that the program answers by itself.

use std::fs;

use crate::replay::catalogue::{ask_documented_queries, catalogued, only_file};

#[test]
fn a_query_has_the_answer_of_duckdb() {
    ask_documented_queries(&[env!("CARGO_BIN_EXE_realitysim")]);
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
