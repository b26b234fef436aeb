//! Sound inputs of every format, small, for the fuzzer to begin from.

use std::fs;
use std::path::Path;

use mavlink::dialects::common::*;
use mavlink::{MAVLinkV2MessageRaw, MavHeader};
use realitysim::config::{Settings, field_names, lens_names, load_field, load_lens};
use realitysim::database::{Contents, Record, Source, SourceKind, TagLimits, write_index};
use realitysim::geometry::{Euler, Field, Isometry, Pose2};
use realitysim::log_input::decode;
use realitysim::log_input::foxglove::FoxgloveType;
use realitysim::log_input::synchroniser::InitialPose;
use realitysim::recording::{Counts, ManifestLine, PoseBox, SessionInfo};
use realitysim::ros2::messages::{LowState, Odometry, TFMessage};
use realitysim::ros2::{Message, Selection};
use realitysim::tagging::{Checkpoint, Tagger};

use super::KEPT;
use crate::config::other_formats::{KALIBR, ROS, VISUAL_MESH};
use crate::ros2::damaged::variants;
use crate::ros2::samples::{every_message, read_all};

fn keep(target: &str, name: &str, bytes: impl AsRef<[u8]>) {
    let folder = Path::new(KEPT).join(target);
    fs::create_dir_all(&folder).unwrap();
    fs::write(folder.join(name), bytes).unwrap();
}

/// What only explains the rest is noise to a fuzzer.
fn without_comments(text: &str) -> String {
    let lines = text.lines().map(|line| line.split('#').next().unwrap_or("").trim_end());
    lines.filter(|line| !line.is_empty()).map(|line| format!("{line}\n")).collect()
}

#[test]
#[ignore = "writes the inputs that the fuzzer begins from: only after a format has changed"]
fn the_inputs_to_begin_from_are_written_anew() {
    logs();
    texts();
    tables();
    images();
    foxglove();
    keep("mavlink", "sound-stream", mavlink_stream(50));
    keep("mavlink", "sound-one-byte-reads", mavlink_stream(1));
    keep("mavlink", "sound-interrupted", [&mavlink_stream(7)[..200], &mavlink_stream(7)[215..]].concat());
    checkpoints();
    indices();
    descriptions();
}

fn logs() {
    for (name, log) in variants() {
        keep("mcap", &format!("sound-{name}"), log);
    }
    let (messages, _) = read_all(&every_message().0, Selection::All);
    let types = [
        "sensor_msgs/msg/CompressedImage",
        "sensor_msgs/msg/Image",
        "sensor_msgs/msg/CameraInfo",
        "sensor_msgs/msg/Imu",
        "sensor_msgs/msg/JointState",
        "nav_msgs/msg/Odometry",
        "tf2_msgs/msg/TFMessage",
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        "geometry_msgs/msg/PoseStamped",
        "diagnostic_msgs/msg/DiagnosticArray",
        "realitysim_msgs/msg/FrameTag",
        "geometry_msgs/msg/TwistStamped",
        "geometry_msgs/msg/TwistWithCovarianceStamped",
        "booster_interface/msg/Odometer",
        "booster_interface/msg/LowState",
    ];
    for (which, name) in types.iter().enumerate() {
        let message = messages.iter().find(|message| message.channel.type_name == *name).expect("one of every type");
        let bytes = [&[which as u8][..], &message.data].concat();
        keep("cdr", &format!("sound-{}", name.rsplit('/').next().unwrap_or(name)), bytes);
    }
    let definitions = [LowState::DEFINITION, Odometry::DEFINITION, TFMessage::DEFINITION];
    for (which, (name, definition)) in ["low-state", "odometry", "tf"].iter().zip(definitions).enumerate() {
        keep("schema", &format!("sound-{name}"), [&[which as u8], definition.as_bytes()].concat());
    }
}

fn texts() {
    for name in field_names() {
        let text = fs::read_to_string(format!("config/fields/{name}.toml")).unwrap();
        keep("field", &format!("sound-{name}"), without_comments(&text));
    }
    for name in lens_names() {
        let text = fs::read_to_string(format!("config/cameras/{name}.toml")).unwrap();
        keep("lens", &format!("sound-{name}"), without_comments(&text));
    }
    for (name, text) in [("ros", ROS), ("kalibr", KALIBR), ("visualmesh", VISUAL_MESH)] {
        keep("lens", &format!("sound-{name}"), text);
    }
    for name in [
        "opencv-5.yml",
        "opencv-8.yml",
        "opencv-12.xml",
        "opencv-fisheye.xml",
        "kalibr-ds.yaml",
        "camera.cameramodel",
        "calib_results.txt",
        "ros-rational.yaml",
    ] {
        keep("lens", &format!("sound-{name}"), fs::read(format!("tests/data/lenses/{name}")).unwrap());
    }
    keep("settings", "sound-every-default", without_comments(&fs::read_to_string("config/robot.toml").unwrap()));
    keep("settings", "sound-filter", "[filter]\nparticles = 300\nalpha = -3.5\nmodel = \"distance\"\nseed = 5\n");
    keep("settings", "sound-serial", "[serial]\nports = [{ device = \"/dev/ttyACM0\", baud = 115200 }]\n");
    for scene in ["crowded", "bright-window", "push-and-fall", "bad-odometry", "dusk", "serial-noise", "head-scan"] {
        let text = fs::read_to_string(format!("replay/scenes/{scene}.toml")).unwrap();
        keep("scene", &format!("sound-{scene}"), without_comments(&text));
    }
    keep("gate", "sound-shelf", without_comments(&fs::read_to_string("replay/shelf.toml").unwrap()));
    let reference = fs::read_to_string("replay/references/demo.jsonl").unwrap();
    let frames = reference.lines().count() - 1;
    let few: Vec<&str> = reference.lines().take(4).collect();
    keep("gate", "sound-reference", few.join("\n").replace(&format!("\"frames\":{frames}"), "\"frames\":3"));
    keep("gate", "sound-case", "[[case]]\nsource = \"a.mcap\"\nlimits = { mean_cm = 1 }\nexcept_s = [[1, 2]]\n");
}

fn tables() {
    for (name, text) in [
        (
            "imu-degrees",
            "stamp,roll_deg,pitch_deg,yaw_deg,gx_dps,gy_dps,gz_dps,ax_g,ay_g,az_g\n1760000000.01,1,-2,3,0,0,1,0,0,1\n1760000000.02,1,-2,3,0,0,1,0,0,1\n",
        ),
        ("imu-quaternion", "Time [ns];qx;qy;qz;qw\n1760000000010000000;0;0;0;1\n1760000000020000000;0;0;0.6;0.8\n"),
        ("odometry-poses", "t_ms\tx_mm\ty_mm\ttheta_rad\n10\t1\t2\t0.1\n20\t2\t2\t0.1\n"),
        ("odometry-velocities", "# t,vx,vy,wz\n0.0,0.1,0,10\n0.1,0.2,0,-10\n"),
        ("joints", "stamp,pan_deg,tilt_deg\n1760000000.5,10,-5\n"),
        ("transforms", "stamp,parent,child,x,y,z,qx,qy,qz,qw\n1.5,base_footprint,camera_link,0,0,0.5,0,0,0,1\n"),
        ("mount", "parent,child,x,y,z,roll_deg,pitch_deg,yaw_deg\nbase_footprint,camera_link,0,0,0.5,0,17,0\n"),
        ("stamps", "image,stamp\n\"a,1.jpg\",1760000000123\nb.jpg,1760000000133\n"),
        ("known", "image,roll_deg,pitch_deg,height,x,y,yaw_deg\na.jpg,0,17,0.5,,,\nb.jpg,,,,1,2,90\n"),
        ("names", "frame_1760000000_250000000.png\nframe_1760000000.5.png\n"),
    ] {
        keep("table", &format!("sound-{name}"), text);
    }
}

fn images() {
    let rgb: Vec<u8> = (0..24 * 16 * 3).map(|i: u32| (i * i / 7) as u8).collect();
    let gray: Vec<u8> = rgb.iter().step_by(3).copied().collect();
    for (name, sampling, progressive) in [
        ("420", jpeg_encoder::SamplingFactor::F_2_2, false),
        ("422", jpeg_encoder::SamplingFactor::F_2_1, false),
        ("444-progressive", jpeg_encoder::SamplingFactor::F_1_1, true),
    ] {
        let mut bytes = Vec::new();
        let mut encoder = jpeg_encoder::Encoder::new(&mut bytes, 60);
        encoder.set_sampling_factor(sampling);
        encoder.set_progressive(progressive);
        encoder.encode(&rgb, 24, 16, jpeg_encoder::ColorType::Rgb).unwrap();
        keep("image", &format!("sound-jpeg-{name}"), bytes);
    }
    let mut bytes = Vec::new();
    jpeg_encoder::Encoder::new(&mut bytes, 60).encode(&gray, 24, 16, jpeg_encoder::ColorType::Luma).unwrap();
    keep("image", "sound-jpeg-gray", bytes);
    for (name, data, colour) in
        [("rgb", &rgb, image::ExtendedColorType::Rgb8), ("gray", &gray, image::ExtendedColorType::L8)]
    {
        let mut bytes = Vec::new();
        let encoder = image::codecs::png::PngEncoder::new(&mut bytes);
        image::ImageEncoder::write_image(encoder, data, 24, 16, colour).unwrap();
        keep("image", &format!("sound-png-{name}"), bytes);
    }
    for encoding in 0..decode::encodings().len() as u8 {
        keep("image", &format!("sound-raw-{encoding}"), [&[encoding, 6, 4, 24][..], &rgb[..144]].concat());
    }
}

/// A message of every type, with each field that has a length or is a number of 64 bits.
fn foxglove() {
    let field = |number: u8, content: &[u8]| [&[number << 3 | 2, content.len() as u8][..], content].concat();
    let double = |number: u8, value: f64| [&[number << 3 | 1][..], &value.to_le_bytes()].concat();
    let fixed32 = |number: u8, value: u32| [&[number << 3 | 5][..], &value.to_le_bytes()].concat();
    let doubles = |count: usize| 0.25_f64.to_le_bytes().repeat(count);
    let time = field(1, &[8, 12, 16, 89]);
    let vector = [double(1, 1.0), double(2, -0.5), double(3, 0.25)].concat();
    let rotation = double(4, 1.0);
    let pose = [field(1, &vector), field(2, &rotation)].concat();
    let transform =
        [time.clone(), field(2, b"base_link"), field(3, b"camera_link"), field(4, &vector), field(5, &rotation)]
            .concat();
    // 36 doubles are longer than one byte of length can say.
    let covariance = |number: u8| [&[number << 3 | 2, 0xa0, 2][..], &doubles(36)].concat();
    let size = [fixed32(2, 2), fixed32(3, 1)].concat();
    let messages = [
        [time.clone(), field(2, b"\xff\xd8"), field(3, b"jpeg"), field(4, b"eye")].concat(),
        [time.clone(), size.clone(), field(4, b"rgb8"), fixed32(5, 6), field(6, b"pixels"), field(7, b"eye")].concat(),
        [time.clone(), size, field(4, b"equidistant"), field(5, &doubles(4)), field(6, &doubles(9)), field(9, b"eye")]
            .concat(),
        transform.clone(),
        field(1, &transform),
        [time.clone(), field(2, b"map"), field(3, &pose)].concat(),
        [time.clone(), field(2, b"odom"), field(3, b"base"), field(4, &pose), field(5, &vector), covariance(7)]
            .concat(),
        [time, field(2, &[field(1, b"head_pan"), double(2, 0.5)].concat())].concat(),
    ];
    for ((which, kind), message) in FoxgloveType::ALL.iter().enumerate().zip(messages) {
        let name = kind.name().trim_start_matches("foxglove.");
        assert!(kind.to_ros2(message.clone()).is_ok(), "{name}");
        keep("foxglove", &format!("sound-{name}"), [&[which as u8][..], &message].concat());
    }
}

fn mavlink_stream(read: u8) -> Vec<u8> {
    let q = [1.0, 0.0, 0.0, 0.0];
    let odometry = ODOMETRY_DATA {
        time_usec: 1_020_000,
        frame_id: MavFrame::MAV_FRAME_LOCAL_FRD,
        child_frame_id: MavFrame::MAV_FRAME_BODY_FRD,
        q,
        ..ODOMETRY_DATA::DEFAULT
    };
    let messages = [
        MavMessage::HEARTBEAT(HEARTBEAT_DATA::DEFAULT),
        MavMessage::TIMESYNC(TIMESYNC_DATA { tc1: 5_000_000_000, ts1: 4_000_000_000, ..TIMESYNC_DATA::DEFAULT }),
        MavMessage::HIGHRES_IMU(HIGHRES_IMU_DATA {
            time_usec: 1_000_000,
            zacc: -9.81,
            fields_updated: HighresImuUpdatedFlags::from_bits_truncate(63),
            ..HIGHRES_IMU_DATA::DEFAULT
        }),
        MavMessage::ATTITUDE_QUATERNION(ATTITUDE_QUATERNION_DATA {
            time_boot_ms: 1_010,
            q1: 1.0,
            ..ATTITUDE_QUATERNION_DATA::DEFAULT
        }),
        MavMessage::ODOMETRY(odometry.clone()),
        MavMessage::ODOMETRY(ODOMETRY_DATA { time_usec: 1_040_000, x: 7.0, reset_counter: 1, ..odometry }),
    ];
    let mut stream = vec![read];
    for (sequence, message) in messages.iter().enumerate() {
        let header = MavHeader { system_id: 1, component_id: 1, sequence: sequence as u8 };
        let mut raw = MAVLinkV2MessageRaw::new();
        raw.serialize_message(header, message);
        stream.extend_from_slice(raw.raw_bytes());
    }
    stream
}

/// Without its header, which the fuzzer's entry makes.
fn checkpoints() {
    let body = |checkpoint: &Checkpoint| checkpoint.encode().unwrap()[16..].to_vec();
    let empty = Checkpoint {
        tagger: Default::default(),
        synchroniser: Default::default(),
        dead_reckoning: Default::default(),
        frames: 0,
    };
    keep("checkpoint", "sound-empty", body(&empty));
    for (name, particles) in [("one-particle", 1), ("twenty-particles", 20)] {
        let mut settings = Settings::default();
        settings.filter.particles = particles;
        let field = Field::new(load_field("kid-2009").unwrap()).unwrap();
        let mut tagger = Tagger::new(&settings, field, &load_lens("fisheye-640").unwrap().lens, Default::default());
        tagger.start_at(&InitialPose { map_from_footprint: Pose2::new(1.0, 0.5, 2.0), xy_m: None, yaw_rad: None });
        let whole = Checkpoint { tagger: tagger.state(), frames: 7, ..empty.clone() };
        keep("checkpoint", &format!("sound-{name}"), body(&whole));
    }
}

fn indices() {
    let folder = tempfile::tempdir().unwrap();
    for count in [0, 3, 60] {
        let pose = |i: i32| {
            let euler = Euler { yaw: f64::from(i) * 0.3, pitch: 0.2, roll: 0.0 };
            Isometry::from_euler(euler, glam::DVec3::new(f64::from(i % 8) * 0.4, f64::from(i / 8) * 0.3, 0.5))
        };
        let path = folder.path().join("index");
        write_index(&path, (0..count).map(|i| Record::at(&pose(i))).collect()).unwrap();
        keep("index", &format!("sound-{count}-images"), fs::read(&path).unwrap());
    }
}

fn descriptions() {
    let field = load_field("kid-2009").unwrap();
    let lens = load_lens("fisheye-640").unwrap().lens.parameters().clone();
    let info = SessionInfo {
        format: 1,
        id: Some("0123456789abcdef0123456789abcdef".to_owned()),
        software: "realitysim 0.1.0".to_owned(),
        robot: "a".to_owned(),
        started: "2026-01-01T00:00:00Z".to_owned(),
        source: None,
        settings: Settings::default(),
        field: field.clone(),
        lens: lens.clone(),
        body_masks: Vec::new(),
        live: None,
    };
    keep("capture", "sound-session", serde_json::to_vec(&info).unwrap());
    let line = ManifestLine {
        name: "0000.mcap".to_owned(),
        bytes: 5,
        blake3: String::new(),
        first_ns: 0,
        last_ns: 1,
        messages: 7,
        frames: Counts::default(),
        poses: Some(PoseBox::around(None, 1.0, 2.0)),
        cut_bytes: None,
    };
    let line = serde_json::to_string(&line).unwrap();
    keep("capture", "sound-manifest", format!("{line}\n{line}\n"));
    let mut contents = Contents::new(field);
    contents.index = 1;
    contents.sources.push(Source {
        kind: SourceKind::Folder,
        path: "nowhere".into(),
        lens,
        files: vec!["a.jpg".into()],
        body_masks: Vec::new(),
        dark: None,
        darkening: None,
        moved: None,
        hall: realitysim::views::Hall::default(),
        images: 1,
        left_out: 0,
        limits: TagLimits::default(),
        goals: true,
    });
    keep("capture", "sound-database", serde_json::to_vec(&contents).unwrap());
}
