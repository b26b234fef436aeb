//! `labels`: annotations made of tags, read by other programs and held against the truth.

use std::fs;
use std::process::Command;

use glam::{DVec2, DVec3};
use realitysim::config::Settings;
use realitysim::database::ImageDatabase;
use realitysim::geometry::Isometry;
use realitysim::ros2::messages::PoseStamped;
use serde_json::Value;

use super::support::{Room, TRUTH, decode_all, session_name, walk};

/// Names a Python interpreter that has OpenCV and pycocotools.
const INTERPRETER: &str = "REALITYSIM_PYTHON";

/// The standard walk as a database `db`.
fn recorded() -> Room {
    let room = Room::with_walk();
    let session = session_name(&room.replay("log.mcap"));
    room.run(&format!("db add {session} --db db")).succeeds();
    room
}

#[test]
fn other_readers_of_labels_find_the_lines_of_the_picture() {
    let Some(python) = std::env::var_os(INTERPRETER) else {
        println!("skipped: {INTERPRETER} names no interpreter");
        return;
    };
    let room = recorded();
    let forms = ["coco", "yolo", "yolo-seg", "yolo-pose", "png"];
    for form in forms {
        let report = room.run(&format!("labels db --format {form} -o {form} --json")).succeeds().json();
        assert!(report["images"].as_u64() > Some(10) && report["ignored_share"].as_f64() < Some(0.2), "{report}");
    }
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/replay/check_labels.py");
    let output = Command::new(python).arg(script).args(forms.map(|form| room.path(form))).output().unwrap();
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{said}{}", String::from_utf8_lossy(&output.stderr));
    println!("{said}");
    let judged: Value = serde_json::from_str(said.lines().last().unwrap()).unwrap();
    assert!(judged["judged"].as_u64() > Some(10) && judged["iou"].as_f64() > Some(0.9), "{judged}");
}

/// The landmarks of an image are where its true pose puts them, and nearly always within twice the error that they state.
#[test]
fn landmarks_are_where_the_true_pose_puts_them() {
    let room = recorded();
    room.run("labels db --format png -o png").succeeds();
    let database = ImageDatabase::open(&room.path("db"), &Settings::default().views).unwrap();
    let truths: Vec<PoseStamped> = decode_all(&walk().messages, TRUTH);
    let d = database.field().dimensions().clone();
    let corner = |name: &str| {
        let side = |axis: char| if name.contains(&format!("-{axis}")) { -0.5 } else { 0.5 };
        name.starts_with("corner").then(|| DVec3::new(side('x') * d.length_m, side('y') * d.width_m, 0.0))
    };
    let (mut judged, mut within, mut worst) = (0, 0, 0.0f64);
    for line in fs::read_to_string(room.path("png/keypoints.csv")).unwrap().lines().skip(1) {
        let [file, name, u, v, sigma, _] = line.split(',').collect::<Vec<_>>()[..] else { panic!("{line}") };
        let record = database.index().record(file[..6].parse().unwrap());
        let stamp = |truth: &&PoseStamped| truth.header.stamp.to_nanoseconds() == record.stamp_ns;
        let (Some(at), Some(truth)) = (corner(name), truths.iter().find(stamp)) else { continue };
        let optical_from_map = (Isometry::from(truth.pose) * Isometry::link_from_optical()).inverse();
        let lens = database.camera(&record).unwrap().lens();
        let true_pixel = lens.project(optical_from_map.transform_point(at)).unwrap();
        let found = DVec2::new(u.parse().unwrap(), v.parse().unwrap());
        let off = found.distance(true_pixel);
        judged += 1;
        within += u32::from(off <= 2.0 * sigma.parse::<f64>().unwrap() + 0.02);
        worst = worst.max(off);
    }
    println!("{judged} corners, {within} within two standard deviations, at most {worst:.2} px off");
    assert!(judged > 20 && worst < 1.0, "{judged} {worst}");
    assert!(10 * within >= 8 * judged, "{within} of {judged}");
}

#[test]
fn labels_that_cannot_be_made_leave_nothing_behind() {
    let room = recorded();
    room.run("labels db --format coco -o none --max-sigma 0.001").fails(1, &["position is known to 0.001 m", "refine"]);
    assert_eq!(fs::read_dir(room.path("none")).unwrap().count(), 0);
    room.run("labels db --format coco --classes booster -o none").fails(2, &["--classes"]);
    fs::create_dir(room.path("damaged")).unwrap();
    room.write("damaged/database.json", "{");
    room.run("labels damaged --format coco -o none").fails(1, &["damaged/database.json"]);
    room.run("labels nowhere --format coco -o none").fails(1, &["nowhere"]);
    fs::create_dir(room.path("full")).unwrap();
    room.write("full/a.txt", "mine");
    room.run("labels db --format coco -o full").fails(2, &["full", "not empty"]);
    assert_eq!(fs::read_to_string(room.path("full/a.txt")).unwrap(), "mine");
    room.run("labels db --format coco -o db").fails(2, &["db"]);
}
