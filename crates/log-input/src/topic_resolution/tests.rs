use super::*;

fn log(topics: &[(&str, &str)]) -> TopicTypes {
    topics.iter().map(|(topic, kind)| ((*topic).to_owned(), [(*kind).to_owned()].into())).collect()
}

fn resolved(topics: &[(&str, &str)]) -> Result<ResolvedTopics, TopicError> {
    resolve(&Settings::default(), &log(topics), &StreamFacts::default())
}

/// The topic of a measurement, and the reason for it.
fn choice(found: &ResolvedTopics, measurement: &str) -> (String, ChoiceReason) {
    let choice = found.choices.iter().find(|choice| choice.measurement == measurement).expect("chosen");
    (choice.topic.clone(), choice.reason)
}

const WHOLE: [(&str, &str); 4] = [
    ("/cam/raw", "sensor_msgs/msg/Image"),
    ("/cam/info", "sensor_msgs/msg/CameraInfo"),
    ("/tf_static", "tf2_msgs/msg/TFMessage"),
    ("/walk", "nav_msgs/msg/Odometry"),
];
/// As a robot of Bit-Bots records: bit-bots/bitbots_main, src/bitbots_misc/bitbots_bringup/launch/rosbag_record.launch.py.
const BIT_BOTS: [(&str, &str); 11] = [
    ("/zed/zed_node/rgb/image_rect_color", "sensor_msgs/msg/Image"),
    ("/zed/zed_node/rgb/camera_info", "sensor_msgs/msg/CameraInfo"),
    ("/imu/data", "sensor_msgs/msg/Imu"),
    ("/imu_head/data", "sensor_msgs/msg/Imu"),
    ("/joint_states", "sensor_msgs/msg/JointState"),
    ("/motion_odometry", "nav_msgs/msg/Odometry"),
    ("/cmd_vel", "geometry_msgs/msg/Twist"),
    ("/goal_pose", "geometry_msgs/msg/PoseStamped"),
    ("/pose_with_covariance", "geometry_msgs/msg/PoseWithCovarianceStamped"),
    ("/tf", "tf2_msgs/msg/TFMessage"),
    ("/tf_static", "tf2_msgs/msg/TFMessage"),
];
/// As a robot of Booster sends: BoosterRobotics/robocup_demo, src/brain/src/brain.cpp and src/vision/config/vision.yaml.
const BOOSTER: [(&str, &str); 6] = [
    ("/StereoNetNode/rectified_image", "sensor_msgs/msg/Image"),
    ("/StereoNetNode/stereonet_depth", "sensor_msgs/msg/Image"),
    ("/StereoNetNode/stereonet_depth/camera_info", "sensor_msgs/msg/CameraInfo"),
    ("/odometer_state", "booster_interface/msg/Odometer"),
    ("/low_state", "booster_interface/msg/LowState"),
    ("/tf_static", "tf2_msgs/msg/TFMessage"),
];

#[test]
fn the_only_topic_of_a_type_is_taken() {
    let found = resolved(&WHOLE).expect("all there");
    assert_eq!(choice(&found, "image"), ("/cam/raw".to_owned(), ChoiceReason::OnlyOfType));
    assert_eq!(choice(&found, "odometry"), ("/walk".to_owned(), ChoiceReason::OnlyOfType));
    assert_eq!(choice(&found, "camera_info"), ("/cam/info".to_owned(), ChoiceReason::BesideImage));
    assert_eq!(choice(&found, "tf_static"), ("/tf_static".to_owned(), ChoiceReason::Configured));
    assert_eq!((found.topics.image.as_str(), found.topics.odometry.as_str()), ("/cam/raw", "/walk"));
}

#[test]
fn the_topics_of_known_teams_are_found_without_a_setting() {
    let found = resolved(&BIT_BOTS).expect("all there");
    assert_eq!(choice(&found, "odometry"), ("/motion_odometry".to_owned(), ChoiceReason::OnlyOfType));
    assert_eq!(choice(&found, "imu"), ("/imu/data".to_owned(), ChoiceReason::Configured));
    let info = "/zed/zed_node/rgb/camera_info".to_owned();
    assert_eq!(choice(&found, "camera_info"), (info, ChoiceReason::BesideImage));
    let facts = StreamFacts { not_pictures: [BOOSTER[1].0.to_owned()].into(), ..StreamFacts::default() };
    let found = resolve(&Settings::default(), &log(&BOOSTER), &facts).expect("all there");
    let chosen: Vec<&str> = found.choices.iter().map(|choice| choice.topic.as_str()).collect();
    let expected = [BOOSTER[0].0, BOOSTER[2].0, "/odometer_state", "/low_state", "/low_state", "/tf_static"];
    assert_eq!(chosen, expected);
    assert!(
        found
            .choices
            .iter()
            .all(|choice| choice.measurement == "tf_static" || choice.reason == ChoiceReason::OnlyOfType)
    );
}

#[test]
fn a_pose_or_velocity_is_odometry_only_if_it_is_named() {
    let without: Vec<_> = BIT_BOTS.into_iter().filter(|(name, _)| *name != "/motion_odometry").collect();
    let said = resolved(&without).expect_err("none").to_string();
    assert!(said.contains("is it /goal_pose or /pose_with_covariance?"), "{said}");
    let mut settings = Settings::default();
    settings.topics.odometry = "/goal_pose".to_owned();
    let found = resolve(&settings, &log(&without), &StreamFacts::default()).expect("named");
    assert_eq!(choice(&found, "odometry"), ("/goal_pose".to_owned(), ChoiceReason::Configured));
    let facts = StreamFacts { odometry_in_tf: true, ..StreamFacts::default() };
    let found = resolve(&Settings::default(), &log(&without), &facts).expect("in /tf");
    assert_eq!(choice(&found, "odometry"), ("/tf".to_owned(), ChoiceReason::OdometryInTransforms));
}

#[test]
fn of_one_camera_s_picture_the_raw_form_is_preferred() {
    const KIND: &str = "sensor_msgs/msg/Image";
    let chosen = |names: &[&str]| {
        let topics: Vec<(&str, &str)> = names.iter().map(|name| (*name, KIND)).collect();
        image("/other", &log(&topics))
    };
    for (names, expected) in [
        (["/a/image_rect", "/a/image_raw"], "/a/image_raw"),
        (["/a/image_raw/compressed", "/a/image_raw"], "/a/image_raw"),
        (["/a/image_rect_color", "/a/image_raw/compressed"], "/a/image_raw/compressed"),
        (["/a/image_mono", "/a/image_color/compressed"], "/a/image_color/compressed"),
    ] {
        assert_eq!(chosen(&names), Ok(expected.to_owned()), "{names:?}");
    }
    for names in [["/a/image_raw", "/b/image_raw"], ["/a/left_raw", "/a/right_rect"], ["/image_raw", "/a/image_raw"]] {
        let said = chosen(&names).expect_err("two cameras").to_string();
        assert!(names.iter().all(|name| said.contains(name)) && said.contains("topics.image"), "{said}");
    }
}

#[test]
fn of_two_inertial_sensors_the_one_on_the_torso_is_taken() {
    let mut topics = WHOLE.to_vec();
    topics.extend([("/head/imu", "sensor_msgs/msg/Imu"), ("/torso/imu", "sensor_msgs/msg/Imu")]);
    let with = |mounted: &[&str]| {
        let mounted_imus = mounted.iter().map(|topic| (*topic).to_owned()).collect();
        let facts = StreamFacts { mounted_imus, ..StreamFacts::default() };
        resolve(&Settings::default(), &log(&topics), &facts).expect("all there")
    };
    let found = with(&["/torso/imu"]);
    assert_eq!(choice(&found, "imu"), ("/torso/imu".to_owned(), ChoiceReason::MountedOnTorso));
    for mounted in [&[][..], &["/head/imu", "/torso/imu"]] {
        assert!(with(mounted).choices.iter().all(|choice| choice.measurement != "imu"), "never guessed");
    }
}

#[test]
fn messages_of_foxglove_in_json_are_told() {
    let mut rest = log(&WHOLE[1..]);
    rest.insert("/eye".into(), ["foxglove.CompressedImage in json".to_owned()].into());
    let said = resolve(&Settings::default(), &rest, &StreamFacts::default()).expect_err("JSON").to_string();
    assert!(said.contains("not read are /eye (foxglove.CompressedImage in json)"), "{said}");
    assert!(said.contains("in protobuf: foxglove.CompressedImage, foxglove.RawImage"), "{said}");
}

#[test]
fn what_is_missing_or_unclear_is_said() {
    let without = |topic: &str| {
        let rest: Vec<_> = WHOLE.into_iter().filter(|(name, _)| *name != topic).collect();
        resolved(&rest).expect_err("missing").to_string()
    };
    assert!(without("/walk").contains("random_walk"));
    assert!(without("/cam/raw").contains("no camera images on /camera/image/compressed"));
    assert!(without("/cam/info").contains("camera.lens"));
    assert!(without("/tf_static").contains("tf2_msgs/msg/TFMessage"));
    let two: Vec<_> = WHOLE.into_iter().chain([("/cam2", "sensor_msgs/msg/Image")]).collect();
    let said = resolved(&two).expect_err("unclear").to_string();
    assert!(said.contains("topics.image: /cam/raw, /cam2"), "{said}");
    let other: Vec<_> = WHOLE
        .into_iter()
        .map(|(name, kind)| if name == "/walk" { ("/odom", "std_msgs/msg/String") } else { (name, kind) })
        .collect();
    let said = resolved(&other).expect_err("another type").to_string();
    assert!(said.contains("/odom, whose type is std_msgs/msg/String"), "{said}");
}
