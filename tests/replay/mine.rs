//! `labels mine`: a detector of ten lines is held against the truth.

use std::fs;

use serde_json::Value;

use super::support::{Room, session_name};

/// A database `db` of the standard walk.
fn recorded() -> Room {
    let room = Room::with_walk();
    let session = session_name(&room.replay("log.mcap"));
    room.run(&format!("db add {session} --db db")).succeeds();
    room
}

/// Writes a detector that prints, for a picture, the lines of a table `found/NNNNNN.txt`, after it did `first`.
fn detector(room: &Room, name: &str, first: &str) {
    let tables = room.path("found").display().to_string();
    let answer = format!("cat \"{tables}/$(basename \"$picture\" .png).txt\"; echo");
    room.write(name, format!("while read -r picture; do\n{first}\n{answer}\ndone\n"));
}

/// The boxes that `labels --format yolo` makes, as a detector would print them; `change` may alter the lines of an image.
fn write_truth(room: &Room, change: impl Fn(usize, Vec<String>) -> Vec<String>) {
    const NAMES: [&str; 6] = ["l_crossing", "t_crossing", "x_crossing", "penalty_mark", "centre", "goalpost"];
    fs::create_dir_all(room.path("found")).unwrap();
    let mut files: Vec<_> =
        fs::read_dir(room.path("yolo/labels")).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    for (place, file) in files.iter().enumerate() {
        let line = |line: &str| {
            let n: Vec<f64> = line.split(' ').map(|word| word.parse().unwrap()).collect();
            let [x, y, w, h] = [n[1] * 320.0, n[2] * 240.0, n[3] * 320.0, n[4] * 240.0];
            let [left, top, right, bottom] = [x - w / 2.0, y - h / 2.0, x + w / 2.0, y + h / 2.0];
            format!("{} {left:.2} {top:.2} {right:.2} {bottom:.2} 0.9", NAMES[n[0] as usize])
        };
        let text = fs::read_to_string(file).unwrap();
        let lines = change(place, text.lines().map(line).collect());
        let name = format!("found/{}", file.file_name().unwrap().to_str().unwrap());
        room.write(&name, lines.iter().map(|line| format!("{line}\n")).collect::<String>());
    }
}

#[test]
fn a_miss_and_a_false_detection_come_first() {
    let room = recorded();
    room.run("labels db --format yolo -o yolo").succeeds();
    write_truth(&room, |_, lines| lines);
    detector(&room, "detect.sh", "");
    let own = format!("sh {}", room.path("detect.sh").display());
    let mine = |out: &str| room.run_words(&["labels", "mine", "db", "--detector", &own, "-o", out, "--json"], &[]);
    let same = mine("same").succeeds().json();
    assert!(same["right"].as_u64() > Some(20) && same["displaced"] == 0 && same["false"] == 0, "{same}");
    assert!(fs::exists(room.path("same/disagreements.csv")).unwrap());
    write_truth(&room, |place, mut lines| {
        match place {
            3 => lines.clear(),
            5 => lines.push("x_crossing 160 200 1".to_owned()),
            _ => {}
        }
        lines
    });
    let report = mine("wrong").succeeds().json();
    assert!(report["missed"].as_u64() > same["missed"].as_u64() && report["false"] == 1, "{report}");
    let list = fs::read_to_string(room.path("wrong/disagreements.csv")).unwrap();
    let rows: Vec<Vec<&str>> = list.lines().skip(1).map(|line| line.split(',').collect()).collect();
    let certainty = |row: &[&str]| row[5].parse::<f64>().unwrap();
    assert!(rows.is_sorted_by(|a, b| certainty(a) >= certainty(b)), "{list}");
    assert_eq!((rows[0][2], rows[0][3], &rows[0][8..10]), ("false", "x_crossing", &["160.00", "200.00"][..]), "{list}");
    let of: Value = report["frames"][0]["image"].clone();
    assert_eq!(of.to_string(), rows[0][0], "{report}");
    assert!(image::open(room.path("wrong/sheet.jpg")).unwrap().width() > 500);
}

#[test]
fn a_detector_that_fails_is_named_with_its_picture() {
    let room = recorded();
    room.run("labels db --format yolo -o yolo").succeeds();
    write_truth(&room, |place, lines| if place == 2 { vec!["nonsense 1 2".to_owned()] } else { lines });
    let mine = |name: &str, out: &str| {
        let own = format!("sh {}", room.path(name).display());
        room.run_words(&["labels", "mine", "db", "--detector", &own, "-o", out], &[])
    };
    detector(&room, "nonsense.sh", "");
    let said = ["000002.png", "line 1", "\"nonsense\" is none of l_crossing"];
    mine("nonsense.sh", "some").fails(3, &said);
    assert!(fs::exists(room.path("some/disagreements.csv")).unwrap());
    detector(&room, "dies.sh", "case $picture in *1.png) exit 4;; esac");
    mine("dies.sh", "died").fails(3, &["000001.png", "exit status: 4"]);
    detector(&room, "always.sh", "exit 5");
    mine("always.sh", "always").fails(1, &["failed for each of 5 images", "000000.png", "exit status: 5"]);
    assert_eq!(fs::read_dir(room.path("always")).unwrap().count(), 0);
}
