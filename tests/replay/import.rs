//! `import`: pictures and tables of an outsider without ROS become a log that replays as the robot's own.

use std::fmt::Write;
use std::fs;
use std::os::unix::fs::PermissionsExt;

use glam::DQuat;
use realitysim::geometry::{Euler, Isometry, Pose2};
use realitysim::ros2::messages::{CompressedImage, FrameTag, Imu, Odometry, PoseStamped, PoseWithCovarianceStamped};

use super::support::{
    IMAGE, IMU, INITIAL, ODOMETRY, Replayed, Room, TRUTH, decode_all, farthest_apart, on, read_log, walk,
};

const MOUNT: &str = "--height 0.49 --mount 0.04,0,0.11,17";

/// The shared walk as an outsider has it: a folder of pictures, and what was measured meanwhile in tables.
fn room() -> Room {
    let room = Room::with_walk();
    room.write("lens.toml", super::support::LENS);
    fs::create_dir(room.path("frames")).unwrap();
    let mut stamps = "image,stamp\n".to_owned();
    for (index, image) in decode_all::<CompressedImage>(&walk().messages, IMAGE).iter().enumerate() {
        room.write(&format!("frames/{index}.jpg"), &image.data);
        let stamp = &image.header.stamp;
        writeln!(stamps, "{index}.jpg,{}.{:09}", stamp.sec, stamp.nanosec).unwrap();
    }
    room.write("stamps.csv", stamps);
    let mut imu = "stamp,qx,qy,qz,qw,gx_rad_s,gy_rad_s,gz_rad_s,ax,ay,az,temperature\n".to_owned();
    for sample in decode_all::<Imu>(&walk().messages, IMU) {
        let (q, g, a) = (&sample.orientation, &sample.angular_velocity, &sample.linear_acceleration);
        let ns = sample.header.stamp.to_nanoseconds();
        let numbers = [q.x, q.y, q.z, q.w, g.x, g.y, g.z, a.x, a.y, a.z].map(|number| number.to_string()).join(",");
        writeln!(imu, "{ns},{numbers},31.5").unwrap();
    }
    room.write("imu.csv", imu);
    let mut odometry = "Time [ms];X [mm];Y [mm];Yaw [deg]\n".to_owned();
    for step in decode_all::<Odometry>(&walk().messages, ODOMETRY) {
        let Pose2 { x, y, yaw } = Pose2::from_isometry(&Isometry::from(step.pose.pose));
        let ns = step.header.stamp.to_nanoseconds();
        let (ms, rest) = (ns / 1_000_000, ns % 1_000_000);
        writeln!(odometry, "{ms}.{rest:06};{:.4};{:.4};{:.5}", 1e3 * x, 1e3 * y, yaw.to_degrees()).unwrap();
    }
    room.write("odometry.csv", odometry);
    room
}

const TABLES: &str = "--imu imu.csv --odometry odometry.csv --lens lens.toml";

/// Replayed from the pose that the walk's log announces.
fn replayed(room: &Room, log: &str) -> Replayed {
    let announced: Vec<PoseWithCovarianceStamped> = decode_all(&walk().messages, INITIAL);
    let Pose2 { x, y, yaw } = Pose2::from_isometry(&Isometry::from(announced[0].pose.pose));
    room.replay(&format!("{log} --initial={x},{y},{}", yaw.to_degrees()))
}

/// Distance of each valid tag from the truth, metres.
fn errors_m(tags: &[FrameTag]) -> Vec<Option<f64>> {
    let truths: Vec<PoseStamped> = decode_all(&walk().messages, TRUTH);
    assert_eq!(truths.len(), tags.len());
    let of = |(tag, truth): (&FrameTag, &PoseStamped)| {
        let (p, q) = (&tag.pose.pose.position, &truth.pose.position);
        tag.valid.then(|| (p.x - q.x).hypot(p.y - q.y))
    };
    tags.iter().zip(&truths).map(of).collect()
}

fn assert_as_good_as_the_log(room: &Room, imported: &Replayed, what: &str) {
    let valid = imported.tags.iter().filter(|tag| tag.valid).count();
    assert!(100 * valid >= 95 * imported.tags.len(), "{what}: {valid} of {} valid", imported.tags.len());
    let own = replayed(room, "log.mcap");
    for (index, (found, expected)) in errors_m(&imported.tags).iter().zip(errors_m(&own.tags)).enumerate() {
        if let (Some(found), Some(expected)) = (found, expected) {
            assert!((found - expected).abs() < 1e-3, "{what}: frame {index}: {found} and {expected} m off");
        }
    }
    println!("{what}: {} m apart at most", farthest_apart(&imported.tags, &own.tags));
}

#[test]
fn a_folder_with_tables_is_tagged_as_well_as_its_log() {
    let room = room();
    let run = room.run(&format!("import frames --stamps stamps.csv {TABLES} {MOUNT} -o walk.mcap --json")).succeeds();
    let report = run.json();
    assert_eq!(report["pictures"], walk().frames());
    assert_eq!(report["tables"][0]["ignored_columns"][0], "temperature", "{report}");
    for words in ["imu.csv: not used: temperature", "stamps are nanoseconds", "stamps.csv: stamps are seconds"] {
        assert!(run.stderr.contains(words), "{words:?} is missing: {run:?}");
    }
    let messages = read_log(&room.path("walk.mcap"));
    let images: Vec<_> = on(&messages, IMAGE).map(|message| &message.data).collect();
    assert!(images.iter().zip(on(&walk().messages, IMAGE)).all(|(one, other)| **one == other.data), "bit for bit");
    assert_as_good_as_the_log(&room, &replayed(&room, "walk.mcap"), "poses");
    assert_eq!(fs::read_dir(room.path(".")).unwrap().filter(is_pending).count(), 0);
}

#[test]
fn velocities_and_names_with_times_do_as_well() {
    let room = room();
    fs::create_dir(room.path("named")).unwrap();
    for image in decode_all::<CompressedImage>(&walk().messages, IMAGE) {
        let ms = image.header.stamp.to_nanoseconds() / 1_000_000;
        room.write(&format!("named/left_{ms}.jpg"), &image.data);
    }
    let steps: Vec<Odometry> = decode_all(&walk().messages, ODOMETRY);
    let mut odometry = "t,vx,vy,wz\n".to_owned();
    // A velocity at the time of each pose that leads from the one before to it: half of both is the mean.
    let poses: Vec<(i64, Pose2)> = steps
        .iter()
        .map(|s| (s.header.stamp.to_nanoseconds(), Pose2::from_isometry(&Isometry::from(s.pose.pose))))
        .collect();
    for pair in poses.windows(2) {
        let step = pair[0].1.inverse().compose(&pair[1].1);
        let (middle_ns, seconds) = ((pair[0].0 + pair[1].0) / 2, (pair[1].0 - pair[0].0) as f64 * 1e-9);
        let [vx, vy, wz] = [step.x, step.y, step.yaw].map(|moved| moved / seconds);
        writeln!(odometry, "{}.{:09},{vx},{vy},{wz}", middle_ns / 1_000_000_000, middle_ns % 1_000_000_000).unwrap();
    }
    room.write("odometry.csv", odometry);
    let run = room.run(&format!("import named {TABLES} {MOUNT} --angles rad -o walk.mcap")).succeeds();
    for words in ["names of the pictures: stamps are milliseconds", "velocities are integrated"] {
        assert!(run.stderr.contains(words), "{words:?} is missing: {run:?}");
    }
    let imported = replayed(&room, "walk.mcap");
    let valid = imported.tags.iter().filter(|tag| tag.valid).count();
    assert!(100 * valid >= 95 * imported.tags.len(), "{valid} of {} valid", imported.tags.len());
    assert!(errors_m(&imported.tags).into_iter().flatten().all(|error_m| error_m < 0.05));
}

#[test]
fn a_camera_whose_pose_is_known_for_each_picture_needs_no_imu() {
    let room = room();
    let truths: Vec<PoseStamped> = decode_all(&walk().messages, TRUTH);
    let mut table = "stamp_ns,parent,child,x,y,z,roll_deg,pitch_deg,yaw_deg\n".to_owned();
    for truth in &truths {
        let pose = Isometry::from(truth.pose);
        let (euler, ns) = (pose.euler(), truth.header.stamp.to_nanoseconds());
        let [roll, pitch] = [euler.roll, euler.pitch].map(f64::to_degrees);
        writeln!(table, "{ns},base_footprint,camera_link,0.04,0,{},{roll},{pitch},0", pose.translation.z).unwrap();
    }
    room.write("camera.csv", table);
    let known = "--odometry odometry.csv --lens lens.toml --transforms camera.csv";
    room.run(&format!("import frames --stamps stamps.csv {known} -o walk.mcap")).succeeds();
    let imported = replayed(&room, "walk.mcap");
    let valid = imported.tags.iter().filter(|tag| tag.valid).count();
    assert!(100 * valid >= 95 * imported.tags.len(), "{valid} of {} valid", imported.tags.len());
    assert!(errors_m(&imported.tags).into_iter().flatten().all(|error_m| error_m < 0.05));
}

/// A stand-in for ffmpeg, which gives the walk's pictures one after the other as ffmpeg does; with `more`.
fn stand_in(room: &Room, more: &str) -> String {
    let script = format!("#!/bin/sh\nfor i in $(seq 0 {}); do cat frames/$i.jpg; done\n{more}\n", walk().frames() - 1);
    fs::create_dir_all(room.path("bin")).unwrap();
    room.write("bin/ffmpeg", script);
    fs::set_permissions(room.path("bin/ffmpeg"), fs::Permissions::from_mode(0o755)).unwrap();
    format!("{}:{}", room.path("bin").display(), std::env::var("PATH").unwrap())
}

#[test]
fn a_video_with_a_row_for_each_frame_is_the_same_walk() {
    let room = room();
    room.write("clip.mp4", b"\0\0\0\x20ftypisom");
    let rows = fs::read_to_string(room.path("stamps.csv")).unwrap();
    let stamps: String = rows.lines().map(|line| format!("{}\n", line.split(',').next_back().unwrap())).collect();
    room.write("times.csv", &stamps);
    let own = format!("import clip.mp4 {TABLES} {MOUNT} -o clip.mcap");
    let path = stand_in(&room, "");
    room.run_with(&format!("{own} --stamps times.csv"), &[("PATH", &path)]).succeeds();
    room.run(&format!("import frames --stamps stamps.csv {TABLES} {MOUNT} -o walk.mcap")).succeeds();
    assert!(fs::read(room.path("clip.mcap")).unwrap() == fs::read(room.path("walk.mcap")).unwrap());
    fs::remove_file(room.path("clip.mcap")).unwrap();
    // More complaints than a pipe holds stop nobody, and are a loss.
    let path = stand_in(&room, "seq 1 50000 >&2");
    let run = room.run_with(&format!("{own} --rate 10 --json"), &[("PATH", &path)]).fails(3, &["ffmpeg says: 1"]);
    assert_eq!(run.json()["pictures"], walk().frames());
    fs::remove_file(room.path("clip.mcap")).unwrap();
    room.write("times.csv", stamps.lines().take(9).collect::<Vec<_>>().join("\n"));
    for (more, arguments, words) in [
        ("", "--stamps times.csv", &["times.csv has 8 rows", "more frames"][..]),
        ("echo no such codec >&2; exit 1", "--rate 10", &["ffmpeg failed: no such codec"]),
        ("head -c 1000 frames/0.jpg", "--rate 10", &["clip.mp4", "a frame is cut short"]),
        ("", "", &["--stamps", "--rate"]),
    ] {
        let path = stand_in(&room, more);
        let code = if arguments.is_empty() { 2 } else { 1 };
        room.run_with(&format!("{own} {arguments}"), &[("PATH", &path)]).fails(code, words);
        assert!(!room.path("clip.mcap").exists(), "{words:?}");
    }
    let run = room.run_with(&format!("{own} --rate 10"), &[("PATH", "/nowhere")]);
    run.fails(1, &["clip.mp4", "ffmpeg", "install it"]);
}

/// What is wrong is named, with what would be right, and nothing is left of the log.
#[test]
fn what_cannot_be_imported_is_named() {
    let room = room();
    room.write("low.toml", super::support::LENS.replace("height = 240", "height = 200"));
    let own = format!("import frames --stamps stamps.csv {TABLES}");
    room.write("log.txt", "not a log");
    room.write("degrees.csv", "stamp,roll,pitch\n1760000000.5,1,2\n");
    room.write("late.csv", "stamp,roll_deg,pitch_deg\n1760009000.5,1,2\n1760009000.6,1,2\n");
    room.write("twice.csv", "stamp,x,y,yaw_deg\n1760000000.5,0,0,0\n1760000000.6,0,0,0\n1760000000.6,0,0,0\n");
    room.write("back.csv", "image,stamp\n1.jpg,1760000001.0\n2.jpg,1760000000.5\n");
    room.write("circle.csv", "parent,child,x,y,z,roll_deg,pitch_deg,yaw_deg\nbase_link,camera_link,0,0,0.5,0,0,0\n");
    for name in ["mixed", "empty", "bitmap", "numbers"] {
        fs::create_dir(room.path(name)).unwrap();
    }
    fs::copy(room.path("frames/0.jpg"), room.path("mixed/0.jpg")).unwrap();
    image::RgbImage::new(64, 48).save(room.path("mixed/1.png")).unwrap();
    room.write("bitmap/a.bmp", "BM");
    fs::copy(room.path("frames/0.jpg"), room.path("numbers/000123.jpg")).unwrap();
    let base = format!("{TABLES} {MOUNT}");
    for (arguments, code, words) in [
        (format!("{own} -o x.mcap"), 2, &["--height is missing", "--transforms"][..]),
        (format!("{own} --height 0.3 --mount 0,0,0.5,0 -o x.mcap"), 2, &["--mount", "below the ground"]),
        (format!("{own} {MOUNT} -o log.txt"), 2, &["log.txt", "not of the kind"]),
        (format!("{own} {MOUNT} -o none/x.mcap"), 1, &["none/x.mcap", "folder does not exist"]),
        (format!("{own} {MOUNT} --rate 3 -o x.mcap"), 2, &["--stamps", "--rate"]),
        (format!("import mixed --rate 10 {base} -o x.mcap"), 1, &["1.png is 64 x 48", "0.jpg 320 x 240", "one size"]),
        (format!("import empty --rate 10 {base} -o x.mcap"), 2, &["empty: it holds no JPEG or PNG"]),
        (format!("import bitmap --rate 10 {base} -o x.mcap"), 2, &["a.bmp is neither JPEG nor PNG"]),
        (format!("import numbers {base} -o x.mcap"), 2, &["000123.jpg", "--stamps", "--rate"]),
        (
            format!("import stamps.csv --rate 10 {base} -o x.mcap"),
            2,
            &["stamps.csv", "neither a folder", "nor a video"],
        ),
        (format!("import gone --rate 10 {base} -o x.mcap"), 1, &["gone", "there is no such file"]),
        (
            format!("import frames --stamps stamps.csv --lens low.toml {MOUNT} -o x.mcap"),
            2,
            &["0.jpg is 320 x 240", "for images of 320 x 200"],
        ),
        (
            format!("import frames --stamps stamps.csv --imu degrees.csv --lens lens.toml {MOUNT} -o x.mcap"),
            1,
            &["degrees.csv", "roll_deg or roll_rad", "--angles"],
        ),
        (
            format!("import frames --stamps stamps.csv --imu late.csv --lens lens.toml {MOUNT} -o x.mcap"),
            1,
            &["late.csv goes from 1760009000.5 to 1760009000.6 s", "no picture lies within it", "one clock"],
        ),
        (
            format!("import frames --stamps stamps.csv --odometry twice.csv --lens lens.toml {MOUNT} -o x.mcap"),
            1,
            &["twice.csv: line 4", "the same as that of line 3"],
        ),
        (
            format!("import frames --stamps back.csv --lens lens.toml {MOUNT} -o x.mcap"),
            1,
            &["back.csv: line 3", "earlier than that of line 2"],
        ),
        (
            "import frames --stamps stamps.csv --transforms circle.csv --lens lens.toml -o x.mcap".to_owned(),
            1,
            &["circle.csv", "no transform leads to base_link"],
        ),
        (
            format!("import frames --stamps imu.csv --lens lens.toml {MOUNT} -o x.mcap"),
            1,
            &["imu.csv: the column image is missing", "qx, qy"],
        ),
    ] {
        room.run(&arguments).fails(code, words);
        assert!(!room.path("x.mcap").exists(), "{arguments}");
        assert_eq!(fs::read_dir(room.path(".")).unwrap().filter(is_pending).count(), 0, "{arguments}");
    }
}

#[test]
fn pictures_that_are_left_out_are_a_loss_that_is_told() {
    let room = room();
    room.write("frames/3.jpg", "no picture");
    fs::remove_file(room.path("frames/4.jpg")).unwrap();
    image::RgbImage::new(320, 240).save(room.path("frames/extra.png")).unwrap();
    let run = room.run(&format!("import frames --stamps stamps.csv {TABLES} {MOUNT} -o walk.mcap --json"));
    let run = run.fails(3, &["frames/3.jpg", "left out", "1 rows have no picture: 4.jpg", "extra.png"]);
    assert_eq!(run.json()["pictures"], walk().frames() - 2);
    assert_eq!(run.json()["lost"].as_array().unwrap().len(), 2);
}

fn is_pending(entry: &std::io::Result<fs::DirEntry>) -> bool {
    entry.as_ref().is_ok_and(|entry| entry.file_name().to_string_lossy().starts_with(".realitysim"))
}

/// The how-to is tried as it is written, with the files that it names.
#[test]
fn the_howto_of_pictures_is_right() {
    let room = room();
    fs::remove_dir_all(room.path("frames")).unwrap();
    fs::create_dir(room.path("frames")).unwrap();
    for (index, image) in decode_all::<CompressedImage>(&walk().messages, IMAGE).iter().enumerate() {
        if index % 2 == 0 {
            let ms = image.header.stamp.to_nanoseconds() / 1_000_000;
            room.write(&format!("frames/{ms}.jpg"), &image.data);
        }
    }
    let mut imu = "stamp,roll_deg,pitch_deg\n".to_owned();
    for sample in decode_all::<Imu>(&walk().messages, IMU) {
        let q = &sample.orientation;
        let tilt = Euler::from_rotation(DQuat::from_xyzw(q.x, q.y, q.z, q.w));
        let ns = sample.header.stamp.to_nanoseconds();
        writeln!(imu, "{ns},{},{}", tilt.roll.to_degrees(), tilt.pitch.to_degrees()).unwrap();
    }
    room.write("imu.csv", imu);
    let table = fs::read_to_string(room.path("odometry.csv")).unwrap();
    let rows: String = table.lines().skip(1).map(|line| format!("{}\n", line.replace(';', ","))).collect();
    room.write("odometry.csv", format!("stamp_ms,x_mm,y_mm,yaw_deg\n{rows}"));
    fs::rename(room.path("lens.toml"), room.path("camera.yaml")).unwrap();
    let text = fs::read_to_string("docs/howto/pictures.md").unwrap();
    let commands: Vec<&str> = text.lines().filter_map(|line| line.strip_prefix("    realitysim ")).collect();
    assert_eq!(commands.len(), 4, "{commands:?}");
    for command in commands {
        let run = room.run(command).succeeds();
        println!("{command}\n{}{}", run.stdout, run.stderr);
    }
    for name in ["walk.mcap", "sheet.png", "frames/poses.csv", "frames/camera_info.yaml", "images/database.json"] {
        assert!(room.path(name).is_file(), "{name}");
    }
}
