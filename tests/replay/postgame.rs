//! `postgame`: a robot's own pose, held against the tags.

use std::fs;

use realitysim::geometry::{Euler, Isometry};
use realitysim::ros2::LogMessage;
use realitysim::ros2::messages::{Pose, PoseStamped};

use super::support::{Room, TRUTH, decode_all, message, session_name, walk};

const OWN: &str = "/localization/pose";

/// The standard walk with what its robot believed, in a frame named `frame`: 0.9 m to the left of the truth from two seconds on.
fn believed(frame: &str) -> Vec<LogMessage> {
    let truths: Vec<PoseStamped> = decode_all(&walk().messages, TRUTH);
    let first_ns = truths[0].header.stamp.to_nanoseconds();
    let mut messages = walk().messages.clone();
    for mut own in truths {
        let stamp_ns = own.header.stamp.to_nanoseconds();
        let camera = Isometry::from(own.pose);
        let mut place = camera.translation.with_z(0.0);
        if stamp_ns - first_ns > 2_000_000_000 {
            place.y += 0.9;
        }
        let euler = Euler { yaw: camera.euler().yaw, pitch: 0.0, roll: 0.0 };
        own.pose = Pose::from(Isometry::from_euler(euler, place));
        own.header.frame_id = frame.to_owned();
        messages.push(message(900, OWN, stamp_ns, &own));
    }
    messages.sort_by_key(|message| message.log_time_ns);
    messages
}

#[test]
fn a_pose_that_jumps_is_told_with_its_time_and_the_odometry_s_scale() {
    let room = Room::with_log(&believed("map"));
    let session = session_name(&room.replay("log.mcap"));
    let run = room.run(&format!("postgame {session} --poses {OWN} -o game.html --json")).succeeds();
    let report = run.json();
    let number = |value: &serde_json::Value| value.as_f64().unwrap();
    let episodes = report["episodes"].as_array().unwrap();
    assert_eq!(episodes.len(), 1, "{report}");
    assert_eq!(episodes[0]["cause"], "jump");
    assert!((number(&episodes[0]["from_s"]) - 2.1).abs() < 0.11, "{report}");
    assert!((number(&episodes[0]["worst_m"]) - 0.9).abs() < 0.1, "{report}");
    assert!(number(&report["median_m"]) < 0.1, "{report}");
    // The scene's odometry is wrong by 6 %.
    let forward = &report["odometry"]["directions"][0];
    assert_eq!(forward["motion"], "forward");
    assert!((number(&forward["scale"]) - 1.0).abs() > 0.03, "{forward}");
    assert!((number(&forward["scale"]) - 1.0 / 1.06).abs() < 0.04, "{forward}");
    let page = fs::read_to_string(room.path("game.html")).unwrap();
    assert!(page.contains("own pose jumped") && page.contains("data:image/jpeg;base64,"), "{}", &page[..500]);
    assert!(!page.contains("http"), "nothing is loaded from elsewhere");
    // The same from a file.
    let mut table = String::from("# stamp tx ty tz qx qy qz qw\n");
    for own in decode_all::<PoseStamped>(&believed("map"), OWN) {
        let (p, q, stamp) = (own.pose.position, own.pose.orientation, own.header.stamp);
        let (seconds, rest) = (stamp.sec, stamp.nanosec);
        table += &format!("{seconds}.{rest:09} {} {} {} {} {} {} {}\n", p.x, p.y, p.z, q.x, q.y, q.z, q.w);
    }
    room.write("own.tum", &table);
    let of_file = room.run(&format!("postgame {session} --poses own.tum --json")).succeeds().json();
    assert_eq!(of_file["episodes"][0]["cause"], "jump");
}

#[test]
fn poses_in_another_frame_or_clock_are_named() {
    let room = Room::with_log(&believed("odom"));
    let session = session_name(&room.replay("log.mcap"));
    room.run(&format!("postgame {session} --poses {OWN}")).fails(1, &[OWN, "\"odom\"", "\"map\""]);
    room.run(&format!("postgame {session} --poses /nowhere")).fails(1, &["/nowhere", OWN]);
    room.write("own.tum", "12.5 0 0 0 0 0 0 1\n13.5 0 0 0 0 0 0 1\n");
    room.run(&format!("postgame {session} --poses own.tum")).fails(1, &["own.tum", "same clock", "12.500"]);
    room.write("own.tum", "12.5 0 0 0 0 0 1\n");
    room.run(&format!("postgame {session} --poses own.tum")).fails(1, &["own.tum: line 1", "7 numbers"]);
    room.write("own.tum", "12.5 0 0 0 0 x 0 1\n");
    room.run(&format!("postgame {session} --poses own.tum")).fails(1, &["own.tum: line 1", "not a number"]);
}
