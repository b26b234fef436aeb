//! Tests with messages that are made here; tests/replay/foxglove.rs reads logs that Foxglove's own packages wrote.

use proptest::prelude::*;
use prost::Message as _;

use super::*;

const TIME: schemas::Timestamp = schemas::Timestamp { seconds: 12, nanos: 345 };

fn header(frame_id: &str) -> Header {
    Header { stamp: Stamp { sec: 12, nanosec: 345 }, frame_id: frame_id.to_owned() }
}

fn converted<M: Message>(kind: FoxgloveType, message: &impl prost::Message) -> M {
    let cdr = kind.to_ros2(message.encode_to_vec()).unwrap_or_else(|error| panic!("{error}"));
    M::decode(&cdr).expect("a message of its ROS 2 type")
}

#[test]
fn an_image_says_the_same_in_ros() {
    let data = Bytes::from_static(&[1, 2, 3, 4, 5, 6]);
    let message = schemas::CompressedImage {
        timestamp: Some(TIME),
        data: data.clone(),
        format: "jpeg".to_owned(),
        frame_id: "eye".to_owned(),
    };
    let image: CompressedImage = converted(FoxgloveType::CompressedImage, &message);
    assert_eq!(image, CompressedImage { header: header("eye"), format: "jpeg".to_owned(), data: data.to_vec() });
    for (encoding, expected) in [("rgb8", "rgb8"), ("8UC3", "bgr8")] {
        let message = schemas::RawImage {
            timestamp: Some(TIME),
            width: 2,
            height: 1,
            encoding: encoding.to_owned(),
            step: 6,
            data: data.clone(),
            frame_id: "eye".to_owned(),
        };
        let image: Image = converted(FoxgloveType::RawImage, &message);
        let (encoding, data) = (expected.to_owned(), data.to_vec());
        let header = header("eye");
        assert_eq!(image, Image { header, height: 1, width: 2, encoding, is_bigendian: 0, step: 6, data });
    }
}

#[test]
fn a_calibration_says_the_same_in_ros() {
    let message = schemas::CameraCalibration {
        timestamp: Some(TIME),
        width: 640,
        height: 480,
        distortion_model: "equidistant".to_owned(),
        d: vec![0.1, 0.2, 0.3, 0.4],
        k: (0..9).map(f64::from).collect(),
        r: vec![],
        p: (0..12).map(f64::from).collect(),
        frame_id: "eye".to_owned(),
    };
    let info: CameraInfo = converted(FoxgloveType::CameraCalibration, &message);
    assert_eq!((info.width, info.height, info.distortion_model.as_str()), (640, 480, "equidistant"));
    assert_eq!(
        (&info.header, info.d, info.k[8], info.r, info.p[11]),
        (&header("eye"), message.d.clone(), 8.0, [0.0; 9], 11.0)
    );
    let short = schemas::CameraCalibration { k: vec![1.0; 8], ..message };
    let refused = FoxgloveType::CameraCalibration.to_ros2(short.encode_to_vec()).expect_err("8 of 9").to_string();
    assert!(refused.contains("foxglove.CameraCalibration: K has 8 numbers, where 9 are needed"), "{refused}");
}

#[test]
fn transforms_and_poses_say_the_same_in_ros() {
    let (translation, rotation) =
        (schemas::Vector3 { x: 1.0, y: 2.0, z: 3.0 }, schemas::Quaternion { x: 0.1, y: 0.2, z: 0.3, w: 0.9 });
    let transform = schemas::FrameTransform {
        timestamp: Some(TIME),
        parent_frame_id: "base_link".to_owned(),
        child_frame_id: "camera_link".to_owned(),
        translation: Some(translation),
        rotation: Some(rotation),
    };
    let expected = TransformStamped {
        header: header("base_link"),
        child_frame_id: "camera_link".to_owned(),
        transform: Transform {
            translation: Vector3 { x: 1.0, y: 2.0, z: 3.0 },
            rotation: Quaternion { x: 0.1, y: 0.2, z: 0.3, w: 0.9 },
        },
    };
    let one: TFMessage = converted(FoxgloveType::FrameTransform, &transform);
    assert_eq!(one.transforms, std::slice::from_ref(&expected));
    let twice = schemas::FrameTransforms { transforms: vec![transform.clone(), transform] };
    let two: TFMessage = converted(FoxgloveType::FrameTransforms, &twice);
    assert_eq!(two.transforms, [expected.clone(), expected]);
    let pose = Some(schemas::Pose { position: Some(translation), orientation: Some(rotation) });
    let in_frame = schemas::PoseInFrame { timestamp: Some(TIME), frame_id: "map".to_owned(), pose };
    let stamped: PoseStamped = converted(FoxgloveType::PoseInFrame, &in_frame);
    let expected =
        Pose { position: Point { x: 1.0, y: 2.0, z: 3.0 }, orientation: Quaternion { x: 0.1, y: 0.2, z: 0.3, w: 0.9 } };
    assert_eq!(stamped, PoseStamped { header: header("map"), pose: expected });
    let odometry = schemas::Odometry {
        timestamp: Some(TIME),
        frame_id: "odom".to_owned(),
        body_frame_id: "base_footprint".to_owned(),
        pose,
        linear_velocity: Some(translation),
        angular_velocity: None,
        pose_covariance: (0..36).map(f64::from).collect(),
        velocity_covariance: vec![],
    };
    let found: Odometry = converted(FoxgloveType::Odometry, &odometry);
    assert_eq!((&found.header, found.child_frame_id.as_str()), (&header("odom"), "base_footprint"));
    assert_eq!((found.pose.pose, found.pose.covariance[35]), (expected, 35.0));
    assert_eq!(
        (found.twist.twist.linear.z, found.twist.twist.angular, found.twist.covariance),
        (3.0, vector(None), [0.0; 36])
    );
}

#[test]
fn a_joint_without_a_position_is_left_out() {
    let joint = |name: &str, position| schemas::JointState { name: name.to_owned(), position };
    let joints = vec![joint("head_pan", Some(0.5)), joint("broken", None), joint("head_tilt", Some(-0.25))];
    let found: JointState =
        converted(FoxgloveType::JointStates, &schemas::JointStates { timestamp: Some(TIME), joints });
    assert_eq!((found.name, found.position), (vec!["head_pan".to_owned(), "head_tilt".to_owned()], vec![0.5, -0.25]));
}

#[test]
fn a_message_without_a_possible_time_is_refused() {
    let beyond = i64::from(i32::MAX) + 1;
    let times = [(beyond, 0), (i64::MIN, 0), (0, -1), (0, 1_000_000_000)];
    let times = times.map(|(seconds, nanos)| Some(schemas::Timestamp { seconds, nanos }));
    for timestamp in times.into_iter().chain([None]) {
        let message = schemas::PoseInFrame { timestamp, ..schemas::PoseInFrame::default() };
        let refused = FoxgloveType::PoseInFrame.to_ros2(message.encode_to_vec()).expect_err("no time").to_string();
        assert!(refused.contains("foxglove.PoseInFrame: timestamp"), "{refused}");
    }
}

#[test]
fn a_message_larger_than_any_is_refused_unread() {
    let refused = FoxgloveType::FrameTransforms.to_ros2([10, 0].repeat(MAX_FOXGLOVE_BYTES)).expect_err("too large");
    assert!(matches!(refused, FoxgloveError::TooLarge { .. }), "{refused}");
}

proptest! {
    #[test]
    fn no_bytes_make_a_conversion_panic(which in 0..FoxgloveType::ALL.len(), bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
        if let Ok(cdr) = FoxgloveType::ALL[which].to_ros2(bytes) {
            prop_assert!(cdr.len() < 4096);
        }
    }
}
