//! `measure gap --detector`: a detector with known errors gets its own figures back.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Command;

use glam::DVec2;
use realitysim::geometry::Isometry;
use realitysim::labels::{LANDMARK_CLASSES, Landmark, landmarks};
use realitysim::localization::random::{Purpose, Stream};
use realitysim::ros2::messages::PoseStamped;
use serde_json::Value;

use super::database::{open, walked};
use super::support::{Room, TRUTH, decode_all, walk};

/// Names a Python interpreter that has numpy.
const INTERPRETER: &str = "REALITYSIM_PYTHON";
/// Probability that the made-up detector finds a landmark.
const FOUND: f64 = 0.7;
/// Its bias in the picture, pixels to the right and down.
const BIAS_PX: DVec2 = DVec2::new(0.6, -0.4);
/// Its standard deviation in each direction, pixels.
const SIGMA_PX: f64 = 1.0;
/// Its false detections of X-crossings in a picture.
const FALSE_ONES: f64 = 0.5;
/// Pictures that it looks at.
const FRAMES: usize = 20;
/// Forms of a picture that it looks at, one after the other; the first is the recorded one.
const FORMS: usize = 5;

/// The landmarks that are visible in each image by its label: class, and the pixel where the true pose puts it.
fn visible_landmarks(room: &Room) -> BTreeMap<usize, Vec<(&'static str, DVec2)>> {
    room.run("labels db --format png -o png").succeeds();
    let database = open(room);
    let truths: Vec<PoseStamped> = decode_all(&walk().messages, TRUTH);
    let known: BTreeMap<String, Landmark> =
        landmarks(database.field()).into_iter().map(|landmark| (landmark.name.clone(), landmark)).collect();
    let mut images: BTreeMap<usize, Vec<_>> = BTreeMap::new();
    for line in fs::read_to_string(room.path("png/keypoints.csv")).unwrap().lines().skip(1) {
        let [file, name, _, _, _, "visible"] = line.split(',').collect::<Vec<_>>()[..] else { continue };
        let number: usize = file[..6].parse().unwrap();
        let record = database.index().record(number);
        let truth = truths.iter().find(|truth| truth.header.stamp.to_nanoseconds() == record.stamp_ns).unwrap();
        let optical_from_map = (Isometry::from(truth.pose) * Isometry::link_from_optical()).inverse();
        let lens = database.camera(&record).unwrap().lens();
        let at = lens.project(optical_from_map.transform_point(known[name].at)).unwrap();
        let class = LANDMARK_CLASSES.class(known[name].kind).map(|class| (LANDMARK_CLASSES.names[class], at));
        images.entry(number).or_default().extend(class);
    }
    images
}

/// What the made-up detector says of a recorded image. Its false detections are far from all X-crossings.
fn answer(landmarks: &[(&str, DVec2)], frame: u64) -> String {
    let mut random = Stream::new(11, Purpose::Motion, frame, 0, 0);
    let mut text = String::new();
    for (class, at) in landmarks {
        let noise = DVec2::new(random.normal(), random.normal()) * SIGMA_PX;
        if random.uniform() < FOUND {
            // The first pixel's centre is (0.5, 0.5) to a detector.
            let found = *at + BIAS_PX + noise + 0.5;
            text += &format!("{class} {} {}\n", found.x, found.y);
        }
    }
    if random.uniform() < FALSE_ONES {
        let is_far = |at: &DVec2| landmarks.iter().all(|(_, landmark)| landmark.distance(*at) > 25.0);
        let drawn = std::iter::repeat_with(|| DVec2::new(320.0 * random.uniform(), 120.0 + 120.0 * random.uniform()));
        let at = drawn.take(1000).find(is_far).expect("room");
        text += &format!("x_crossing {} {} {} {} 0.9\n", at.x - 2.0, at.y - 2.0, at.x + 3.0, at.y + 3.0);
    }
    text
}

/// A detector that says, one after the other, what is in the files `answers/0`, `answers/1`, ... The first picture comes twice.
const SCRIPT: &str = "#!/bin/sh\ncd \"$(dirname \"$0\")\"\nn=-1\nwhile read -r name; do\n[ $n -lt 0 ] || cat \"answers/$n\"\n\
                      n=$((n + 1))\necho $n > count\necho\ndone\n";

fn write_detector(room: &Room) -> usize {
    let (landmarks, count) = (visible_landmarks(room), open(room).index().len());
    fs::create_dir(room.path("answers")).unwrap();
    let mut to_be_seen = 0;
    for frame in 0..FRAMES {
        let number = (2 * frame + 1) * count / (2 * FRAMES);
        for form in 0..FORMS {
            let text = if form == 0 { answer(&landmarks[&number], frame as u64) } else { String::new() };
            room.write(&format!("answers/{}", frame * FORMS + form), text);
        }
        to_be_seen += landmarks[&number].len();
    }
    write_script(room, "detector.sh", SCRIPT);
    to_be_seen
}

fn write_script(room: &Room, name: &str, text: &str) {
    use std::os::unix::fs::PermissionsExt;
    room.write(name, text);
    fs::set_permissions(room.path(name), fs::Permissions::from_mode(0o755)).unwrap();
}

/// A mean over the classes, weighted by `weight`.
fn mean(cells: &[Value], value: &str, weight: &str) -> (f64, f64) {
    let of = |cell: &Value, pointer: &str| cell.pointer(pointer).and_then(Value::as_f64).unwrap_or(0.0);
    let all: f64 = cells.iter().map(|cell| of(cell, weight)).sum();
    (cells.iter().map(|cell| of(cell, value) * of(cell, weight)).sum::<f64>() / all, all)
}

#[test]
fn a_detector_with_known_errors_gets_them_back() {
    let (room, _) = walked();
    let to_be_seen = write_detector(&room);
    let detector = room.path("detector.sh").display().to_string();
    let gap = "measure gap --db db --apart 0.03 --json";
    let run = room
        .run(&format!("{gap} --frames {FRAMES} --detector {detector} --error-model model.json -o gap.png"))
        .succeeds();
    assert_eq!(fs::read_to_string(room.path("count")).unwrap().trim(), (FRAMES * FORMS).to_string());
    let rows = run.json();
    let cells = |form: usize| rows[form]["detector"]["cells"].as_array().unwrap().clone();
    let whole = |cell: &Value| cell["distance_m"].is_null() && cell["light"].is_null();
    let recorded: Vec<Value> = cells(0).into_iter().filter(whole).collect();

    let (found, count) = mean(&recorded, "/detection_probability/value", "/to_be_seen");
    assert_eq!(count as usize, to_be_seen);
    assert!((found - FOUND).abs() < 3.0 * (FOUND * (1.0 - FOUND) / count).sqrt(), "{found} of {count}");
    // Farther away, crossings of one class are nearer to each other than the detector can tell.
    let is_near = |cell: &Value| cell["light"].is_null() && cell["distance_m"][1].as_f64().is_some_and(|to| to <= 4.0);
    let near: Vec<Value> = cells(0).into_iter().filter(is_near).collect();
    let (right, count) = mean(&near, "/pixel/bias_px/0", "/pixel/count");
    let (down, _) = mean(&near, "/pixel/bias_px/1", "/pixel/count");
    // The tags of a walk share an error, which is in the bias.
    let bound = 3.0 * SIGMA_PX / count.sqrt() + 0.3;
    assert!(DVec2::new(right, down).distance(BIAS_PX) < bound, "{right} {down}, not within {bound}");
    for place in ["/pixel/covariance_px2/0/0", "/pixel/covariance_px2/1/1"] {
        let (variance, _) = mean(&near, place, "/pixel/count");
        assert!((variance.sqrt() / SIGMA_PX - 1.0).abs() < 3.0 / (2.0 * count).sqrt(), "{place}: {variance}");
    }
    let x_crossings = recorded.iter().find(|cell| cell["class"] == "x_crossing").unwrap();
    let wrong = &x_crossings["false_per_picture"];
    assert!(wrong["low"].as_f64() < Some(FALSE_ONES) && Some(FALSE_ONES) < wrong["high"].as_f64(), "{wrong}");
    let others = recorded.iter().filter(|cell| cell["class"] != "x_crossing");
    assert!(others.map(|cell| cell["false_detections"].as_u64().unwrap()).sum::<u64>() <= 3, "{recorded:?}");
    for form in 1..FORMS {
        assert!(cells(form).iter().all(|cell| cell["found"] == 0 && cell["false_detections"] == 0));
    }

    let model: Value = serde_json::from_str(&fs::read_to_string(room.path("model.json")).unwrap()).unwrap();
    assert_eq!((&model["realitysim_error_model"], &model["pictures"]), (&1.into(), &FRAMES.into()));
    let of_model: Vec<Value> =
        model["classes"].as_object().unwrap().values().flat_map(|cells| cells.as_array().unwrap().clone()).collect();
    let base = of_model.iter().filter(|cell| cell["off_axis_deg"].is_null() && cell["speed_deg_s"].is_null());
    assert_eq!(base.map(|cell| cell["to_be_seen"].as_u64().unwrap() as usize).sum::<usize>(), to_be_seen);
    assert!(of_model.iter().any(|cell| cell["off_axis_deg"].is_array() && cell["speed_deg_s"].is_array()));
    assert!(model["delay_ms"]["median"].as_f64() <= model["delay_ms"]["p99"].as_f64(), "{model}");
    assert!(image::open(room.path("gap.png")).is_ok());
    samples_agree(&room);
}

/// The Python package samples from the model what is in it.
fn samples_agree(room: &Room) {
    let Some(python) = std::env::var_os(INTERPRETER) else {
        println!("skipped: {INTERPRETER} names no interpreter");
        return;
    };
    let repository = Path::new(env!("CARGO_MANIFEST_DIR"));
    let output = Command::new(python)
        .arg("-B")
        .arg(repository.join("tests/replay/check_perception.py"))
        .arg(room.path("model.json"))
        .env("PYTHONPATH", repository.join("clients/python"))
        .output()
        .expect("python");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    assert!(output.status.success(), "{}{}", text(&output.stdout), text(&output.stderr));
    assert!(text(&output.stdout).contains("samples agree"));
}

#[test]
fn a_detector_that_fails_is_named_and_leaves_no_file() {
    let (room, _) = walked();
    write_script(&room, "late.sh", "#!/bin/sh\nfor time in 1 2 3; do read -r name; echo; done\nfalse\n");
    write_script(&room, "babbling.sh", "#!/bin/sh\nwhile read -r name; do echo \"$name\"; echo; done\n");
    let [late, babbling] = ["late.sh", "babbling.sh"].map(|name| room.path(name).display().to_string());
    let gap = "measure gap --db db --frames 2 --apart 0.03 -o gap.png --error-model model.json --detector";
    for (command, words) in [
        (late.as_str(), &["--detector", "late.sh", "exit status: 1"][..]),
        ("/bin/echo", &["--detector", "/bin/echo", "ended with exit status: 0", "end each answer with an empty line"]),
        (babbling.as_str(), &["babbling.sh", "line 1", "is none of l_crossing", "`class u v [score]`"]),
        ("/no/such", &["--detector", "/no/such", "127"]),
    ] {
        room.run(&format!("{gap} {command}")).fails(1, words);
        assert!(!room.path("gap.png").exists() && !room.path("model.json").exists(), "{command}");
    }
    room.run("measure gap --db db --error-model model.json").fails(2, &["--detector"]);
    room.run("measure gap --db db --detector true --error-model db/model.json").fails(2, &["db/model.json"]);
}
