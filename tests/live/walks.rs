//! Walks that are recorded: what is written, said and sent while they last.

use mavlink::dialects::common::{MavFrame, ODOMETRY_DATA};
use realitysim::ros2::messages::{DiagnosticArray, FrameTag, PoseStamped};

use super::recorder::{CONFIG, Recorder};
use super::robot::Robot;
use crate::replay::support::{CAPTURES, IMAGE, TAG, TRUTH, decode_all, on, read_capture, walk};

#[test]
fn a_walk_is_tagged_live_and_its_capture_gives_the_same_tags() {
    let robot = Robot::of(&walk().messages);
    let mut recorder = Recorder::start(Some(robot.tty()));
    let frames = robot.frames();
    let socket = recorder.room.path("camera.sock");
    let line = robot.listens();
    let walking = std::thread::spawn(move || robot.walk(&socket));
    let listener = recorder.listens_to_poses();
    recorder.waits_for("the walk begins", |status| status["counts"]["written"].as_u64() > Some(5));
    assert_eq!(recorder.asks("mark goal!")["marked"], "goal!");
    let (stamps, robot) = walking.join().expect("walked");
    recorder.waits_for("all frames", |status| status["counts"]["written"].as_u64() == Some(frames as u64));
    let status = recorder.asks("status");
    let port = &status["ports"].as_object().expect("ports").values().next().expect("one").clone();
    assert_eq!((port["lost"].as_u64(), port["crc_failures"].as_u64()), (Some(0), Some(0)), "{status}");
    assert!(status["budget"]["p50_ms"].as_f64().is_some_and(|ms| ms > 0.0), "{status}");
    assert!(status["filter"]["particles"].as_f64().is_some_and(|particles| particles > 10.0), "{status}");
    assert!(status["filter"]["spread_m"].as_f64().is_some_and(|spread_m| spread_m > 0.0), "{status}");
    assert!(status["coverage"]["map"].as_array().is_some_and(|rows| !rows.is_empty()), "{status}");
    assert!(status["validity"]["valid"].as_u64().is_some_and(|valid| valid as usize * 10 >= frames * 8), "{status}");
    let counted = |key: &str| status["counts"][key].as_u64().expect("a count");
    let dropped: u64 =
        status["counts"]["dropped"].as_object().expect("causes").values().filter_map(|n| n.as_u64()).sum();
    let disk = &status["recorder"];
    let waiting = disk["frames_waiting"].as_u64().expect("a count");
    assert_eq!(counted("captured"), counted("written") + counted("thinned") + dropped + waiting, "{status}");
    assert_eq!(disk["conserved"], true);
    assert!(disk["free_bytes"].as_u64().is_some_and(|bytes| bytes > 0), "{status}");
    assert!(disk["loss_bound_ms"].as_f64() >= disk["worst_stall_ms"].as_f64(), "{status}");
    let said = recorder.room.run("recorder status --socket control.sock");
    for part in [
        "last second:",
        "wait to be taken",
        "wait for the disk",
        "ms each",
        "of the last",
        "of the disk free",
        " s behind to ",
    ] {
        assert!(said.stdout.contains(part), "{part}: {said:?}");
    }
    let output = recorder.ends();
    assert!(output.status.success(), "{output:?}");
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let session = recorder.room.path(report["session"].as_str().expect("a session"));

    let recorded = read_capture(&session);
    let tags: Vec<FrameTag> = decode_all(&recorded, TAG);
    assert_eq!(tags.len(), frames);
    assert_eq!(on(&recorded, IMAGE).count(), frames);
    // Byte for byte what the camera sent.
    for (one, sent) in on(&recorded, IMAGE).zip(on(&walk().messages, IMAGE)) {
        let data =
            |bytes: &[u8]| realitysim::ros2::messages::CompressedImageView::decode(bytes).map(|v| v.data.to_vec());
        assert!(data(&one.data).expect("an image") == data(&sent.data).expect("an image"));
    }
    the_robot_was_told_its_poses(&line.join().expect("listened"), &tags);
    whoever_listened_heard_every_tag(listener, &tags);
    drop(robot);
    for (tag, stamp_ns) in tags.iter().zip(&stamps) {
        assert_eq!(tag.kernel_stamp_ns, *stamp_ns, "the kernel's own stamp");
        assert_eq!(tag.header.stamp.to_nanoseconds(), stamp_ns + tag.utc_offset_ns - 4_000_000, "less the delay");
    }
    let marks: Vec<DiagnosticArray> = decode_all(&recorded, "/diagnostics");
    assert!(marks.iter().flat_map(|report| &report.status).any(|status| status.message == "goal!"));

    let truth: Vec<PoseStamped> = decode_all(&walk().messages, TRUTH);
    let valid: Vec<f64> = tags
        .iter()
        .zip(&truth)
        .filter(|(tag, _)| tag.valid)
        .map(|(tag, truth)| {
            let (p, q) = (&tag.pose.pose.position, &truth.pose.position);
            (p.x - q.x).hypot(p.y - q.y)
        })
        .collect();
    assert!(valid.len() * 10 >= frames * 8, "{} of {frames} valid", valid.len());
    let mean = valid.iter().sum::<f64>() / valid.len() as f64;
    assert!(mean < 0.03, "{mean} m");

    let name = format!("{CAPTURES}/{}", session.file_name().expect("a name").to_string_lossy());
    let replayed = recorder.room.replay(&format!("{name} --config robot.toml"));
    assert_eq!(replayed.tags.len(), tags.len());
    for (again, tag) in replayed.tags.iter().zip(&tags) {
        let live = (tag.sequence, tag.valid, &tag.reason, &tag.pose, &tag.best_particle, tag.odometry_until);
        let later =
            (again.sequence, again.valid, &again.reason, &again.pose, &again.best_particle, again.odometry_until);
        assert_eq!(later, live);
    }
}

/// A line of JSON each, as they were recorded.
fn whoever_listened_heard_every_tag(listener: std::process::Child, tags: &[FrameTag]) {
    let output = listener.wait_with_output().expect("ended with the recorder");
    assert!(output.status.success(), "{output:?}");
    let lines: Vec<serde_json::Value> =
        output.stdout.split(|byte| *byte == b'\n').filter_map(|line| serde_json::from_slice(line).ok()).collect();
    // Before its first frame the robot stood for a while where it had been told to be.
    let lines: Vec<&serde_json::Value> = lines.iter().filter(|line| line["reason"] != "no_frame").collect();
    assert_eq!(lines.len(), tags.len());
    for (line, tag) in lines.iter().zip(tags) {
        assert_eq!((line["sequence"].as_u64(), line["valid"].as_bool()), (Some(tag.sequence), Some(tag.valid)));
        assert_eq!(line["pose"]["pose"]["position"]["x"].as_f64(), Some(tag.pose.pose.position.x));
    }
}

/// Every valid tag, as ODOMETRY on the line, by the clock that its time questions were answered with.
fn the_robot_was_told_its_poses(told: &[ODOMETRY_DATA], tags: &[FrameTag]) {
    let valid: Vec<&FrameTag> = tags.iter().filter(|tag| tag.valid).collect();
    assert_eq!(told.len(), valid.len());
    for (said, tag) in told.iter().zip(valid) {
        let exposed_ns = tag.header.stamp.to_nanoseconds() - tag.utc_offset_ns;
        assert_eq!(said.time_usec as i64, exposed_ns / 1_000);
        let p = &tag.pose.pose.position;
        assert_eq!([said.x, said.y, said.z], [p.x, p.y, p.z].map(|part| part as f32));
        assert_eq!(said.pose_covariance[0], tag.pose.covariance[0] as f32);
        assert_eq!(said.frame_id, MavFrame::MAV_FRAME_LOCAL_FLU);
    }
}

#[test]
fn poses_go_out_although_the_disk_takes_nothing() {
    let robot = Robot::of(&walk().messages);
    let config = CONFIG.replace("floor_mb = 1", "floor_mb = 100000000");
    let mut recorder = Recorder::start_at(Some(robot.tty()), &config, "-2.06,0.153,14.5");
    let (frames, socket) = (robot.frames(), recorder.room.path("camera.sock"));
    let line = robot.listens();
    let walking = std::thread::spawn(move || robot.walk(&socket));
    let (_, robot) = walking.join().expect("walked");
    recorder.waits_for("all frames", |status| {
        let dropped = status["counts"]["dropped"].as_object().into_iter().flatten();
        dropped.filter_map(|(_, count)| count.as_u64()).sum::<u64>() == frames as u64
    });
    let status = recorder.asks("status");
    assert_eq!(
        (&status["recorder"]["stopped"]["cause"], status["counts"]["written"].as_u64()),
        (&"disk_full".into(), Some(0))
    );
    recorder.ends();
    let told = line.join().expect("listened");
    drop(robot);
    assert!(10 * told.len() >= 8 * frames, "{} poses of {frames} frames", told.len());
}

/// Its frames are lost, and told to be, also after another session that had nothing to lose.
#[test]
fn what_an_earlier_session_lost_is_in_the_last_account() {
    let robot = Robot::of(&walk().messages);
    let config = CONFIG.replace("floor_mb = 1", "floor_mb = 100000000");
    let mut recorder = Recorder::start_at(Some(robot.tty()), &config, "-2.06,0.153,14.5");
    let (frames, socket) = (robot.frames(), recorder.room.path("camera.sock"));
    std::thread::spawn(move || robot.walk(&socket)).join().expect("walked");
    recorder.waits_for("all frames", |status| status["counts"]["captured"].as_u64() == Some(frames as u64));
    recorder.asks("stop");
    assert_eq!(recorder.asks("start")["state"], "recording");
    let output = recorder.ends();
    assert_eq!(output.status.code(), Some(3), "{output:?}");
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let earlier = &report["earlier"];
    assert_eq!((&earlier["sessions"], &earlier["counts"]["captured"]), (&1.into(), &frames.into()), "{report}");
    assert!(earlier["frames_refused"].as_u64() > Some(0) && report["counts"]["captured"] == 0, "{report}");
}
