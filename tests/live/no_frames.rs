//! The camera is away for a while: the robot's poses come from odometry until it is back.

use realitysim::ros2::LogMessage;
use realitysim::ros2::messages::{FrameTag, PoseWithCovarianceStamped};
use serde_json::Value;

use super::recorder::Recorder;
use super::robot::Robot;
use crate::replay::no_frames::{PREDICTED, with_a_gap};
use crate::replay::support::{INITIAL, TAG, decode_all, read_capture, walk};

#[test]
fn listeners_hear_predictions_without_frames_and_that_they_are_such() {
    let robot = Robot::of(&with_a_gap());
    let mut recorder = Recorder::start(Some(robot.tty()));
    let (frames, socket) = (robot.frames(), recorder.room.path("camera.sock"));
    let line = robot.listens();
    let walking = std::thread::spawn(move || robot.walk(&socket));
    let listener = recorder.listens_to_poses();
    recorder.waits_for("a prediction", |status| {
        status["last_tag"]["reason"] == "no_frame" && status["last_tag"]["sigma_m"].as_f64() > Some(0.0)
    });
    // In words, too: now, or when the camera is away again.
    recorder.waits_for("words about it", |_| {
        recorder.room.run("recorder status --socket control.sock").stdout.contains("predicted, for want of frames")
    });
    let (_, robot) = walking.join().expect("walked");
    recorder.waits_for("all frames", |status| status["counts"]["tagged"].as_u64() == Some(frames as u64));
    let status = recorder.asks("status");
    assert_eq!(status["validity"]["frames"], frames, "shares are of frames: {status}");
    let output = recorder.ends();
    assert!(output.status.success(), "{output:?}");
    let report: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let recorded = read_capture(&recorder.room.path(report["session"].as_str().expect("a session")));
    let predicted: Vec<FrameTag> = decode_all(&recorded, PREDICTED);
    // How many there are depends on how busy this machine is; a replay has a fixed number of them.
    let (before, within): (Vec<&FrameTag>, Vec<&FrameTag>) = predicted.iter().partition(|tag| tag.sequence == 0);
    assert!(
        !before.is_empty() && !within.is_empty(),
        "{} before the first frame, {} after it",
        before.len(),
        within.len()
    );
    for tag in before {
        let told = &tag.pose.pose.position;
        assert!(f64::hypot(told.x + 2.02, told.y - 0.16) < 0.03, "{told:?}");
    }
    let stamp_ns = |tag: &FrameTag| tag.header.stamp.to_nanoseconds();
    assert!(
        predicted.windows(2).all(|two| stamp_ns(&two[1]) - stamp_ns(&two[0]) >= 99_000_000),
        "ten a second at most"
    );
    let heard = listener.wait_with_output().expect("ended with the recorder");
    assert!(heard.status.success(), "{:?}", heard.status);
    let heard = heard.stdout;
    let heard: Vec<Value> =
        heard.split(|byte| *byte == b'\n').filter_map(|line| serde_json::from_slice(line).ok()).collect();
    let of_no_frame = heard.iter().filter(|tag| tag["reason"] == "no_frame" && tag["valid"] == false).count();
    assert_eq!((heard.len(), of_no_frame), (frames + predicted.len(), predicted.len()));
    let told = line.join().expect("listened");
    drop(robot);
    let valid = decode_all::<FrameTag>(&recorded, TAG).iter().filter(|tag| tag.valid).count();
    assert_eq!(told.len(), valid, "the robot is not told its own odometry");
}

#[test]
fn a_place_that_was_told_outlives_a_session_that_nothing_happened_in() {
    let robot = Robot::of(&walk().messages);
    let mut recorder = Recorder::start(Some(robot.tty()));
    recorder.waits_for("it runs", |status| status["state"] == "recording");
    assert_eq!(recorder.asks("stop")["state"], "stopped");
    assert_eq!(recorder.asks("start")["state"], "recording");
    let (frames, socket) = (robot.frames(), recorder.room.path("camera.sock"));
    let (_, robot) = robot.walk(&socket);
    recorder.waits_for("all frames", |status| status["counts"]["tagged"].as_u64() == Some(frames as u64));
    let output = recorder.ends();
    drop(robot);
    let report: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let recorded = read_capture(&recorder.room.path(report["session"].as_str().expect("a session")));
    let tags: Vec<FrameTag> = decode_all(&recorded, TAG);
    assert!(tags.iter().filter(|tag| tag.valid).count() * 10 >= tags.len() * 8);
    // The field has two halves, and it was told in which one it is.
    assert!(tags.iter().all(|tag| !tag.ambiguous && tag.pose.pose.position.x < 0.0));
}

/// In slow motion: with longer pauses.
pub fn slower(messages: &[LogMessage], times: i64) -> Vec<LogMessage> {
    let first_ns = messages[0].log_time_ns;
    let later = |message: &LogMessage| LogMessage {
        log_time_ns: first_ns + times * (message.log_time_ns - first_ns),
        ..message.clone()
    };
    messages.iter().map(later).collect()
}

#[test]
fn between_sessions_odometry_goes_on_and_a_pose_can_be_announced() {
    let robot = Robot::of(&slower(&walk().messages, 3));
    let mut recorder = Recorder::start(Some(robot.tty()));
    let socket = recorder.room.path("camera.sock");
    let walking = std::thread::spawn(move || robot.walk(&socket));
    recorder.waits_for("some frames", |status| status["validity"]["valid"].as_u64() >= Some(5));
    assert_eq!(recorder.asks("stop")["state"], "stopped");
    // Longer than a place is believed that nobody has followed.
    std::thread::sleep(std::time::Duration::from_millis(5500));
    assert_eq!(recorder.asks("start")["state"], "recording");
    let (_, robot) = walking.join().expect("walked");
    recorder.waits_for("the last frame", |status| status["last_tag"]["valid"] == true);
    let refused = recorder.room.run("recorder place 20,0,0 --socket control.sock");
    refused.fails(2, &["20,0 is not on the field", "its carpet reaches"]);
    recorder.room.run("recorder place 2,north,0 --socket control.sock").fails(2, &["expected x,y,yaw_deg"]);
    let placed = recorder.asks("place 1.2,-0.3,-165.5");
    assert_eq!(placed["place"][0], 1.2);
    let output = recorder.ends();
    drop(robot);
    let report: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let recorded = read_capture(&recorder.room.path(report["session"].as_str().expect("a session")));
    let tags: Vec<FrameTag> = decode_all(&recorded, TAG);
    let (last, wanted) = (tags.last().expect("frames"), walk().tags.last().expect("frames"));
    assert!(tags.iter().all(|tag| !tag.ambiguous), "it has been followed");
    let (at, wanted) = (&last.pose.pose.position, &wanted.pose.pose.position);
    assert!(last.valid && f64::hypot(at.x - wanted.x, at.y - wanted.y) < 0.02, "{at:?} for {wanted:?}");
    let told: Vec<PoseWithCovarianceStamped> = decode_all(&recorded, INITIAL);
    assert_eq!((told.len(), told[0].pose.pose.position.x), (1, 1.2), "and is in the log");
}
