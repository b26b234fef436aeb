//! `labels`: annotations made of tags, read by other programs and held against the truth.

use std::fs;
use std::path::Path;
use std::process::Command;

use glam::{DVec2, DVec3};
use realitysim::config::Settings;
use realitysim::database::ImageDatabase;
use realitysim::geometry::Isometry;
use realitysim::labels::Class;
use realitysim::ros2::messages::PoseStamped;
use serde_json::Value;

use super::database::at;
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

/// Names and pixels of the visible landmarks of an image in a folder of the form png.
fn visible(folder: &Path, file: &str) -> Vec<(String, DVec2)> {
    let table = fs::read_to_string(folder.join("keypoints.csv")).unwrap();
    let row = |line: &str| match line.split(',').collect::<Vec<_>>()[..] {
        [of, name, u, v, _, "visible"] if of == file => {
            Some((name.to_owned(), DVec2::new(u.parse().unwrap(), v.parse().unwrap())))
        }
        _ => None,
    };
    table.lines().filter_map(row).collect()
}

/// Depths against the formula: the height over the slope of the ray.
#[test]
fn depths_are_those_of_the_ground_and_0_outside_of_the_lens_circle() {
    let room = recorded();
    room.run("labels db --format png -o png").succeeds();
    let database = ImageDatabase::open(&room.path("db"), &Settings::default().views).unwrap();
    let record = database.index().record(3);
    let depths = image::open(room.path("png/depth/000003.png")).unwrap().to_luma16();
    let pose = record.pose() * Isometry::link_from_optical();
    let lens = database.camera(&record).unwrap().lens();
    let landmarks = visible(&room.path("png"), "000003.jpg");
    assert!(landmarks.len() > 5);
    for (name, at) in landmarks {
        let pixel = at.round();
        let ray = pose.transform_vector(lens.unproject(pixel).unwrap());
        let expected_mm = 1000.0 * pose.translation.z / -ray.z;
        let found_mm = f64::from(depths.get_pixel(pixel.x as u32, pixel.y as u32).0[0]);
        assert!((found_mm / expected_mm - 1.0).abs() < 0.01, "{name}: {found_mm} {expected_mm}");
    }
    let classes = image::open(room.path("png/classes/000003.png")).unwrap().to_luma8();
    let shown = database.camera(&record).unwrap().shows();
    for ((class, depth), shown) in classes.pixels().zip(depths.pixels()).zip(shown) {
        let is_ground = class.0[0] == Class::Carpet as u8 || class.0[0] == Class::Line as u8;
        assert!(!is_ground || depth.0[0] > 0);
        assert!(*shown || depth.0[0] == 0);
    }
    assert!(shown.contains(&false));
}

#[test]
fn a_view_where_an_image_was_taken_has_the_labels_of_the_image() {
    let room = recorded();
    room.run("labels db --format png -o png").succeeds();
    let database = ImageDatabase::open(&room.path("db"), &Settings::default().views).unwrap();
    let (pose, _) = at(&database, 3);
    room.run(&format!("view --db db {pose} -o view.jpg --labels of-view")).succeeds();
    assert_eq!(fs::read(room.path("of-view/images/view.jpg")).unwrap(), fs::read(room.path("view.jpg")).unwrap());
    let classes = |path: &str| image::open(room.path(path)).unwrap().to_luma8().into_raw();
    let (of_view, of_image) = (classes("of-view/classes/view.png"), classes("png/classes/000003.png"));
    let is_known = |(a, b): &(&u8, &u8)| **a != Class::Ignore as u8 && **b != Class::Ignore as u8;
    let known: Vec<(&u8, &u8)> = of_view.iter().zip(&of_image).filter(is_known).collect();
    assert!(known.len() * 2 > of_view.len() && known.iter().all(|(a, b)| a == b), "{}", known.len());
    let (of_view, of_image) = (visible(&room.path("of-view"), "view.jpg"), visible(&room.path("png"), "000003.jpg"));
    assert!(!of_view.is_empty() && of_view.len() == of_image.len());
    for ((name, a), (other, b)) in of_view.iter().zip(&of_image) {
        assert!(name == other && a.distance(*b) < 0.02, "{name} {a} {b}");
    }
    for file in ["depth/view.png", "border.csv", "classes.txt", "preview.jpg"] {
        assert!(room.path("of-view").join(file).is_file(), "{file}");
    }
    room.run(&format!("view --db db {pose} -o view.jpg --labels of-view")).fails(2, &["of-view", "not empty"]);
    room.run(&format!("view --db db {pose} -o view.jpg --labels db/labels")).fails(2, &["db/labels"]);
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
