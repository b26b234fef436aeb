//! `tag`: the pose of single images, how far it may be trusted, and what makes no sense.

use std::fmt::Write;
use std::fs;
use std::path::Path;

use glam::{DQuat, DVec3};
use realitysim::geometry::Isometry;
use realitysim::log_input::scene_source::{self, SceneSource};
use realitysim::ros2::LogMessage;
use realitysim::ros2::messages::{CameraInfo, CompressedImage, PoseStamped};
use serde_json::Value;

use super::support::{CAMERA_INFO, IMAGE, LENS, Room, TRUTH, decode_all, read_log, walk};

const KNOWN: &str = "--lens lens.toml --attitude 0,17 --height 0.49";

/// With the walk's first frame, a black image and one of noise.
fn room() -> Room {
    let room = Room::new();
    room.write("lens.toml", LENS);
    let images: Vec<CompressedImage> = decode_all(&walk().messages, IMAGE);
    room.write("frame.jpg", &images[0].data);
    image::RgbImage::new(320, 240).save(room.path("black.png")).unwrap();
    let mut state = 1u32;
    let noise = image::RgbImage::from_fn(320, 240, |_, _| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        image::Rgb([(state >> 24) as u8, (state >> 16) as u8, (state >> 8) as u8])
    });
    noise.save(room.path("noise.png")).unwrap();
    room
}

#[test]
fn a_frame_of_the_walk_is_found() {
    let room = room();
    let report = room.run(&format!("tag frame.jpg {KNOWN} --field kid-2009 --json")).succeeds().json();
    assert!(report["fit"] == "good" || report["fit"] == "doubtful", "{report}");
    let place = |pose: &Value| [pose["x"].as_f64().unwrap(), pose["y"].as_f64().unwrap()];
    let tagged = &walk().tags[0].pose.pose.position;
    let off = |[x, y]: [f64; 2]| (x - tagged.x).hypot(y - tagged.y);
    let nearest = off(place(&report["best"]["pose"])).min(off(place(&report["mirror"])));
    assert!(nearest < 0.3, "{nearest} m off: {report}");
    let near = room.run(&format!("tag frame.jpg {KNOWN} --field kid-2009 --initial -1.9,0.2,10 --json"));
    assert_eq!(near.succeeds().json()["fit"], "good");
}

#[test]
fn an_image_that_nothing_fits_has_no_pose() {
    let room = room();
    for (image, field) in [("black.png", ""), ("noise.png", "--field kid-2009 --initial 0,0,0")] {
        let run = room.run(&format!("tag {image} {KNOWN} {field}")).fails(1, &[image, "no pose found", "--attitude"]);
        assert_eq!(run.stdout, "", "no pose is printed that somebody might use");
    }
    let report = room.run(&format!("tag noise.png {KNOWN} --json")).fails(1, &["no pose found"]);
    assert_eq!(report.json()["fit"], "none");
}

#[test]
fn what_cannot_be_is_named() {
    let room = room();
    let lens = "--lens lens.toml";
    for (arguments, words) in [
        (format!("{lens} --attitude 0,200 --height 0.5"), ["--attitude", "pitch_deg is 200: it must be -90 to 90"]),
        (format!("{lens} --attitude -181,0 --height 0.5"), ["--attitude", "roll_deg is -181: it must be -180 to 180"]),
        (format!("{lens} --attitude 0,20 --height 0"), ["--height is 0", "0.01 to 100 m"]),
        (format!("{lens} --attitude 0,20 --height 500"), ["--height is 500", "0.01 to 100 m"]),
        (format!("{KNOWN} --sheet out.png --overlay out.png"), ["--overlay is of one image", "--sheet"]),
        (
            format!("{KNOWN} --initial 9,0,0 --field kid-2009"),
            ["--initial is 9,0", "kid-2009 reaches from -3.70 to 3.70"],
        ),
        (format!("{KNOWN} --initial 90,0,0"), ["--initial is 90,0", "reaches from"]),
        (format!("{KNOWN} --overlay out.txt"), ["out.txt", ".png"]),
        (format!("{KNOWN} --attitude-sigma 30"), ["--attitude-sigma", "it is 30: it must be 0 to 5"]),
    ] {
        room.run(&format!("tag frame.jpg {arguments}")).fails(2, &words);
    }
}

/// Calls `each` with the true pose of every so many frames of path-traced turf (tests/data/turf), with the frame written as `frame.jpg` and
/// its lens as `camera.yaml`.
fn turf_frames(room: &Room, name: &str, step: usize, mut each: impl FnMut(Isometry)) {
    let log = format!("{}/tests/data/turf/{name}.mcap", env!("CARGO_MANIFEST_DIR"));
    let messages = read_log(Path::new(&log));
    let info: Vec<CameraInfo> = decode_all(&messages, CAMERA_INFO);
    room.write("camera.yaml", calibration(&info[0]));
    let images: Vec<CompressedImage> = decode_all(&messages, IMAGE);
    let truths: Vec<PoseStamped> = decode_all(&messages, TRUTH);
    for image in images.iter().step_by(step) {
        room.write("frame.jpg", &image.data);
        let truth = truths.iter().find(|truth| truth.header.stamp == image.header.stamp).expect("of every frame");
        let (p, q) = (truth.pose.position, truth.pose.orientation);
        each(Isometry::new(DQuat::from_xyzw(q.x, q.y, q.z, q.w), DVec3::new(p.x, p.y, p.z)));
    }
}

/// Metres in the plane, metres of height, and the larger of the degrees of roll and pitch, by which a report is off.
fn off(report: &Value, truth: &Isometry) -> [f64; 3] {
    let number = |value: &Value| value.as_f64().expect("a number");
    let at = truth.translation;
    let place = |pose: &Value| (number(&pose["x"]) - at.x).hypot(number(&pose["y"]) - at.y);
    let tilt = truth.euler();
    let degrees = |key: &str, truth: f64| (number(&report[key]) - truth.to_degrees()).abs();
    let off_m = place(&report["best"]["pose"]).min(place(&report["mirror"]));
    let off_deg = degrees("roll_deg", tilt.roll).max(degrees("pitch_deg", tilt.pitch));
    [off_m, (number(&report["z"]) - at.z).abs(), off_deg]
}

/// Each frame has its attitude given two degrees wrong.
#[test]
fn the_tilt_is_found_from_the_lines() {
    let room = Room::new();
    let (mut right, mut all) = (0, 0);
    for name in ["worn", "lamps"] {
        turf_frames(&room, name, 3, |truth| {
            let (tilt, direction) = (truth.euler(), f64::from(all) * 0.8);
            let (roll_deg, pitch_deg) = (tilt.roll.to_degrees(), tilt.pitch.to_degrees());
            let given = format!("{:.3},{:.3}", roll_deg + 2.0 * direction.cos(), pitch_deg + 2.0 * direction.sin());
            let height_m = truth.translation.z;
            let known = format!("--lens camera.yaml --attitude={given} --height {height_m:.3} --field kid-2020 --json");
            let report = room.run(&format!("tag frame.jpg {known}")).json();
            let [off_m, _, off_deg] = off(&report, &truth);
            println!("{name} {given}: {}, {off_m:.3} m and {off_deg:.2} deg off", report["fit"]);
            let is_right = off_m < 0.05 && off_deg < 0.5;
            assert!(is_right || report["fit"] != "good", "{report}");
            all += 1;
            right += i32::from(is_right);
        });
    }
    assert!(right >= all - 1, "{right} of {all}");
}

#[test]
#[ignore = "takes minutes: `cargo test --release --test integration -- --ignored --nocapture the_mount_is_found`"]
fn the_mount_is_found_from_the_lines_of_turf_or_refused() {
    let room = Room::new();
    let (mut right, mut refused, mut all) = (0, 0, 0);
    for name in ["worn", "lamps"] {
        turf_frames(&room, name, 1, |truth| {
            let report = room.run("tag frame.jpg --lens camera.yaml --field kid-2020 --json").json();
            let [off_m, off_z_m, off_deg] = off(&report, &truth);
            println!("{name}: {}, {off_m:.3} m, {off_z_m:.3} m of height and {off_deg:.2} deg off", report["fit"]);
            let is_right = off_m < 0.1 && off_z_m < 0.03 && off_deg < 1.0;
            assert!(is_right || report["fit"] != "good", "{report}");
            all += 1;
            right += i32::from(is_right && report["fit"] != "none");
            refused += i32::from(report["fit"] == "none");
        });
    }
    println!("{right} right and {refused} refused of {all}");
    assert!(3 * right >= 2 * all && right + refused == all, "{right} right and {refused} refused of {all}");
}

fn calibration(info: &CameraInfo) -> String {
    format!(
        "image_width: {}\nimage_height: {}\ncamera_name: camera\ncamera_matrix:\n  data: {:?}\ndistortion_model: {}\n\
         distortion_coefficients:\n  data: {:?}\n",
        info.width, info.height, info.k, info.distortion_model, info.d
    )
}

/// A picture that `./dev attack` damaged: its sum of contrast is largest half a metre from where it was taken, and that was called good.
#[test]
fn half_a_picture_is_not_found_elsewhere() {
    let room = room();
    room.write("frame.jpg", include_bytes!("../data/pictures/damaged.jpg"));
    let report = room.run(&format!("tag frame.jpg {KNOWN} --field kid-2009 --initial=-1.96,0.1,3 --json")).json();
    let of = |key: &str| report["best"]["pose"][key].as_f64().unwrap();
    let off_m = (of("x") + 1.96).hypot(of("y") - 0.1);
    assert!(off_m < 0.1 || report["fit"] != "good", "{off_m} m off: {report}");
}

/// Pictures of lines 12 cm wide: looked for as if they were 5 cm wide, some are not found.
#[test]
fn a_picture_of_wide_lines_is_found_on_its_field() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/replay/scenes/field-22x14.toml");
    let scene = scene_source::load(Path::new(path)).unwrap();
    let mut images = 0;
    let is_early = |message: &LogMessage| {
        images += i32::from(message.channel.topic == IMAGE);
        images <= 60
    };
    let messages: Vec<LogMessage> = SceneSource::new(&scene).map(Result::unwrap).take_while(is_early).collect();
    let info: Vec<CameraInfo> = decode_all(&messages, CAMERA_INFO);
    let truths: Vec<PoseStamped> = decode_all(&messages, TRUTH);
    let images: Vec<CompressedImage> = decode_all(&messages, IMAGE);
    let room = Room::new();
    room.write("camera.yaml", calibration(&info[0]));
    for (number, image) in images.iter().step_by(30).enumerate() {
        room.write("frame.jpg", &image.data);
        let truth = truths.iter().find(|truth| truth.header.stamp == image.header.stamp).expect("of every frame");
        let (p, q) = (truth.pose.position, truth.pose.orientation);
        let tilt = Isometry::new(DQuat::from_xyzw(q.x, q.y, q.z, q.w), DVec3::ZERO).euler();
        let attitude = format!("{:.3},{:.3}", tilt.roll.to_degrees() + 0.5, tilt.pitch.to_degrees() - 0.5);
        // All fields take long: they are tried once.
        let fields: &[&str] = if number == 0 { &["--field hsl-large-2026", ""] } else { &["--field hsl-large-2026"] };
        for field in fields {
            let known = format!("--lens camera.yaml --attitude={attitude} --height {:.3} {field} --json", p.z);
            let report = room.run(&format!("tag frame.jpg {known}")).succeeds().json();
            let off = |pose: &Value| (pose["x"].as_f64().unwrap() - p.x).hypot(pose["y"].as_f64().unwrap() - p.y);
            let off_m = off(&report["best"]["pose"]).min(off(&report["mirror"]));
            println!("{field} {}: {} {off_m:.3} m off, {}", report["field"], report["fit"], report["fields"]);
            assert_eq!(report["field"], "hsl-large-2026", "{report}");
            assert!(report["fit"] == "good" && off_m < 0.05, "{off_m} m off: {report}");
        }
    }
}

/// Every sixth frame of the walk in a folder, a black picture, and a table of what is known of each. Returns the true poses by name.
fn folder(room: &Room) -> Vec<(String, Isometry)> {
    fs::create_dir(room.path("frames")).unwrap();
    let images: Vec<CompressedImage> = decode_all(&walk().messages, IMAGE);
    let truths: Vec<PoseStamped> = decode_all(&walk().messages, TRUTH);
    let mut table = "image,roll_deg,pitch_deg,height,x,y,yaw_deg\nblack.png,0,17,0.49,,,\n".to_owned();
    fs::copy(room.path("black.png"), room.path("frames/black.png")).unwrap();
    let mut poses = Vec::new();
    for (index, (image, truth)) in images.iter().zip(&truths).enumerate().step_by(6) {
        let name = format!("{index}.jpg");
        room.write(&format!("frames/{name}"), &image.data);
        let pose = Isometry::from(truth.pose);
        let (euler, place) = (pose.euler(), pose.translation);
        let [roll, pitch, yaw] = [euler.roll, euler.pitch, euler.yaw].map(f64::to_degrees);
        let about = format!("{:.1},{:.1},{yaw:.0}", place.x + 0.1, place.y - 0.1);
        writeln!(table, "{name},{:.1},{:.1},{:.3},{about}", roll + 1.0, pitch - 1.0, place.z).unwrap();
        poses.push((name, pose));
    }
    room.write("tilts.csv", table);
    poses
}

#[test]
fn a_folder_is_tagged_and_its_poses_make_a_database() {
    let room = room();
    let truths = folder(&room);
    let outputs = "--sheet sheet.png --poses frames/poses.csv";
    let known = "--lens lens.toml --attitude-csv tilts.csv --field kid-2009";
    let run = room.run(&format!("tag frames {known} {outputs} --json")).succeeds();
    let reports: Vec<Value> = run.stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let names: Vec<&str> = reports.iter().map(|report| report["image"].as_str().unwrap()).collect();
    assert_eq!(names[..3], ["frames/0.jpg", "frames/6.jpg", "frames/12.jpg"], "in the natural order of names");
    assert_eq!(reports.last().unwrap()["fit"], "none", "black.png shows nothing");
    let table = fs::read_to_string(room.path("frames/poses.csv")).unwrap();
    let mut good = 0;
    for line in table.lines().skip(1) {
        let cells: Vec<&str> = line.split(',').collect();
        let (_, truth) = truths.iter().find(|(name, _)| name == cells[0]).expect("one of the frames");
        let number = |index: usize| cells[index].parse::<f64>().unwrap();
        let off_m = (number(1) - truth.translation.x).hypot(number(2) - truth.translation.y);
        let off_deg = (number(4) - truth.euler().yaw.to_degrees())
            .abs()
            .max((number(5) - truth.euler().pitch.to_degrees()).abs());
        let (sigma_m, sigma_deg) = (number(7), number(8));
        println!("{line}: {off_m:.4} m, {off_deg:.3} deg off");
        assert!(off_m < 0.03 && off_deg < 0.5, "{line}: {off_m} m, {off_deg} deg off");
        assert!((1e-4..0.05).contains(&sigma_m) && (1e-3..1.0).contains(&sigma_deg), "{line}");
        assert!(off_m < 5.0 * sigma_m, "{line}: {off_m} m off");
        good += 1;
    }
    assert!(good + 1 >= truths.len(), "{good} of {}", truths.len());
    let sheet = image::open(room.path("sheet.png")).unwrap();
    assert!(sheet.width() > 1600 && sheet.height() > 600, "{} x {}", sheet.width(), sheet.height());
    let added = room.run("db add frames --db db --field kid-2009 --json").succeeds().json();
    assert_eq!((&added["images"], &added["assumed"]), (&Value::from(good), &Value::from(0)));
    // A page of a capture that somebody keeps is not replaced by poses.
    room.write("frames/poses.csv", "something else");
    room.run(&format!("tag frames {known} {outputs}")).fails(2, &["frames/poses.csv", "not of the kind"]);
}

#[test]
fn attitude_and_height_are_found_from_the_lines_or_refused() {
    let room = room();
    let truths = folder(&room);
    let (mut right, mut refused) = (0, 0);
    // The first shows a mark and the far circle, the last the whole circle from near.
    for (name, truth) in [&truths[0], &truths[truths.len() - 1]] {
        let known = "--lens lens.toml --field kid-2009 --json";
        let report = room.run(&format!("tag frames/{name} {known}")).json();
        let [off_m, off_z_m, off_deg] = off(&report, truth);
        println!("{name}: {}, {off_m:.3} m, {off_z_m:.3} m of height, {off_deg:.2} deg off", report["fit"]);
        let is_right = off_m < 0.1 && off_z_m < 0.03 && off_deg < 1.0;
        assert!(is_right || report["fit"] == "none", "{report}");
        right += u32::from(is_right && report["fit"] != "none");
        refused += u32::from(report["fit"] == "none");
    }
    assert!(right >= 1, "{refused} refused, none found");
}

#[test]
fn a_folder_of_many_cameras_is_refused_with_the_picture_s_name() {
    let room = room();
    folder(&room);
    image::RgbImage::new(64, 48).save(room.path("frames/7.png")).unwrap();
    let run = room.run(&format!("tag frames {KNOWN} --field kid-2009 --poses frames/poses.csv"));
    run.fails(2, &["frames/7.png", "320 x 240", "64 x 48"]);
    assert!(!room.path("frames/poses.csv").exists(), "nothing half-written is left");
    room.write("notes.csv", "image,roll_deg,pitch_deg\nother.jpg,0,0\n");
    let run = room.run(&format!("tag frames {KNOWN} --field kid-2009 --attitude-csv notes.csv"));
    run.fails(1, &["notes.csv", "no row names one of the"]);
}
