//! A log with one message of every type, and what the tests compare.

use std::collections::BTreeMap;
use std::io::Cursor;

use realitysim::ros2::messages::{
    CameraInfo, CompressedImage, DiagnosticArray, DiagnosticStatus, FrameTag, Header, Image, Imu, ImuState, JointState,
    KeyValue, LowState, MotorState, Odometer, Odometry, Point, Pose, PoseStamped, PoseWithCovariance,
    PoseWithCovarianceStamped, Quaternion, RegionOfInterest, Stamp, TFMessage, Transform, TransformStamped, Twist,
    TwistStamped, TwistWithCovariance, TwistWithCovarianceStamped, Vector3,
};
use realitysim::ros2::{Damage, Durability, LogMessage, LogReader, LogWriter, Message, Selection};
use serde::Serialize;
use serde_json::{Value, json};

pub const START_NS: i64 = 1_760_000_000_000_000_000;

/// What was written, for comparison: topic, type and fields, in the order of writing.
pub type Written = Vec<Value>;

pub fn header(frame: &str) -> Header {
    Header { stamp: Stamp::from_nanoseconds(START_NS + 123_456_789), frame_id: frame.into() }
}

/// Numbers that no two fields share.
fn numbers<const N: usize>(start: f64) -> [f64; N] {
    std::array::from_fn(|i| start + i as f64 / 64.0)
}

fn point(start: f64) -> Point {
    let [x, y, z] = numbers(start);
    Point { x, y, z }
}

fn vector(start: f64) -> Vector3 {
    let [x, y, z] = numbers(start);
    Vector3 { x, y, z }
}

fn quaternion(start: f64) -> Quaternion {
    let [x, y, z, w] = numbers(start);
    Quaternion { x, y, z, w }
}

fn pose(start: f64) -> Pose {
    Pose { position: point(start), orientation: quaternion(start + 0.5) }
}

fn pose_with_covariance(start: f64) -> PoseWithCovariance {
    PoseWithCovariance { pose: pose(start), covariance: numbers(start + 100.0) }
}

fn frame_tag() -> FrameTag {
    FrameTag {
        header: header("map"),
        child_frame_id: "camera_link".into(),
        sequence: u64::MAX - 7,
        valid: true,
        reason: "naïve – no lines".into(),
        model: "gauss".into(),
        formula: "corrected".into(),
        particles: 500,
        iterations: 3,
        line_points: 250,
        elapsed_ms: 12.5,
        capped: true,
        weighed: 900,
        stopped_at: 640,
        effective_sample_size: 77.25,
        evidence: -1.5,
        spread_m: 0.125,
        spread_yaw_rad: 0.0625,
        ambiguous: true,
        mirror_pose: pose(-3.0),
        residual: 0.875,
        best_particle: pose(-5.0),
        refined: true,
        lines_expected: 180,
        lines_fitting: 171,
        lines_rms_px: 0.2,
        lines_explained: 0.9,
        pose: pose_with_covariance(7.0),
        yaw: 0.5,
        pitch: 0.25,
        roll: -0.125,
        odometry_until: Stamp { sec: -3, nanosec: 999_999_999 },
        kernel_stamp_ns: i64::MIN,
        utc_offset_ns: i64::MAX,
    }
}

struct Log {
    writer: LogWriter<Vec<u8>>,
    written: Written,
}

impl Log {
    fn add<M: Message + Serialize>(&mut self, topic: &str, durability: Durability, message: &M) {
        let channel = self.writer.add_channel::<M>(topic, durability).unwrap();
        let sequence = self.written.len() as u32;
        let time = START_NS + i64::from(sequence) * 1_000_000;
        self.writer.write(channel, sequence, time, time - 5, &message.encode()).unwrap();
        self.written.push(json!({"topic": topic, "type": M::TYPE, "log_time": time, "fields": message}));
    }
}

/// A finished log.
pub fn every_message() -> (Vec<u8>, Written) {
    let mut log = Log { writer: LogWriter::new(Vec::new()).unwrap(), written: Vec::new() };
    log.writer.attach("session.toml", "application/toml", START_NS, b"[camera]\n").unwrap();
    log.writer.metadata("session", &BTreeMap::from([("field".to_owned(), "kid".to_owned())])).unwrap();
    let latched = Durability::TransientLocal;
    let transform = TransformStamped {
        header: header("base_link"),
        child_frame_id: "camera_link".into(),
        transform: Transform { translation: vector(1.0), rotation: quaternion(2.0) },
    };
    log.add("/tf_static", latched, &TFMessage { transforms: vec![transform.clone(), transform.clone()] });
    log.add("/camera/camera_info", latched, &camera_info());
    log.add("/transform", Durability::Volatile, &transform);
    log.add("/camera/image/compressed", Durability::Volatile, &compressed_image(40));
    log.add("/camera/image", Durability::Volatile, &image());
    log.add("/imu/data", Durability::Volatile, &imu());
    log.add("/joint_states", Durability::Volatile, &joints());
    log.writer.flush_chunk().unwrap();
    let (pose_covariance, twist) = (pose_with_covariance(20.0), Twist { linear: vector(30.0), angular: vector(40.0) });
    let odometry = Odometry {
        header: header("odom"),
        child_frame_id: "base_footprint".into(),
        pose: pose_covariance,
        twist: TwistWithCovariance { twist, covariance: numbers(300.0) },
    };
    log.add("/odom", Durability::Volatile, &odometry);
    log.add("/pose", Durability::Volatile, &PoseStamped { header: header("map"), pose: pose(50.0) });
    let initial = PoseWithCovarianceStamped { header: header("map"), pose: pose_with_covariance(60.0) };
    log.add("/initialpose", Durability::Volatile, &initial);
    let twist = Twist { linear: vector(70.0), angular: vector(80.0) };
    log.add("/velocity", Durability::Volatile, &TwistStamped { header: header("base_link"), twist });
    let with_covariance = TwistWithCovariance { twist, covariance: numbers(400.0) };
    let stamped = TwistWithCovarianceStamped { header: header("base_link"), twist: with_covariance };
    log.add("/velocity_with_covariance", Durability::Volatile, &stamped);
    log.add("/odometer_state", Durability::Volatile, &Odometer { x: 0.5, y: -0.25, theta: 3.125 });
    log.add("/low_state", Durability::Volatile, &low_state());
    log.add("/diagnostics", Durability::Volatile, &diagnostics());
    log.add("/frame_tag", Durability::Volatile, &frame_tag());
    log.add("/diagnostics", Durability::Volatile, &DiagnosticArray::default());
    (log.writer.finish().unwrap(), log.written)
}

pub fn compressed_image(bytes: usize) -> CompressedImage {
    let data = (0..bytes).map(|i| (i * 7) as u8).collect();
    CompressedImage { header: header("camera_optical_frame"), format: "jpeg".into(), data }
}

fn image() -> Image {
    Image {
        header: header("camera_optical_frame"),
        height: 2,
        width: 3,
        encoding: "rgb8".into(),
        is_bigendian: 1,
        step: 9,
        data: (100..118).collect(),
    }
}

fn camera_info() -> CameraInfo {
    CameraInfo {
        header: header("camera_optical_frame"),
        height: 480,
        width: 640,
        distortion_model: "equidistant".into(),
        d: vec![0.1, -0.2, 0.3, -0.4],
        k: numbers(1.0),
        r: numbers(2.0),
        p: numbers(3.0),
        binning_x: 1,
        binning_y: 2,
        roi: RegionOfInterest { x_offset: 3, y_offset: 4, height: 5, width: 6, do_rectify: true },
    }
}

fn imu() -> Imu {
    Imu {
        header: header("base_link"),
        orientation: quaternion(1.0),
        orientation_covariance: numbers(2.0),
        angular_velocity: vector(3.0),
        angular_velocity_covariance: numbers(4.0),
        linear_acceleration: vector(5.0),
        linear_acceleration_covariance: numbers(6.0),
    }
}

fn joints() -> JointState {
    JointState {
        header: header(""),
        name: vec!["head_pan".into(), "".into(), "head_tilt".into()],
        position: vec![0.5, 0.25, f64::MIN_POSITIVE],
        velocity: vec![],
        effort: vec![1.5],
    }
}

fn low_state() -> LowState {
    let joint = |q: f32| MotorState {
        mode: -1,
        q,
        dq: 0.5,
        ddq: -0.5,
        tau_est: 2.25,
        temperature: 40,
        lost: 7,
        reserve: [3, 500],
    };
    let imu_state = ImuState { rpy: [0.5, -0.25, 1.5], gyro: [0.125, 0.25, 0.375], acc: [0.5, 0.75, 9.75] };
    LowState { imu_state, motor_state_parallel: vec![joint(0.25)], motor_state_serial: vec![joint(-0.5), joint(1.5)] }
}

fn diagnostics() -> DiagnosticArray {
    let values = vec![KeyValue { key: "frames".into(), value: "12".into() }, KeyValue::default()];
    let status = DiagnosticStatus {
        level: DiagnosticStatus::WARN,
        name: "camera".into(),
        message: "late".into(),
        hardware_id: "usb-1".into(),
        values,
    };
    DiagnosticArray { header: header(""), status: vec![status, DiagnosticStatus::default()] }
}

/// A small log of a few chunks, with an attachment, for tests that damage it.
pub fn small_log() -> Vec<u8> {
    let mut writer = LogWriter::new(Vec::new()).unwrap();
    writer.attach("lens.toml", "application/toml", START_NS, b"k = 1").unwrap();
    let channel = writer.add_channel::<CompressedImage>("/image", Durability::Volatile).unwrap();
    writer.flush_chunk().unwrap();
    for sequence in 0..6 {
        let time = START_NS + i64::from(sequence);
        writer.write(channel, sequence, time, time, &compressed_image(16 + sequence as usize).encode()).unwrap();
        if sequence % 2 == 1 {
            writer.flush_chunk().unwrap();
        }
    }
    writer.finish().unwrap()
}

/// All messages of a log that lies in memory.
pub fn read_all(log: &[u8], selection: Selection) -> (Vec<LogMessage>, Damage) {
    let mut reader = LogReader::open(Cursor::new(log), selection).unwrap();
    let messages = reader.by_ref().map(Result::unwrap).collect();
    (messages, reader.damage().clone())
}
