//! `export --to colmap` and `--to nerfstudio`: what programs that learn a scene are given.

use std::collections::BTreeMap;
use std::fs;
use std::process::Command;

use glam::DVec3;
use realitysim::config::Settings;
use realitysim::database::ImageDatabase;
use realitysim::geometry::Isometry;
use serde_json::{Value, json};

use super::support::{Room, session_name};

/// Names a Python interpreter that has OpenCV.
const INTERPRETER: &str = "REALITYSIM_PYTHON";

/// The standard walk as a capture and as a database `db`; the capture's folder is returned.
fn recorded() -> (Room, String) {
    let room = Room::with_walk();
    let session = session_name(&room.replay("log.mcap"));
    room.run(&format!("db add {session} --db db")).succeeds();
    (room, session)
}

/// For each image: points of the field that its camera has before it, and where it shows them.
fn expected(database: &ImageDatabase) -> Value {
    let dimensions = database.field().dimensions();
    let (x, y) = (dimensions.length_m / 2.0, dimensions.width_m / 2.0);
    let points = [[-x, -y], [-x, y], [x, -y], [x, y], [0.0, -y], [0.0, y], [0.0, 0.0], [0.5, 0.3]];
    let of_image = |(number, record): (usize, realitysim::database::Record)| {
        let optical_from_map = (record.pose() * Isometry::link_from_optical()).inverse();
        let lens = database.camera(&record).unwrap().lens();
        let seen = points.iter().filter_map(|[x, y]| {
            let point = DVec3::new(*x, *y, 0.0);
            let ray = optical_from_map.transform_point(point);
            let pixel = lens.project(ray).filter(|_| ray.z > 0.05)?;
            Some(([point.x, point.y, point.z], [pixel.x, pixel.y]))
        });
        let (points, pixels): (Vec<_>, Vec<_>) = seen.unzip();
        (format!("{number:06}.jpg"), json!([points, pixels]))
    };
    json!(database.index().records().enumerate().map(of_image).collect::<BTreeMap<_, _>>())
}

#[test]
fn another_reader_of_a_training_set_sees_points_where_the_tag_puts_them() {
    let Some(python) = std::env::var_os(INTERPRETER) else {
        println!("skipped: {INTERPRETER} names no interpreter");
        return;
    };
    let (room, _) = recorded();
    for trainer in ["colmap", "nerfstudio"] {
        let report = room.run(&format!("export db --to {trainer} -o {trainer} --json")).succeeds().json();
        assert!(report["written"].as_u64() > Some(10), "{report}");
    }
    let database = ImageDatabase::open(&room.path("db"), &Settings::default().views).unwrap();
    room.write("points.json", expected(&database).to_string());
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/replay/check_trainers.py");
    let folders = ["colmap", "nerfstudio", "points.json"].map(|name| room.path(name));
    let output = Command::new(python).arg(script).args(folders).output().unwrap();
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{said}{}", String::from_utf8_lossy(&output.stderr));
    println!("points and largest distance, px: {said}");
    let numbers: Vec<f64> = said.split_whitespace().map(|number| number.parse().unwrap()).collect();
    assert!(numbers[0] > 100.0 && numbers[1] <= 0.01, "{said}");
}

#[test]
fn a_capture_gives_the_same_training_set_as_its_database() {
    let (room, session) = recorded();
    room.run(&format!("export {session} --to colmap -o of_capture")).succeeds();
    room.run("export db --to colmap -o of_database").succeeds();
    for file in ["sparse/0/cameras.txt", "sparse/0/images.txt", "sparse/0/points3D.txt", "held_out.txt", "light.json"] {
        let [ours, theirs] =
            ["of_capture", "of_database"].map(|folder| fs::read(room.path(folder).join(file)).unwrap());
        assert!(ours == theirs && !ours.is_empty(), "{file}");
    }
    let images = fs::read_dir(room.path("of_capture/images")).unwrap().count();
    let held_out = fs::read_to_string(room.path("of_capture/held_out.txt")).unwrap().lines().count();
    assert_eq!(held_out, (images + 3) / 8);
    assert_eq!(fs::read_dir(room.path("of_capture/masks")).unwrap().count(), images);
}

#[test]
fn a_training_set_that_cannot_be_made_leaves_nothing_behind() {
    let (room, session) = recorded();
    let run = room.run(&format!("export {session} --to colmap -o none --max-sigma 0.001"));
    run.fails(1, &["--max-sigma"]);
    let run = room.run("export db --to nerfstudio -o none --max-sigma 0.001");
    run.fails(1, &["position is known to 0.001 m", "realitysim refine"]);
    assert_eq!(fs::read_dir(room.path("none")).unwrap().count(), 0);
    room.run(&format!("export {session} --to tum -o tags.tum --max-sigma 0.1")).fails(2, &["--max-sigma"]);
    room.run("export db --to tum -o tags.tum").fails(1, &["db"]);
}
