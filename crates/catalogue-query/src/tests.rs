//! The answers of a small catalogue, and what is refused.

use std::fs;

use realitysim_catalogue::{CatalogueRow, FileHead, parquet_of_rows};
use tempfile::TempDir;

use super::*;

/// Two robots on two days; every fourth frame has no valid tag.
fn catalogue() -> (TempDir, Vec<CatalogueRow>) {
    let folder = tempfile::tempdir().unwrap();
    let mut all = Vec::new();
    for (day, robot) in [(27, "r1"), (28, "r1"), (28, "../a b")] {
        let rows: Vec<CatalogueRow> = (0..2000).map(|number| row(number, day)).collect();
        let name = robot.replace("../", "..%2F").replace(' ', "%20");
        let session = folder.path().join(format!("field=kid-2020/date=2026-11-{day}/robot={name}"));
        fs::create_dir_all(&session).unwrap();
        fs::write(session.join("a.parquet"), parquet_of_rows(&FileHead::default(), &rows).unwrap()).unwrap();
        all.extend(rows);
    }
    (folder, all)
}

fn row(number: i64, day: i64) -> CatalogueRow {
    let valid = number % 4 > 0;
    let at = |value: f32| valid.then_some(value);
    CatalogueRow {
        sequence: number,
        stamp_ns: day * 1_000_000_000 + number,
        valid,
        reason: if valid { "" } else { "no_lines" }.to_owned(),
        x_m: at(number as f32 / 256.0 - 4.0),
        y_m: at(day as f32 / 256.0),
        yaw_deg: at(number as f32 % 180.0),
        ..CatalogueRow::default()
    }
}

#[test]
fn an_answer_is_that_of_a_loop_over_all_rows() {
    let (folder, rows) = catalogue();
    let ask = |sql: &str| query(folder.path(), sql).unwrap().json_lines().unwrap();
    let valid = rows.iter().filter(|row| row.valid).count();
    let counted =
        ask("select count(*) as frames, count(*) filter (where valid) as valid, max(stamp_ns) as last from frames");
    assert_eq!(counted, format!("{{\"frames\":{},\"valid\":{valid},\"last\":28000001999}}\n", rows.len()));
    let within = |row: &&CatalogueRow| row.x_m.is_some_and(|x| (-1.0..=1.5).contains(&x)) && row.yaw_deg < Some(90.0);
    let found = ask("select count(*) as n from frames where x_m between -1.0 and 1.5 and yaw_deg < 90");
    assert_eq!(found, format!("{{\"n\":{}}}\n", rows.iter().filter(within).count()));
    let reasons = ask("select reason, count(*) as n from frames where not valid group by reason");
    assert_eq!(reasons, format!("{{\"reason\":\"no_lines\",\"n\":{}}}\n", rows.len() - valid));
}

/// DataFusion takes the names of folders as they are, where DuckDB decodes them.
#[test]
fn names_of_folders_are_columns() {
    let (folder, _) = catalogue();
    let sql =
        "select robot, date, count(*) as n from frames where date = '2026-11-28' group by robot, date order by robot";
    let said = query(folder.path(), sql).unwrap().json_lines().unwrap();
    let expected = "{\"robot\":\"..%2Fa%20b\",\"date\":\"2026-11-28\",\"n\":2000}\n{\"robot\":\"r1\",\"date\":\"2026-11-28\",\"n\":2000}\n";
    assert_eq!(said, expected);
    let table = query(folder.path(), "select robot from frames where robot = 'none'").unwrap().table().unwrap();
    assert!(table.contains("robot"), "{table}");
}

#[test]
fn only_questions_are_answered() {
    let (folder, _) = catalogue();
    let out = folder.path().join("out.parquet");
    let copy = format!("copy (select * from frames) to '{}'", out.display());
    let location = format!("create external table t stored as parquet location '{}'", folder.path().display());
    for sql in [
        "selekt 1",
        "",
        "select nothing from frames",
        "select * from elsewhere",
        "select * from '/etc/passwd'",
        "drop table frames",
        "create table t as select 1",
        "insert into frames select * from frames",
        "set datafusion.execution.batch_size = 1",
        &copy,
        &location,
    ] {
        let refused = query(folder.path(), sql);
        assert!(matches!(refused, Err(QueryError::Sql(_))), "{sql}: {refused:?}");
        assert!(refused.unwrap_err().to_string().contains("the table is frames"));
    }
    assert!(!out.exists());
}

#[test]
fn a_file_that_is_not_whole_gives_no_answer() {
    let (folder, _) = catalogue();
    let file = folder.path().join("field=kid-2020/date=2026-11-27/robot=r1/a.parquet");
    fs::write(&file, "PAR1, and no more").unwrap();
    let said = query(folder.path(), "select count(x_m) from frames").unwrap_err().to_string();
    assert!(said.contains("`realitysim catalogue show`"), "{said}");
    let none = tempfile::tempdir().unwrap();
    assert!(matches!(query(none.path(), "select 1"), Err(QueryError::Catalogue(CatalogueError::None { .. }))));
}
