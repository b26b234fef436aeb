//! `import`: pictures and tables of an outsider without ROS become a log that replays as the robot's own.

use std::fmt::Write;
use std::fs;
use std::path::Path;

use realitysim::geometry::{Isometry, Pose2};
use realitysim::ros2::messages::{CompressedImage, FrameTag, Imu, Odometry, PoseStamped, PoseWithCovarianceStamped};

use super::support::{
    IMAGE, IMU, INITIAL, ODOMETRY, Replayed, Room, TAG, TRUTH, decode_all, farthest_apart, on, read_log, walk,
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
    assert_eq!(fs::read_dir(room.path(".")).unwrap().filter(|entry| is_pending(entry)).count(), 0);
}

fn is_pending(entry: &std::io::Result<fs::DirEntry>) -> bool {
    entry.as_ref().is_ok_and(|entry| entry.file_name().to_string_lossy().starts_with(".realitysim"))
}
