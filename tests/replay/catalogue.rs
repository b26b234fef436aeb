//! The catalogue from end to end: captures in, rows out, in other programs too.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use realitysim::catalogue::{CatalogueRow, read_rows};
use realitysim::recording::FolderLock;

use super::support::{CAPTURES, IMAGE, Replayed, Room, on, read_capture, session_name};

/// Names a Python interpreter that has DuckDB and Polars.
const INTERPRETER: &str = "REALITYSIM_PYTHON";

/// The standard walk as a capture and in a catalogue `catalogue`.
pub fn catalogued() -> (Room, Replayed) {
    let room = Room::with_walk();
    let replayed = room.replay("log.mcap");
    room.run(&format!("catalogue rebuild {CAPTURES} -o catalogue")).succeeds();
    (room, replayed)
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
        if entry.is_dir() { files.extend(self::files(&entry)) } else { files.push(entry) }
    }
    files
}

pub fn only_file(room: &Room) -> PathBuf {
    let files = files(&room.path("catalogue"));
    assert_eq!(files.len(), 1, "{files:?}");
    files[0].clone()
}

#[test]
fn each_row_is_its_tag_and_leads_to_its_image() {
    let (room, Replayed { session, tags, .. }) = catalogued();
    let mut rows = read_rows(&only_file(&room)).unwrap();
    rows.sort_by_key(|row| row.sequence);
    let messages = read_capture(&session);
    let images: Vec<_> = on(&messages, IMAGE).collect();
    assert_eq!([rows.len(), images.len()], [tags.len(); 2]);
    for ((row, tag), image) in rows.iter().zip(&tags).zip(images) {
        let of_tag = (tag.header.stamp.to_nanoseconds(), tag.valid, tag.reason.as_str());
        assert_eq!((row.stamp_ns, row.valid, row.reason.as_str()), of_tag);
        assert_eq!(row.x_m.is_some(), tag.valid);
        if let CatalogueRow { x_m: Some(x), yaw_deg: Some(yaw), sigma_y_m: Some(sigma), .. } = row {
            assert!((f64::from(*x) - tag.pose.pose.position.x).abs() < 1e-4);
            assert!((f64::from(*yaw) - tag.yaw.to_degrees()).abs() < 5e-3);
            assert!((f64::from(*sigma).powi(2) / tag.pose.covariance[7] - 1.0).abs() < 0.01);
        }
        let segment = fs::read(session.join(row.segment.as_ref().unwrap())).unwrap();
        let from = row.offset.unwrap() as usize;
        let bytes = &segment[from..from + row.length.unwrap() as usize];
        assert!(bytes == image.data);
        assert_eq!(blake3::hash(bytes).as_bytes()[..16], row.blake3.unwrap());
    }
}

#[test]
fn a_rebuild_gives_the_same_files_whatever_was_there() {
    let (room, replayed) = catalogued();
    let file = only_file(&room);
    let bytes = fs::read(&file).unwrap();
    fs::write(&file, &bytes[..bytes.len() / 2]).unwrap();
    let gone = file.with_file_name("gone.parquet");
    fs::write(&gone, &bytes[..100]).unwrap();
    room.run("catalogue show catalogue").fails(3, &["gone.parquet", "no whole file of a catalogue", "rebuild"]);
    room.run(&format!("catalogue rebuild {CAPTURES} -o catalogue")).succeeds();
    assert!(only_file(&room) == file && fs::read(&file).unwrap() == bytes);
    room.run(&format!("catalogue add {} -o catalogue", session_name(&replayed))).succeeds();
    assert!(only_file(&room) == file && fs::read(&file).unwrap() == bytes);
    room.run("catalogue show catalogue").succeeds();
}

#[test]
fn a_session_that_changed_is_named_and_an_unreadable_one_keeps_its_rows() {
    let (room, replayed) = catalogued();
    let info = replayed.session.join("session.json");
    let text = fs::read_to_string(&info).unwrap();
    fs::write(&info, text.replacen("2025-10-09", "1970-01-01", 1)).unwrap();
    room.run("catalogue show catalogue").fails(3, &["changed since it was catalogued"]);
    let run = room.run(&format!("catalogue rebuild {CAPTURES} -o catalogue"));
    assert!(run.stderr.contains("the clocks differ"), "{run:?}");
    let file = only_file(&room);
    assert!(file.to_str().unwrap().contains("date=1970-01-01"), "{file:?}");
    fs::write(&info, text.replacen("\"started\":", "\"begun\":", 1)).unwrap();
    room.run(&format!("catalogue rebuild {CAPTURES} -o catalogue")).fails(1, &["session.json", "started"]);
    assert_eq!(only_file(&room), file);
    fs::remove_dir_all(&replayed.session).unwrap();
    room.run("catalogue show catalogue").fails(3, &["not there any more"]);
    room.run(&format!("catalogue rebuild {CAPTURES} -o catalogue")).fails(1, &["holds no capture"]);
    assert_eq!(only_file(&room), file);
}

#[test]
fn two_writers_of_a_catalogue_do_not_meet() {
    let (room, _) = catalogued();
    let lock = FolderLock::in_folder(&room.path("catalogue")).unwrap();
    let rebuild = format!("catalogue rebuild {CAPTURES} -o catalogue");
    room.run(&rebuild).fails(1, &["another process is changing this catalogue"]);
    drop(lock);
    room.run(&rebuild).succeeds();
}

#[test]
fn the_documented_queries_have_their_answers() {
    ask_documented_queries(&[]);
}

#[cfg(not(feature = "query"))]
#[test]
fn a_program_that_answers_no_query_says_which_one_does() {
    Room::new().run_words(&["catalogue", "query", "catalogue", "select 1"], &[]).fails(2, &["--features query"]);
}

/// Asks DuckDB, and these programs, what the document asks.
pub fn ask_documented_queries(programs: &[&str]) {
    let Some(python) = std::env::var_os(INTERPRETER) else {
        println!("skipped: {INTERPRETER} names no interpreter");
        return;
    };
    let (room, replayed) = catalogued();
    let root = env!("CARGO_MANIFEST_DIR");
    let script = format!("{root}/tests/replay/check_catalogue.py");
    let document = format!("{root}/docs/howto/catalogue.md");
    let output =
        Command::new(python).arg(script).arg(room.path("catalogue")).arg(document).args(programs).output().unwrap();
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{said}{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(said.trim(), format!("6 {}", replayed.tags.len()));
}

#[test]
fn the_catalogue_beside_captures_follows_refine_db_and_sync() {
    let (room, replayed) = catalogued();
    let session = session_name(&replayed);
    let before = fs::read(only_file(&room)).unwrap();
    let run = room.run(&format!("db add {session} --db images")).succeeds();
    assert!(!run.stderr.contains("catalogue") && fs::read(only_file(&room)).unwrap() == before, "{run:?}");
    let run = room.run(&format!("refine {session} --views 0")).succeeds();
    assert!(run.stderr.contains(&format!("catalogue: has {} rows of {session} now", replayed.tags.len())), "{run:?}");
    room.run("catalogue show catalogue").succeeds();
    // The rows of the file are those of a rebuild: the tags that `db add` takes.
    let followed = fs::read(only_file(&room)).unwrap();
    room.run(&format!("catalogue rebuild {CAPTURES} -o catalogue")).succeeds();
    assert!(fs::read(only_file(&room)).unwrap() == followed);

    fs::create_dir(room.path("home")).unwrap();
    room.run(&format!("catalogue rebuild {CAPTURES} -o home/catalogue")).succeeds();
    let run = room.run(&format!("sync {CAPTURES} -o home/captures")).succeeds();
    assert!(run.stderr.contains("home/catalogue: has"), "{run:?}");
    let text = room.run("catalogue show home/catalogue --json").succeeds().json();
    assert!(text[0]["capture"].as_str().unwrap().contains("home/captures"), "{text}");
    // Nothing changed: nothing is read again.
    let run = room.run(&format!("sync {CAPTURES} -o home/captures")).succeeds();
    assert!(!run.stderr.contains("catalogue"), "{run:?}");
}

#[test]
fn a_catalogue_that_cannot_follow_stops_no_command() {
    let (room, _) = catalogued();
    fs::create_dir(room.path("home")).unwrap();
    room.run(&format!("catalogue rebuild {CAPTURES} -o home/catalogue")).succeeds();
    let file = files(&room.path("home/catalogue")).remove(0);
    let bytes = fs::read(&file).unwrap();
    let at = bytes.windows(10).position(|part| part == b"\"format\":2").unwrap();
    let mut changed = bytes.clone();
    changed[at + 9] = b'9';
    fs::write(&file, &changed).unwrap();
    let run = room.run(&format!("sync {CAPTURES} -o home/captures")).succeeds();
    assert!(run.stderr.contains("not brought up to date") && run.stderr.contains("format 9"), "{run:?}");
    assert!(fs::read(&file).unwrap() == changed);
    room.run("catalogue show home/catalogue").fails(3, &["format 9"]);
}
