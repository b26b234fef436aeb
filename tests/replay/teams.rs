//! Logs of robots of 2026, rebuilt from a rendered walk with their topics, types and quirks, are replayed as they are.
//!
//! Topics and definitions are those of bit-bots/bitbots_main (rosbag_record.launch.py, motion_odometry.cpp), of
//! BoosterRobotics/robocup_demo (src/brain/src/brain.cpp, src/vision/config/vision.yaml) and
//! BoosterRobotics/booster_robotics_sdk_ros2 (booster_ros2_interface/msg), of HULKs/hulk (crates/nodes/image_receiver,
//! crates/x5_receiver, crates/nodes/odometer_bridge), and of ros-sports/humanoid_base_footprint.

use std::sync::OnceLock;

use glam::{DQuat, DVec3};
use realitysim::geometry::{Euler, Isometry, Pose2};
use realitysim::ros2::messages::{
    CameraInfo, Header, Image, Imu, ImuState, JointState, LowState, MotorState, Odometer, Odometry, Pose, PoseStamped,
    Quaternion, Stamp, TFMessage, Transform, TransformStamped, Twist, TwistStamped, TwistWithCovarianceStamped,
    Vector3,
};
use realitysim::ros2::{LogMessage, Message};
use serde_json::Value;

use super::support::{
    CAMERA_INFO, IMU, INITIAL, ODOMETRY, Replayed, Room, TF_STATIC, TRUTH, changed, decode_all, message, on, read_log,
    without,
};

/// Encoding of the pictures of Bit-Bots, whose ZED camera sends `bgra8`.
const BIT_BOTS_ENCODING: &str = "bgra8";
/// Encoding of the pictures of HULKs, whose X5 camera sends `nv12`.
const HULKS_ENCODING: &str = "nv12";
/// Largest share of tags that may be invalid.
const VALID_SHARE: f64 = 0.95;

const RAW: &str = "/camera/image_raw";
/// A rectified picture: a lens without distortion, 80 degrees wide.
const PINHOLE: &str = "title = \"Rectified\"\nwidth = 320\nheight = 240\nfx = 190.0\nfy = 190.0\ncx = 159.5\ncy = 119.5\n\
                       model = \"plumb_bob\"\nd = [0.0, 0.0, 0.0, 0.0, 0.0]\n";

/// A walk through the same scene, seen through a rectified camera and sent as raw pixels.
fn pinhole_walk() -> &'static [LogMessage] {
    static WALK: OnceLock<Vec<LogMessage>> = OnceLock::new();
    WALK.get_or_init(|| {
        let room = Room::new();
        room.write_scene("scene.toml", |text| text.replace("jpeg_quality = 90\n", ""));
        room.write("lens.toml", PINHOLE);
        room.run("scene render scene.toml -o log.mcap").succeeds();
        read_log(&room.path("log.mcap"))
    })
}

/// Time by which a message without a stamp comes late: even between 0 and 20 ms, without order.
fn delay_ns(index: usize) -> i64 {
    (index as i64 * 7919 % 20) * 1_000_000
}

fn stamp_of(message: &LogMessage) -> i64 {
    message.log_time_ns
}

/// The picture in another encoding of the same pixels.
fn encoded(image: &Image, encoding: &str, frame: &str) -> Image {
    let (width, pixels) = (image.width as usize, image.data.chunks_exact(3));
    let luma = |rgb: &[u8]| (0.299 * f64::from(rgb[0]) + 0.587 * f64::from(rgb[1]) + 0.114 * f64::from(rgb[2])).round();
    let (data, step) = match encoding {
        "rgb8" => (image.data.clone(), 3 * image.width),
        "bgra8" => (pixels.flat_map(|rgb| [rgb[2], rgb[1], rgb[0], 255]).collect(), 4 * image.width),
        // A plane of brightness, then one of blue and red differences for each block of 2 x 2.
        "nv12" => {
            let mut data: Vec<u8> = pixels.map(|rgb| luma(rgb) as u8).collect();
            for row in (0..image.height as usize).step_by(2) {
                for column in (0..width).step_by(2) {
                    let rgb = &image.data[3 * (row * width + column)..][..3];
                    let chroma = |colour: u8, scale: f64| (128.0 + scale * (f64::from(colour) - luma(rgb))) as u8;
                    data.extend([chroma(rgb[2], 0.564), chroma(rgb[0], 0.713)]);
                }
            }
            (data, image.width)
        }
        other => panic!("no such encoding here: {other}"),
    };
    let header = Header { frame_id: frame.to_owned(), ..image.header.clone() };
    Image { header, encoding: encoding.to_owned(), step, data, ..image.clone() }
}

/// The messages on new topics in the order of their log times, with the truth and the announced pose of the walk.
struct TeamLog {
    messages: Vec<LogMessage>,
    topics: Vec<String>,
}

impl TeamLog {
    fn new() -> Self {
        let kept = [TRUTH, INITIAL];
        let messages = pinhole_walk().iter().filter(|message| kept.contains(&message.channel.topic.as_str()));
        Self { messages: messages.cloned().collect(), topics: Vec::new() }
    }

    fn add<M: Message>(&mut self, topic: &str, log_time_ns: i64, content: &M) {
        let known = self.topics.iter().position(|known| known == topic).unwrap_or_else(|| {
            self.topics.push(topic.to_owned());
            self.topics.len() - 1
        });
        self.messages.push(message(100 + known as u16, topic, log_time_ns, content));
    }

    /// The pictures, which come 30 ms after their exposure, each with its calibration.
    fn add_camera(&mut self, image: &str, encoding: &str, info: &str, frame: &str) {
        let calibration: CameraInfo = decode_all(pinhole_walk(), CAMERA_INFO).remove(0);
        for frame_message in on(pinhole_walk(), RAW) {
            let picture = encoded(&Image::decode(&frame_message.data).expect("an image"), encoding, frame);
            let late_ns = frame_message.log_time_ns + 30_000_000;
            let of_it = CameraInfo { header: picture.header.clone(), ..calibration.clone() };
            self.add(info, late_ns, &of_it);
            self.add(image, late_ns, &picture);
        }
    }

    fn finish(mut self) -> Vec<LogMessage> {
        self.messages.sort_by_key(|message| message.log_time_ns);
        self.messages
    }
}

/// The transform from `parent` to `child` as the scene announces it.
fn announced(child: &str) -> Isometry {
    let constants: TFMessage = decode_all(pinhole_walk(), TF_STATIC).remove(0);
    let found = constants.transforms.iter().find(|transform| transform.child_frame_id == child).expect("announced");
    found.transform.into()
}

fn transform(stamp_ns: i64, parent: &str, child: &str, parent_from_child: Isometry) -> TransformStamped {
    TransformStamped {
        header: Header::at(stamp_ns, parent),
        child_frame_id: child.to_owned(),
        transform: Transform::from(parent_from_child),
    }
}

fn constants(transforms: Vec<TransformStamped>) -> TFMessage {
    TFMessage { transforms }
}

/// Attitudes and turn rates of the walk, with their times.
fn inertial() -> Vec<(i64, Imu)> {
    on(pinhole_walk(), IMU).map(|message| (stamp_of(message), Imu::decode(&message.data).expect("an IMU"))).collect()
}

/// Poses of the footprint by odometry, with their times.
fn steps() -> Vec<(i64, Pose2)> {
    let step = |message: &LogMessage| {
        let odometry = Odometry::decode(&message.data).expect("odometry");
        (stamp_of(message), Pose2::from_isometry(&Isometry::from(odometry.pose.pose)))
    };
    on(pinhole_walk(), ODOMETRY).map(step).collect()
}

/// As Bit-Bots record: odometry is that of the torso, the footprint hangs on the torso, the head is moved by `/tf`, and a second
/// inertial sensor is in the head.
fn bit_bots() -> Vec<LogMessage> {
    let mut log = TeamLog::new();
    let start_ns = pinhole_walk()[0].log_time_ns;
    let optical = "zed_left_camera_optical_frame";
    log.add_camera("/zed/zed_node/rgb/image_rect_color", BIT_BOTS_ENCODING, "/zed/zed_node/rgb/camera_info", optical);
    let fixed = vec![
        transform(start_ns, "base_link", "imu_frame", Isometry::IDENTITY),
        transform(start_ns, "head", "zed_left_camera_frame", Isometry::IDENTITY),
        transform(start_ns, "zed_left_camera_frame", optical, announced("camera_optical_frame")),
    ];
    log.add("/tf_static", start_ns, &constants(fixed));
    let (height, head) = (announced("base_link").translation, announced("camera_link"));
    let steps = steps();
    for (stamp_ns, mut imu) in inertial() {
        imu.header.frame_id = "imu_frame".to_owned();
        log.add("/imu/data", stamp_ns + 2_000_000, &imu);
        imu.header.frame_id = "imu_head".to_owned();
        log.add("/imu_head/data", stamp_ns + 2_000_000, &imu);
        let tilt = Euler { yaw: 0.0, ..Euler::from_rotation(DQuat::from(imu.orientation)) };
        let footprint_from_base = Isometry::from_euler(tilt, height);
        let latest = steps.iter().rev().find(|(time_ns, _)| *time_ns <= stamp_ns);
        let Some((time_ns, step)) = latest else { continue };
        let joints = JointState {
            header: Header::at(stamp_ns, ""),
            name: vec!["head_yaw".into(), "head_pitch".into()],
            position: vec![0.0, 0.0],
            ..JointState::default()
        };
        log.add("/joint_states", stamp_ns + 1_000_000, &joints);
        let moving = vec![
            transform(stamp_ns, "base_link", "head", head),
            transform(stamp_ns, "base_link", "base_footprint", footprint_from_base.inverse()),
        ];
        log.add("/tf", stamp_ns + 1_000_000, &constants(moving));
        if *time_ns == stamp_ns {
            let odom_from_base = step.to_isometry() * footprint_from_base;
            log.add(
                "/tf",
                stamp_ns + 3_000_000,
                &constants(vec![transform(stamp_ns, "odom", "base_link", odom_from_base)]),
            );
            let mut odometry = Odometry { header: Header::at(stamp_ns, "odom"), ..Odometry::default() };
            odometry.child_frame_id = "base_link".to_owned();
            odometry.pose.pose = Pose::from(odom_from_base);
            log.add("/motion_odometry", stamp_ns + 3_000_000, &odometry);
        }
    }
    let goal = PoseStamped { header: Header::at(start_ns, "map"), ..PoseStamped::default() };
    log.add("/goal_pose", start_ns, &goal);
    log.finish()
}

/// Odometry and state of sensors and joints as robots of Booster send them: 32 bits, no stamps, and up to 20 ms late.
fn add_booster_state(log: &mut TeamLog) {
    for (index, (stamp_ns, step)) in steps().into_iter().enumerate() {
        let odometer = Odometer { x: step.x as f32, y: step.y as f32, theta: step.yaw as f32 };
        log.add("/odometer_state", stamp_ns + delay_ns(index), &odometer);
    }
    for (index, (stamp_ns, imu)) in inertial().into_iter().enumerate() {
        let Euler { roll, pitch, yaw } = Euler::from_rotation(DQuat::from(imu.orientation));
        let single = |vector: Vector3| [vector.x as f32, vector.y as f32, vector.z as f32];
        let imu_state = ImuState {
            rpy: [roll as f32, pitch as f32, yaw as f32],
            gyro: single(imu.angular_velocity),
            acc: single(imu.linear_acceleration),
        };
        let joints = vec![MotorState::default(); 22];
        let state = LowState { imu_state, motor_state_parallel: joints.clone(), motor_state_serial: joints };
        log.add("/low_state", stamp_ns + delay_ns(index), &state);
    }
}

/// As robots of Booster send: pictures and depths of one camera, and nothing else that has a stamp.
fn booster() -> Vec<LogMessage> {
    let mut log = TeamLog::new();
    let start_ns = pinhole_walk()[0].log_time_ns;
    log.messages.extend(on(pinhole_walk(), TF_STATIC).cloned());
    log.add_camera(
        "/StereoNetNode/rectified_image",
        "rgb8",
        "/StereoNetNode/stereonet_depth/camera_info",
        "camera_optical_frame",
    );
    let depth = Image {
        header: Header::at(start_ns, "camera_optical_frame"),
        height: 2,
        width: 2,
        encoding: "16UC1".into(),
        is_bigendian: 0,
        step: 4,
        data: vec![0; 8],
    };
    log.add("/StereoNetNode/stereonet_depth", start_ns, &depth);
    add_booster_state(&mut log);
    log.finish()
}

/// As HULKs' robots send, which are Booster's: the pictures of both eyes.
fn hulks() -> Vec<LogMessage> {
    let mut log = TeamLog::new();
    log.messages.extend(on(pinhole_walk(), TF_STATIC).cloned());
    for eye in ["/inputs/left_image", "/inputs/right_image"] {
        log.add_camera(eye, HULKS_ENCODING, "/inputs/camera_info", "x5");
    }
    add_booster_state(&mut log);
    // The calibration is that of the left eye, and its coordinate frame is known by the camera's own name.
    changed::<TFMessage>(&log.finish(), TF_STATIC, |constants| {
        for transform in &mut constants.transforms {
            if transform.child_frame_id == "camera_optical_frame" {
                transform.child_frame_id = "x5".to_owned();
            }
        }
    })
}

/// Replays a log, of which nearly every tag must be valid and right.
fn replayed(room: &Room, arguments: &str) -> Replayed {
    let replayed = room.replay(&format!("log.mcap {arguments}"));
    let (valid, tagged) = (replayed.count("valid"), replayed.count("tagged"));
    assert!(valid as f64 >= VALID_SHARE * tagged as f64 && tagged > 30, "{}", replayed.report);
    let judged = judged(room, &replayed);
    assert!(judged["position_cm"]["p95"].as_f64().is_some_and(|cm| cm < 5.0), "{judged}");
    assert!(judged["ellipse95_share"].as_f64().is_some_and(|share| share >= 0.85), "{judged}");
    replayed
}

fn judged(room: &Room, replayed: &Replayed) -> Value {
    let session = replayed.session.display();
    room.run(&format!("eval {session} --truth log.mcap --json")).succeeds().json()
}

/// The topic that is read for a measurement, and the reason.
fn choice<'a>(report: &'a Value, measurement: &str) -> (&'a str, &'a str) {
    let choices = report["read"].as_array().expect("a list");
    let found = choices.iter().find(|choice| choice["measurement"] == measurement).expect("chosen");
    (found["topic"].as_str().expect("a name"), found["reason"].as_str().expect("a reason"))
}

#[test]
fn a_log_of_bit_bots_is_tagged_as_it_is() {
    let room = Room::with_log(&bit_bots());
    let replayed = replayed(&room, "--field kid-2009");
    let report = &replayed.report;
    assert_eq!(choice(report, "image"), ("/zed/zed_node/rgb/image_rect_color", "only topic of this type"));
    assert_eq!(choice(report, "camera_info"), ("/zed/zed_node/rgb/camera_info", "beside the image topic"));
    assert_eq!(choice(report, "odometry"), ("/motion_odometry", "only topic of this type"));
    assert_eq!(choice(report, "imu"), ("/imu/data", "configured"));
    assert_eq!(report["warnings"], serde_json::json!([]));
    let info = room.run("log info log.mcap --json").succeeds().json();
    for measurement in ["image", "camera_info", "odometry", "imu", "tf", "tf_static"] {
        assert_eq!(choice(&info, measurement), choice(report, measurement), "{info}");
    }
    let told = room.run("log info log.mcap").succeeds().stdout;
    assert!(told.contains("a replay reads:") && told.contains("beside the image topic"), "{told}");
}

#[test]
fn odometry_of_the_torso_in_tf_alone_is_enough() {
    let room = Room::with_log(&without(&bit_bots(), "/motion_odometry"));
    let replayed = replayed(&room, "");
    assert_eq!(choice(&replayed.report, "odometry"), ("/tf", "has odometry, and no topic has"));
}

#[test]
fn a_log_of_booster_is_tagged_as_it_is() {
    let room = Room::with_log(&booster());
    let replayed = replayed(&room, "");
    let report = &replayed.report;
    assert_eq!(choice(report, "image").0, "/StereoNetNode/rectified_image");
    assert_eq!(choice(report, "odometry"), ("/odometer_state", "only topic of this type"));
    assert_eq!(choice(report, "imu"), ("/low_state", "only topic of this type"));
    assert_eq!(choice(report, "joints"), ("/low_state", "only topic of this type"));
    let warnings = report["warnings"].to_string();
    assert!(warnings.contains("/low_state and /odometer_state without stamps"), "{warnings}");
}

#[test]
fn a_log_of_hulks_is_tagged_once_the_eye_is_named() {
    let room = Room::with_log(&hulks());
    room.run("replay log.mcap -o captures").fails(1, &["topics.image", "/inputs/left_image", "/inputs/right_image"]);
    let info = room.run("log info log.mcap --json").succeeds().json();
    assert!(info["unclear"].as_str().is_some_and(|said| said.contains("/inputs/left_image")), "{info}");
    let replayed = replayed(&room, "--set topics.image=/inputs/left_image");
    assert_eq!(choice(&replayed.report, "camera_info"), ("/inputs/camera_info", "beside the image topic"));
}

#[test]
fn a_capture_of_a_log_without_stamps_gives_the_same_tags() {
    let room = Room::with_log(&booster());
    let first = room.replay("log.mcap");
    let again = room.replay(&first.session.display().to_string());
    super::support::assert_same(&again.tags, &first.tags, "a capture of it");
}

#[test]
fn a_camera_whose_clock_is_not_the_log_s_is_told() {
    let image = "/StereoNetNode/rectified_image";
    let later = |messages: &[LogMessage]| {
        changed::<Image>(messages, image, |image| {
            let stamp_ns = image.header.stamp.to_nanoseconds();
            image.header.stamp = Stamp::from_nanoseconds(stamp_ns + 12_000_000_000);
        })
    };
    let room = Room::with_log(&later(&booster()));
    room.run("replay log.mcap -o captures")
        .fails(1, &["/odometer_state has no stamps", image, "12.0 s after the log's", "recorder's clock"]);
    // Something else has stamps that agree with the log.
    let mut messages = without(&later(&booster()), "/odometer_state");
    messages.extend(on(pinhole_walk(), ODOMETRY).cloned());
    messages.sort_by_key(|message| message.log_time_ns);
    let room = Room::with_log(&messages);
    room.run("replay log.mcap -o captures")
        .fails(1, &["/low_state has no stamps", "/odom agree with the log's", "the camera's clock is off"]);
}

#[test]
fn a_type_that_is_defined_otherwise_is_refused_with_the_field() {
    let mut messages = booster();
    for message in messages.iter_mut().filter(|message| message.channel.topic == "/odometer_state") {
        let mut channel = message.channel.as_ref().clone();
        channel.definition = b"std_msgs/Header header\nfloat32 x\nfloat32 y\nfloat32 theta\n".as_slice().into();
        message.channel = channel.into();
    }
    let words = ["/odometer_state", "booster_interface/msg/Odometer", "`Header header`", "`float32 x`"];
    Room::with_log(&messages).run("replay log.mcap -o captures").fails(1, &words);
}

#[test]
fn poses_and_velocities_are_odometry_where_the_settings_say_so() {
    let walk = pinhole_walk();
    let rest = without(walk, ODOMETRY);
    let room = Room::with_log(&rest);
    room.run("replay log.mcap -o captures").fails(1, &["no odometry on /odom"]);
    let as_other = |kind: &str| {
        let mut messages = rest.clone();
        for step in on(walk, ODOMETRY) {
            let Odometry { header, pose, twist, .. } = Odometry::decode(&step.data).expect("odometry");
            let time_ns = step.log_time_ns;
            messages.push(match kind {
                "PoseStamped" => message(99, "/walk", time_ns, &PoseStamped { header, pose: pose.pose }),
                "TwistStamped" => message(99, "/walk", time_ns, &TwistStamped { header, twist: twist.twist }),
                _ => message(99, "/walk", time_ns, &TwistWithCovarianceStamped { header, twist }),
            });
        }
        messages.sort_by_key(|message| message.log_time_ns);
        messages
    };
    for kind in ["PoseStamped", "TwistStamped", "TwistWithCovarianceStamped"] {
        let room = Room::with_log(&as_other(kind));
        room.run("replay log.mcap -o captures").fails(1, &["is it /walk?", "topics.odometry"]);
        let replayed = replayed(&room, "--set topics.odometry=/walk");
        assert_eq!(choice(&replayed.report, "odometry"), ("/walk", "configured"), "{kind}");
    }
    // What of a velocity is not on the ground has no influence.
    let tumbling = changed::<TwistStamped>(&as_other("TwistStamped"), "/walk", |stamped| {
        let Twist { linear, angular } = &mut stamped.twist;
        (linear.z, angular.x, angular.y) = (3.0, 4.0, 5.0);
    });
    replayed(&Room::with_log(&tumbling), "--set topics.odometry=/walk");
}

/// The walk with raw turn rates and accelerations only, after two seconds in which the robot stands.
fn raw_walk() -> (Vec<LogMessage>, Vec<(i64, DQuat)>) {
    let walk = pinhole_walk();
    let mut messages = changed::<Imu>(walk, IMU, |imu| {
        imu.orientation = Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 0.0 };
        imu.orientation_covariance[0] = -1.0;
    });
    let truths: Vec<(i64, DQuat)> =
        inertial().into_iter().map(|(stamp_ns, imu)| (stamp_ns, DQuat::from(imu.orientation))).collect();
    let (first_ns, first) = inertial().remove(0);
    let up = DQuat::from(first.orientation).conjugate() * DVec3::Z;
    for index in 1..=200 {
        let stamp_ns = first_ns - index * 10_000_000;
        let mut imu = Imu { header: Header::at(stamp_ns, "base_link"), ..Imu::default() };
        imu.orientation_covariance[0] = -1.0;
        imu.linear_acceleration = Vector3::from(up * 9.80665);
        messages.push(message(98, IMU, stamp_ns, &imu));
    }
    messages.sort_by_key(|message| message.log_time_ns);
    (messages, truths)
}

#[test]
fn raw_rates_and_accelerations_make_an_attitude_at_this_cost() {
    use realitysim::log_input::attitude_filter::{AttitudeFilter, MADE_TILT_SIGMA_RAD};
    let (messages, truths) = raw_walk();
    let mut filter = AttitudeFilter::default();
    let (mut squares, mut count) = (0.0, 0);
    for imu in decode_all::<Imu>(&messages, IMU) {
        let stamp_ns = imu.header.stamp.to_nanoseconds();
        let (rate, acceleration) = (DVec3::from(imu.angular_velocity), DVec3::from(imu.linear_acceleration));
        let made = filter.push(stamp_ns, rate, acceleration);
        if let (Some(made), Some((_, truth))) = (made, truths.iter().find(|(time_ns, _)| *time_ns == stamp_ns)) {
            let up = |attitude: DQuat| attitude.conjugate() * DVec3::Z;
            squares += up(made).distance_squared(up(*truth));
            count += 1;
        }
    }
    let rms_deg = (squares / f64::from(count)).sqrt().to_degrees();
    let room = Room::with_log(&messages);
    let made = room.replay("log.mcap");
    let stated = Room::with_log(pinhole_walk());
    let known = stated.replay("log.mcap");
    let (of_made, of_known) = (judged(&room, &made), judged(&stated, &known));
    println!(
        "tilt {rms_deg:.2} deg rms; valid {} and {} of {}; {of_made}; {of_known}",
        made.count("valid"),
        known.count("valid"),
        known.count("tagged")
    );
    assert!(rms_deg < MADE_TILT_SIGMA_RAD.to_degrees(), "{rms_deg}");
    assert!(made.count("valid") as f64 >= VALID_SHARE * made.count("tagged") as f64, "{}", made.report);
    let warnings = made.report["warnings"].to_string();
    assert!(warnings.contains("/imu/data states no orientation: roll and pitch were made"), "{warnings}");
}

#[test]
fn a_rectified_picture_is_seen_through_the_projection_matrix() {
    let info = "/zed/zed_node/rgb/camera_info";
    let log = bit_bots();
    let as_image_proc = changed::<CameraInfo>(&log, info, |info| {
        let [fx, _, cx, _, fy, cy, ..] = info.k;
        info.p = [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0];
        // What the camera itself sees is distorted, and longer in focus.
        info.d = vec![-0.3, 0.1, 0.001, -0.001, 0.0];
        (info.k[0], info.k[4]) = (1.2 * fx, 1.2 * fy);
    });
    let expected = Room::with_log(&log).replay("log.mcap");
    let found = Room::with_log(&as_image_proc).replay("log.mcap");
    super::support::assert_same(&found.tags, &expected.tags, "a calibration of the camera itself");
}
