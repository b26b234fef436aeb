//! While no frames come, odometry says where the robot is, and the poses say that they are of no frame.

use std::fs;

use realitysim::geometry::Pose2;
use realitysim::ros2::LogMessage;
use realitysim::ros2::messages::{FrameTag, Header, Message, Odometry, PoseStamped, PoseWithCovarianceStamped, Stamp};

use super::support::{
    CAMERA_INFO, IMAGE, INITIAL, ODOMETRY, POSE, Replayed, Room, TF_STATIC, TRUTH, changed, decode_all, on, own_log,
    read_capture, read_log, segments, stamp_later, walk, without,
};

pub const PREDICTED: &str = "/predicted_tag";
/// The cable is loose between these frames.
const LAST_BEFORE: usize = 9;
const FIRST_AFTER: usize = 34;
/// Ten a second, as frames, from a second after the last one until the next one.
const PREDICTIONS: usize = FIRST_AFTER - LAST_BEFORE - 9;

/// The walk without some of its frames; the truth stays.
pub fn with_a_gap() -> Vec<LogMessage> {
    let mut number = 0;
    let mut keep = |message: &&LogMessage| {
        number += usize::from(message.channel.topic == IMAGE);
        message.channel.topic != IMAGE || !(LAST_BEFORE + 2..=FIRST_AFTER).contains(&number)
    };
    walk().messages.iter().filter(|message| keep(message)).cloned().collect()
}

/// From where the truth is at that time, or nearest to it.
fn off_m(tag: &FrameTag, truth: &[PoseStamped]) -> f64 {
    let apart = |truth: &&PoseStamped| stamp_ns(&truth.header).abs_diff(stamp_ns(&tag.header));
    let truth = truth.iter().min_by_key(apart).expect("a truth");
    let (p, q) = (&tag.pose.pose.position, &truth.pose.position);
    f64::hypot(p.x - q.x, p.y - q.y)
}

fn sigma_m(tag: &FrameTag) -> f64 {
    tag.pose.covariance[0].max(tag.pose.covariance[7]).sqrt()
}

#[test]
fn without_frames_odometry_predicts_the_pose_and_says_so() {
    let room = Room::with_log(&with_a_gap());
    let replayed = room.replay("log.mcap");
    assert_eq!(replayed.run.code, Some(0), "{:?}", replayed.run);
    let messages = read_capture(&replayed.session);
    let predicted: Vec<FrameTag> = decode_all(&messages, PREDICTED);
    assert_eq!(predicted.len(), PREDICTIONS, "ten a second");
    assert_eq!(replayed.report["predicted"], predicted.len());
    let truth = decode_all::<PoseStamped>(&walk().messages, TRUTH);
    let last = &replayed.tags[LAST_BEFORE];
    for tag in &predicted {
        assert!(!tag.valid && tag.reason == "no_frame" && tag.sequence == 1 + LAST_BEFORE as u64, "{tag:?}");
        let (off, sigma) = (off_m(tag, &truth), sigma_m(tag));
        assert!(off < 0.04 && off < 4.0 * sigma, "{off:.3} m off, {sigma:.3} m claimed");
        assert!(sigma > sigma_m(last), "it knows that it knows less");
    }
    assert!(sigma_m(&predicted[predicted.len() - 1]) > 1.2 * sigma_m(&predicted[0]), "and less and less");
    let valid = replayed.tags.iter().filter(|tag| tag.valid).count();
    assert_eq!(on(&messages, POSE).count(), valid, "who reads valid poses reads none of them");
    // What is derived is derived anew: it is no input.
    let again = room.replay(replayed.session.to_str().unwrap());
    assert_eq!(decode_all::<FrameTag>(&read_capture(&again.session), PREDICTED), predicted);
}

#[test]
fn a_part_that_begins_without_frames_predicts_as_the_whole_does() {
    let room = Room::with_log(&with_a_gap());
    let whole = room.replay("log.mcap --set recording.segment_s=1");
    let files = segments(&whole.session);
    let (mut predicted, mut frameless) = (0, 0);
    for file in &files {
        let messages = read_log(file);
        let own: Vec<FrameTag> = decode_all(&messages, PREDICTED);
        predicted += own.len();
        frameless += usize::from(on(&messages, IMAGE).next().is_none());
        room.write("part.mcap", fs::read(file).unwrap());
        let alone = room.run("replay part.mcap -o alone --json").json();
        let session = room.path(alone["session"].as_str().unwrap());
        assert_eq!(decode_all::<FrameTag>(&read_capture(&session), PREDICTED), own, "{}", file.display());
        fs::remove_dir_all(room.path("alone")).unwrap();
    }
    assert_eq!((predicted, frameless), (PREDICTIONS, 2), "two seconds are all without a frame");
    let room = Room::with_log(&without(&walk().messages, IMAGE));
    room.run("replay log.mcap -o alone").fails(1, &["log.mcap", "no camera images"]);
}

#[test]
fn nobody_predicts_where_a_robot_is_that_was_nowhere() {
    // Told nothing, and the few frames there are do not confirm a pose.
    let mut frames = 0;
    let few = |message: &&LogMessage| {
        frames += usize::from(message.channel.topic == IMAGE);
        message.channel.topic != IMAGE || frames < 2
    };
    let messages: Vec<LogMessage> = without(&walk().messages, INITIAL).iter().filter(few).cloned().collect();
    let replayed = Room::with_log(&messages).replay("log.mcap");
    assert_eq!((replayed.tags.len(), replayed.tags[0].valid), (1, false));
    assert_eq!(replayed.report["predicted"], 0);
}

/// No frame before this one.
fn with_a_late_camera(messages: &[LogMessage]) -> Vec<LogMessage> {
    let mut number = 0;
    let mut keep = |message: &&LogMessage| {
        number += usize::from(message.channel.topic == IMAGE);
        message.channel.topic != IMAGE || number > FIRST_AFTER + 1
    };
    messages.iter().filter(|message| keep(message)).cloned().collect()
}

/// The robot's place, from where the camera is in the same walk; the head looks ahead.
fn footprint_of(tag: &FrameTag) -> Pose2 {
    let camera = &tag.pose.pose.position;
    Pose2::new(camera.x - 0.04 * tag.yaw.cos(), camera.y - 0.04 * tag.yaw.sin(), tag.yaw)
}

/// Predictions that follow the robot from `begins_ns` on, and a first frame that is at its place at once.
fn follows_the_robot(replayed: &Replayed, begins_ns: i64) {
    let truth = decode_all::<PoseStamped>(&walk().messages, TRUTH);
    let first = &replayed.tags[0];
    let predicted: Vec<FrameTag> = decode_all(&read_capture(&replayed.session), PREDICTED);
    let until_ns = first.header.stamp.to_nanoseconds();
    let expected = (until_ns - begins_ns - 1_000_000_000) / 100_000_000;
    assert!(predicted.len().abs_diff(expected as usize) <= 1, "{} of {expected}", predicted.len());
    for tag in &predicted {
        assert!(!tag.valid && tag.reason == "no_frame" && !tag.ambiguous, "{tag:?}");
        let (off, sigma) = (off_m(tag, &truth), sigma_m(tag));
        // Nearest in time: half a frame's way, and what was told is off by 8 cm.
        assert!(off < 0.16 && sigma > 0.1 && off < sigma, "{off:.3} m off, {sigma:.3} m claimed");
    }
    assert!(!first.ambiguous && off_m(first, &truth) < 0.03, "{first:?}");
    assert!(replayed.tags.iter().skip(3).all(|tag| tag.valid), "{:?}", replayed.tags);
}

fn stamp_ns(header: &Header) -> i64 {
    header.stamp.to_nanoseconds()
}

#[test]
fn before_the_first_frame_odometry_carries_on_the_announced_pose() {
    let messages = with_a_late_camera(&walk().messages);
    let begins_ns = stamp_ns(&decode_all::<Odometry>(&messages, ODOMETRY)[0].header);
    let room = Room::with_log(&messages);
    follows_the_robot(&room.replay("log.mcap"), begins_ns);
    // The same, told beside the log.
    let told = decode_all::<PoseWithCovarianceStamped>(&messages, INITIAL).remove(0).pose.pose;
    let yaw_deg = 2.0 * told.orientation.z.atan2(told.orientation.w).to_degrees();
    let told = format!("--initial={},{},{yaw_deg}", told.position.x, told.position.y);
    let room = Room::with_log(&without(&messages, INITIAL));
    follows_the_robot(&room.replay(&format!("log.mcap {told}")), begins_ns);
}

#[test]
fn a_place_counts_from_when_it_is_told() {
    let (when, all) = (FIRST_AFTER / 2, &walk().messages);
    let told = footprint_of(&walk().tags[when]);
    let mut message = on(all, INITIAL).next().expect("told at the beginning").clone();
    let mut content = PoseWithCovarianceStamped::decode(&message.data).unwrap();
    let pose = &mut content.pose.pose;
    (pose.position.x, pose.position.y) = (told.x, told.y);
    (pose.orientation.z, pose.orientation.w) = (told.yaw / 2.0).sin_cos();
    message.data = content.encode();
    message.log_time_ns = on(all, IMAGE).nth(when).expect("a frame").log_time_ns;
    let mut messages = with_a_late_camera(&without(all, INITIAL));
    let place = messages.partition_point(|other| other.log_time_ns <= message.log_time_ns);
    messages.insert(place, message);
    let room = Room::with_log(&messages);
    follows_the_robot(&room.replay("log.mcap"), stamp_ns(&walk().tags[when].header));
}

#[test]
fn after_a_restart_odometry_carries_on_the_place_that_was_kept() {
    let all = &walk().messages;
    let middle_ns = on(all, IMAGE).nth(LAST_BEFORE).expect("a frame").log_time_ns;
    let room = Room::new();
    let before: Vec<LogMessage> = all.iter().filter(|message| message.log_time_ns <= middle_ns).cloned().collect();
    let rest: Vec<LogMessage> = with_a_late_camera(&without(all, INITIAL))
        .into_iter()
        .filter(|message| {
            message.log_time_ns > middle_ns || [TF_STATIC, CAMERA_INFO].contains(&&*message.channel.topic)
        })
        .collect();
    room.write("before.mcap", own_log(&before));
    room.write("rest.mcap", own_log(&rest));
    room.replay("before.mcap");
    follows_the_robot(&room.replay("rest.mcap --warm-start"), middle_ns);
}

#[test]
fn after_a_longer_absence_nothing_is_predicted_from_a_place_that_was_kept() {
    let all = &walk().messages;
    let later_ns = 10_000_000_000;
    let room = Room::with_log(all);
    room.replay("log.mcap");
    let mut later = with_a_late_camera(&without(all, INITIAL));
    later.iter_mut().for_each(|message| stamp_later(message, later_ns));
    room.write("later.mcap", own_log(&later));
    let replayed = room.replay("later.mcap --warm-start");
    assert_eq!(replayed.report["predicted"], 0, "nobody knows where it has walked");
    assert!(replayed.tags.iter().all(|tag| tag.ambiguous), "or been carried");
}

/// Five seconds are as long as anybody keeps the gyro's turns: step by step, as the predictions go, all of them count.
#[test]
fn a_frame_after_a_long_gap_begins_where_odometry_and_gyro_have_led() {
    let room = Room::new();
    room.write_scene("loop.toml", |text| {
        let round = "waypoints = [[-2.2, -0.3], [-1.2, -0.3], [-1.0, 0.8], [-1.9, 0.9], [-2.2, 0.0], [-1.6, -0.6]]";
        let text = text.replace("waypoints = [[-2.0, 0.1], [-1.1, 0.3]]", round);
        let gap =
            "\n[[effect]]\nkind = \"camera_fault\"\nrole = \"base\"\nunplugged = { from_s = 2.0, for_s = 15.0 }\n";
        assert!(text.contains(round), "{text}");
        text + gap
    });
    room.run("scene render loop.toml -o true.mcap").succeeds();
    // Feet slip in each turn.
    let (mut before, mut slipped) = (None, Pose2::default());
    let messages = changed::<Odometry>(&read_log(&room.path("true.mcap")), ODOMETRY, |odometry| {
        let pose = &mut odometry.pose.pose;
        let now = Pose2::new(pose.position.x, pose.position.y, 2.0 * pose.orientation.z.atan2(pose.orientation.w));
        let step = before.replace(now).map_or(now, |before: Pose2| before.inverse().compose(&now));
        slipped = slipped.compose(&Pose2::new(step.x, step.y, 0.8 * step.yaw));
        (pose.position.x, pose.position.y) = (slipped.x, slipped.y);
        (pose.orientation.z, pose.orientation.w) = (slipped.yaw / 2.0).sin_cos();
    });
    room.write("slips.mcap", own_log(&messages));
    let replayed = room.replay("slips.mcap");
    let truth = decode_all::<PoseStamped>(&messages, TRUTH);
    let predicted: Vec<FrameTag> = decode_all(&read_capture(&replayed.session), PREDICTED);
    let gap = |pair: &&[FrameTag]| stamp_ns(&pair[1].header) - stamp_ns(&pair[0].header) > 10_000_000_000;
    let first = &replayed.tags.windows(2).find(gap).expect("a gap")[1];
    let last = predicted.last().expect("predictions");
    eprintln!(
        "{} {} {} | {:?} {} amb {} off {}",
        predicted.len(),
        off_m(last, &truth),
        sigma_m(last),
        first.valid,
        first.reason,
        first.ambiguous,
        off_m(first, &truth)
    );
    assert!(first.valid && !first.ambiguous && off_m(first, &truth) < 0.03, "{first:?}");
}

/// By a clock that is ahead or behind for a while, and right again; its way up to there is not taken back.
#[test]
fn odometry_that_begins_anew_takes_no_way_back() {
    let truth = decode_all::<PoseStamped>(&walk().messages, TRUTH);
    let (late, gap) = (with_a_late_camera(&walk().messages), with_a_gap());
    for (messages, off_s) in [(&late, 100), (&gap, 100), (&gap, -100)] {
        let mut number = 0;
        let messages = changed::<Odometry>(messages, ODOMETRY, |odometry| {
            number += 1;
            if (100..115).contains(&number) {
                odometry.header.stamp = Stamp::from_nanoseconds(stamp_ns(&odometry.header) + off_s * 1_000_000_000);
            }
        });
        let room = Room::with_log(&messages);
        let replayed = room.replay("log.mcap");
        let predicted: Vec<FrameTag> = decode_all(&read_capture(&replayed.session), PREDICTED);
        let last = predicted.last().expect("some");
        assert!(off_m(last, &truth) < 0.16, "{off_s} s: {} m, {:?}", off_m(last, &truth), last.header.stamp);
        let after = |tag: &&FrameTag| stamp_ns(&tag.header) > stamp_ns(&last.header);
        let next = replayed.tags.iter().find(after).expect("a frame after it");
        assert!(!next.ambiguous && off_m(next, &truth) < 0.03, "{off_s} s: {next:?}");
    }
}

/// A clock that jumps ahead, for one message, while frames come; and a camera of one frame a second.
#[test]
fn what_is_no_gap_is_none() {
    let mut number = 0;
    let messages = changed::<Odometry>(&walk().messages, ODOMETRY, |odometry| {
        number += 1;
        if number == 100 {
            odometry.header.stamp = Stamp::from_nanoseconds(odometry.header.stamp.to_nanoseconds() + 8_000_000_000);
        }
    });
    assert_eq!(Room::with_log(&messages).replay("log.mcap").report["predicted"], 0);
    let mut number = 0;
    let slow = |message: &&LogMessage| {
        number += usize::from(message.channel.topic == IMAGE);
        message.channel.topic != IMAGE || number % 10 == 1
    };
    let messages: Vec<LogMessage> = walk().messages.iter().filter(slow).cloned().collect();
    let replayed = Room::with_log(&messages).replay("log.mcap");
    assert!(replayed.tags.len() >= 3 && replayed.report["predicted"].as_u64() <= Some(1), "{:?}", replayed.report);
}
