//! Everything that reads bytes from outside, as functions of these bytes alone: what the fuzzer calls (`./dev fuzz`), and
//! what `cargo test` calls with every input that is kept in tests/data/fuzz. A fault is a panic.
//!
//! A checksum would keep the fuzzer outside: where a format has one, it is made right here.

use std::fs;
use std::io::Cursor;
use std::path::Path;
use std::sync::Arc;

use glam::{DVec2, DVec3};
use mavlink::Message as _;
use mavlink::dialects::common::MavMessage;
use realitysim::config::lenses::LensWanted;
use realitysim::config::{Settings, Topics, field_names, load_field, parse_field, parse_lens};
use realitysim::database::{ImageDatabase, Index, Metric, write_index};
use realitysim::devices::serial::Line;
use realitysim::evaluation::reference::Reference;
use realitysim::evaluation::suite::Suite;
use realitysim::geometry::{Euler, Field, Isometry, Lens, LensModel, LensParameters};
use realitysim::localization::Rejection;
use realitysim::log_input::foxglove::FoxgloveType;
use realitysim::log_input::synchroniser::Synchroniser;
use realitysim::log_input::tables::messages::{WalkMessages, WalkTables};
use realitysim::log_input::tables::{AngleUnit, Table, imu, joints, odometry, pictures, transforms};
use realitysim::log_input::{decode, measurement};
use realitysim::recording::{missing_parts, read_info};
use realitysim::ros2::messages::{
    CameraInfo, CompressedImage, DiagnosticArray, FrameTag, Image, ImageView, Imu, JointState, LowState, Odometer,
    Odometry, PoseStamped, PoseWithCovarianceStamped, TFMessage, TwistStamped, TwistWithCovarianceStamped, schema,
};
use realitysim::ros2::{Channel, LogMessage, LogReader, Message, Selection, attachments, examine, survey};
use realitysim::scene::{Renderer, Scene, SceneFile};
use realitysim::tagging::{Checkpoint, Tagger};

pub type Target = (&'static str, fn(&[u8]));

pub const TARGETS: [Target; 15] = [
    ("mcap", mcap),
    ("cdr", cdr),
    ("schema", schema),
    ("image", image),
    ("foxglove", foxglove),
    ("mavlink", mavlink),
    ("lens", lens),
    ("field", field),
    ("settings", settings),
    ("scene", scene),
    ("gate", gate),
    ("checkpoint", checkpoint),
    ("index", index),
    ("capture", capture),
    ("table", table),
];

/// A log of any origin.
pub fn mcap(bytes: &[u8]) {
    let topics = Topics::default();
    for selection in [Selection::All, Selection::topics([topics.image.clone(), topics.imu.clone()])] {
        let Ok(mut log) = LogReader::open(Cursor::new(bytes), selection) else { continue };
        // Many index entries may lead to the same chunk.
        for message in log.by_ref().take(2000).map_while(Result::ok) {
            let _ = measurement::read(&message, &topics, &Settings::default().head);
            assert!(message.data.len() as u64 <= realitysim::ros2::cdr::MAX_MESSAGE_BYTES as u64);
        }
        let _ = log.damage();
    }
    let _ = (survey(Cursor::new(bytes)), examine(Cursor::new(bytes)), attachments(Cursor::new(bytes)));
}

/// One message: the first byte says of which type.
pub fn cdr(bytes: &[u8]) {
    let Some((which, data)) = bytes.split_first() else { return };
    let topics = Topics::default();
    match which % 15 {
        0 => message::<CompressedImage>(data, &topics.image),
        1 => message::<Image>(data, &topics.image),
        2 => message::<CameraInfo>(data, &topics.camera_info),
        3 => message::<Imu>(data, &topics.imu),
        4 => message::<JointState>(data, &topics.joints),
        5 => message::<Odometry>(data, &topics.odometry),
        6 => message::<TFMessage>(data, &topics.tf),
        7 => message::<PoseWithCovarianceStamped>(data, &topics.initial_pose),
        8 => message::<PoseStamped>(data, &topics.ground_truth),
        9 => message::<DiagnosticArray>(data, "/diagnostics"),
        10 => message::<FrameTag>(data, "/frame_tag"),
        11 => message::<TwistStamped>(data, &topics.odometry),
        12 => message::<TwistWithCovarianceStamped>(data, &topics.odometry),
        13 => message::<Odometer>(data, &topics.odometry),
        _ => message::<LowState>(data, &topics.imu),
    }
}

/// The definition of a type, as a log states it: the first byte says of which type.
pub fn schema(bytes: &[u8]) {
    let Some((which, definition)) = bytes.split_first() else { return };
    let types = [LowState::TYPE, Odometry::TYPE, TFMessage::TYPE];
    let _ = schema::difference(types[usize::from(*which) % types.len()], definition);
}

fn message<M: Message>(data: &[u8], topic: &str) {
    if let Ok(message) = M::decode(data) {
        // Compared as bytes: a NaN is no fault, and not equal to itself.
        let written = message.encode();
        let again = M::decode(&written).unwrap_or_else(|error| panic!("what was written cannot be read: {error}"));
        assert_eq!(again.encode(), written);
    }
    let settings = Settings::default();
    let channel = Arc::new(Channel::of::<M>(1, topic, Default::default()));
    let message = LogMessage { channel, sequence: 0, log_time_ns: 1, publish_time_ns: 1, data: data.to_vec() };
    let mut synchroniser = Synchroniser::new(settings.frames.clone(), Default::default());
    if let Ok(input) = measurement::read(&message, &settings.topics, &settings.head) {
        synchroniser.push(&message, input);
    }
    synchroniser.finish();
    while let Some(frame) = synchroniser.pop() {
        let _ = decode::picture(&frame.message);
    }
}

/// A message of Foxglove's schemas: the first byte says of which type.
pub fn foxglove(bytes: &[u8]) {
    let Some((which, data)) = bytes.split_first() else { return };
    let kind = FoxgloveType::ALL[usize::from(*which) % FoxgloveType::ALL.len()];
    let Ok(cdr) = kind.to_ros2(data.to_vec()) else { return };
    let whole = match kind {
        FoxgloveType::CompressedImage => CompressedImage::decode(&cdr).is_ok(),
        FoxgloveType::RawImage => Image::decode(&cdr).is_ok(),
        FoxgloveType::CameraCalibration => CameraInfo::decode(&cdr).is_ok(),
        FoxgloveType::FrameTransform | FoxgloveType::FrameTransforms => TFMessage::decode(&cdr).is_ok(),
        FoxgloveType::PoseInFrame => PoseStamped::decode(&cdr).is_ok(),
        FoxgloveType::Odometry => Odometry::decode(&cdr).is_ok(),
        FoxgloveType::JointStates => JointState::decode(&cdr).is_ok(),
    };
    assert!(whole, "{kind:?} is not read as {}", kind.ros2_name());
}

/// JPEG or PNG, and the pixels of a message that no codec has touched.
pub fn image(bytes: &[u8]) {
    let is_small = |bytes: &[u8]| size_within(bytes, 512);
    if is_small(bytes)
        && let Ok(picture) = decode::compressed(bytes)
    {
        assert_eq!(picture.luma.len(), picture.width * picture.height);
    }
    let Some(([which, width, height, step], data)) = bytes.split_first_chunk::<4>() else { return };
    let encodings: Vec<&str> = decode::encodings().chain(["16UC3"]).collect();
    let view = ImageView {
        header: Default::default(),
        height: u32::from(*height),
        width: u32::from(*width),
        encoding: encodings[usize::from(*which) % encodings.len()],
        is_bigendian: which / 128,
        step: u32::from(*step),
        data,
    };
    if let Ok(picture) = decode::raw(&view) {
        assert_eq!(picture.luma.len(), picture.width * picture.height);
    }
}

/// Large images are as legal as small ones, and only slow.
fn size_within(bytes: &[u8], most: usize) -> bool {
    let format = if bytes.starts_with(b"\x89PNG") { image::ImageFormat::Png } else { image::ImageFormat::Jpeg };
    let size = image::ImageReader::with_format(Cursor::new(bytes), format).into_dimensions();
    size.is_ok_and(|(width, height)| (width as usize).max(height as usize) <= most)
}

/// What comes over a serial line, in reads of any size; the first byte says of which.
pub fn mavlink(bytes: &[u8]) {
    let Some((size, stream)) = bytes.split_first() else { return };
    read_in_parts(usize::from(*size), stream);
    read_in_parts(usize::from(*size), &with_right_checksums(stream.to_vec()));
}

fn with_right_checksums(mut stream: Vec<u8>) -> Vec<u8> {
    let mut at = 0;
    while let Some(start) = stream[at..].iter().position(|byte| *byte == 0xFD) {
        at += start;
        let Some(&[_, length, .., low, middle, high]) = stream[at..].first_chunk::<10>() else { break };
        let end = at + 10 + usize::from(length);
        if end + 2 > stream.len() {
            break;
        }
        let extra = MavMessage::extra_crc(u32::from_le_bytes([low, middle, high, 0]));
        let checksum = mavlink::calculate_crc(&stream[at + 1..end], extra).to_le_bytes();
        stream[end..end + 2].copy_from_slice(&checksum);
        at = end + 2;
    }
    stream
}

fn read_in_parts(size: usize, stream: &[u8]) {
    let mut lines = [Line::new(1, 0), Line::new(1, 86_806)];
    let sizes = [stream.len().max(1), size.max(1)];
    for (line, size) in lines.iter_mut().zip(sizes) {
        let mut host_ns = (size as i64 + 1) << 33;
        for read in stream.chunks(size) {
            line.push(read, host_ns, |measured| assert!(measured.stamp_ns <= host_ns));
            let _ = line.due(host_ns);
            host_ns += 10_000_000;
        }
    }
    let [whole, parts] = lines.map(|line| line.status().counts);
    assert_eq!(whole, parts, "the size of reads matters");
}

/// A lens: ROS, Kalibr, VisualMesh or this project's own.
pub fn lens(bytes: &[u8]) {
    let Ok(text) = str::from_utf8(bytes) else { return };
    for image_size in [None, Some([640, 480])] {
        let Ok(file) = parse_lens(text, "file", LensWanted { camera: None, image_size }) else { continue };
        let lens = &file.lens;
        let far = DVec2::new(f64::from(lens.width()), f64::from(lens.height()));
        for pixel in [DVec2::ZERO, 0.5 * far, far, DVec2::new(0.3, 0.9) * far] {
            let Some(ray) = lens.unproject(pixel) else { continue };
            assert!(ray.is_finite() && (ray.length() - 1.0).abs() < 1e-9, "{pixel} is seen along {ray}");
            assert!(lens.project(ray).is_none_or(DVec2::is_finite));
        }
    }
}

/// A field's sizes.
pub fn field(bytes: &[u8]) {
    let Ok(text) = str::from_utf8(bytes) else { return };
    let Ok(dimensions) = parse_field(text, "file") else { return };
    let Ok(field) = Field::new(dimensions) else { return };
    assert!(field.points(200).iter().all(|point| point.position.is_finite()));
    assert!(field.distance_to_centre_line(DVec2::new(0.3, -7.0)).is_finite());
}

/// A robot's config.
pub fn settings(bytes: &[u8]) {
    let Ok(text) = str::from_utf8(bytes) else { return };
    if let Ok(settings) = Settings::parse(text, "file") {
        settings.check().unwrap_or_else(|error| panic!("taken, and then not: {error}"));
    }
}

/// A scene, with its events and a picture of a small lens.
pub fn scene(bytes: &[u8]) {
    let Ok(text) = str::from_utf8(bytes) else { return };
    let Ok(file) = SceneFile::from_toml(text) else { return };
    // Any other name would be a file's.
    let name = if field_names().contains(&file.scene.field) { &file.scene.field } else { "kid-2009" };
    let field = load_field(name).expect("a shipped field");
    let Ok(scene) = Scene::build(file, field, small_lens()) else { return };
    for event in scene.events().take(300) {
        let pose = scene.truth(event.stamp_ns as f64 * 1e-9 - 1_760_000_000.0).map_from_camera_link;
        assert!(pose.translation.is_finite() && pose.rotation.is_finite());
    }
    assert!(scene.drawn().iter().chain(&scene.drawn_for(7)).all(|drawn| drawn.value.is_finite()));
    let mut pixels = Vec::new();
    Renderer::new(&scene).render(scene.frame_count() / 2, &mut pixels);
    assert_eq!(pixels.len(), 3 * 16 * 12);
}

fn small_lens() -> LensParameters {
    let model = LensModel::KannalaBrandt { k: [0.0; 4] };
    LensParameters { width: 16, height: 12, fx: 5.0, fy: 5.0, cx: 8.0, cy: 6.0, model, fov_deg: Some(180.0) }
}

/// What a gate in continuous integration reads: a suite, or a reference.
pub fn gate(bytes: &[u8]) {
    let Ok(text) = str::from_utf8(bytes) else { return };
    let _ = Suite::parse(text, Path::new("folder/suite.toml"));
    if let Ok(reference) = Reference::parse(text, "file") {
        let again = Reference::parse(&reference.to_text(), "file");
        assert!(again.is_ok_and(|again| again.to_text() == reference.to_text()));
    }
}

/// The agent's state as it stands in a recording, and a frame from there on.
pub fn checkpoint(bytes: &[u8]) {
    let _ = Checkpoint::decode(bytes);
    let mut whole = b"RSIMCKPT".to_vec();
    whole.extend(realitysim::tagging::checkpoint::VERSION.to_le_bytes());
    whole.extend(crc32fast::hash(bytes).to_le_bytes());
    whole.extend(bytes);
    let Ok(checkpoint) = Checkpoint::decode(&whole) else { return };
    assert!(checkpoint.encode().is_ok());
    let settings = Settings::default();
    let field = Field::new(load_field("kid-2009").expect("shipped")).expect("a field");
    let lens = Lens::new(small_lens()).expect("a lens");
    let mut tagger = Tagger::new(&settings, field, &lens, checkpoint.tagger);
    let mut synchroniser = Synchroniser::new(settings.frames.clone(), checkpoint.synchroniser);
    let input = measurement::Measurement::Frame { stamp_ns: 2_000_000_000, frame_id: "camera".to_owned() };
    let channel = Arc::new(Channel::of::<CompressedImage>(1, &settings.topics.image, Default::default()));
    let message = LogMessage { channel, sequence: 0, log_time_ns: 1, publish_time_ns: 1, data: Vec::new() };
    synchroniser.push(&message, input);
    synchroniser.finish();
    while let Some(frame) = synchroniser.pop() {
        let tag = tagger.tag_blind(frame.stamp_ns, &frame.robot, Rejection::FewLines);
        assert!(!tag.valid);
    }
}

/// The image database's index.
pub fn index(bytes: &[u8]) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("index-000001.bin");
    // With the right checksum, behind which nothing but it would ever be tried.
    let mut bytes = bytes.to_vec();
    if bytes.len() > 24 {
        let checksum = crc32fast::hash(&bytes[24..]);
        bytes[12..16].copy_from_slice(&checksum.to_le_bytes());
    }
    fs::write(&path, bytes).expect("written");
    let Ok(index) = Index::open(&path) else { return };
    let metric = Metric::default();
    let pose = Isometry::from_euler(Euler { yaw: 0.4, pitch: 0.3, roll: 0.1 }, DVec3::new(1.0, -0.5, 0.5));
    for neighbour in index.nearest(&pose, 8, &metric) {
        let _ = (index.record(neighbour.number).pose(), index.record(neighbour.number).tag());
    }
    let _ = index.records().count();
}

/// What describes a capture or a database in words: `session.json`, `manifest.jsonl`, `database.json`.
pub fn capture(bytes: &[u8]) {
    let folder = tempfile::tempdir().expect("a folder");
    for name in ["session.json", "manifest.jsonl", "database.json"] {
        fs::write(folder.path().join(name), bytes).expect("written");
    }
    write_index(&folder.path().join("index-000001.bin"), Vec::new()).expect("written");
    let _ = (read_info(folder.path()), missing_parts(folder.path()));
    let _ = ImageDatabase::open(folder.path(), &Settings::default().views);
}

/// A table of measurements, read as each kind, and the messages that are made of it.
pub fn table(bytes: &[u8]) {
    let Ok(text) = str::from_utf8(bytes) else { return };
    let Ok(table) = Table::parse(text, "file") else { return };
    for angles in [None, Some(AngleUnit::Degrees)] {
        let mut tables = WalkTables::default();
        if let Ok(measured) = imu::read(&mut table.clone(), angles) {
            tables.imu = measured.rows;
        }
        if let Ok(measured) = odometry::read(&mut table.clone(), angles) {
            tables.odometry = measured.rows;
        }
        if let Ok(measured) = joints::read(&mut table.clone(), angles) {
            tables.joints = measured.rows;
        }
        if let Ok(measured) = transforms::read(&mut table.clone(), angles) {
            tables.transforms = measured.rows;
        }
        let settings = Settings::default();
        let mut messages = WalkMessages::new(&tables);
        let constants = messages.constants(1, &small_lens());
        for message in constants.into_iter().chain(std::iter::from_fn(|| messages.next_until(i64::MAX))) {
            let read = measurement::read(&message, &settings.topics, &settings.head).expect("what was written is read");
            assert_ne!(read, measurement::Measurement::Impossible);
        }
        let _ = pictures::read_known(&mut table.clone(), angles);
    }
    let _ = (pictures::read(&mut table.clone()), pictures::read_frames(&mut table.clone()));
    let names: Vec<String> = text.lines().take(100).map(str::to_owned).collect();
    let _ = pictures::by_names(&names);
    let stamped = pictures::by_rate(&names, 0, 30.0);
    assert!(stamped.windows(2).all(|pair| pair[0].stamp_ns < pair[1].stamp_ns));
}
