//! A scene in place of the hardware: its events as the messages that a robot would have logged.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::io::ErrorKind;
use std::path::Path;
use std::sync::Arc;

use jpeg_encoder::ColorType;
use thiserror::Error;

use crate::encode::{EncodeError, jpeg};
use crate::topic_resolution::TopicTypes;
use realitysim_config::{Topics, field_seen_from, lens_seen_from, load_field, load_lens, plain_file};
use realitysim_geometry::Isometry;
use realitysim_ros2::mcap_read::{Channel, LogMessage};
use realitysim_ros2::mcap_write::{Durability, channel_metadata};
use realitysim_ros2::messages::{
    CameraInfo, CompressedImage, DiagnosticArray, DiagnosticStatus, Header, Image, Imu, JointState, KeyValue, Message,
    Odometry, Pose, PoseStamped, PoseWithCovarianceStamped, Quaternion, TFMessage, Transform, TransformStamped,
    Vector3,
};
use realitysim_ros2::topics;
use realitysim_scene::{
    Drawn, Events, Renderer, START_STAMP_NS, Scene, SceneError, SceneEvent, SceneEventKind, SceneFile,
};

#[derive(Debug, Error)]
pub enum SceneSourceError {
    #[error("{path}: {source}")]
    Scene { path: String, source: SceneError },
    #[error("{path}: {}", unreadable(source))]
    Open { path: String, source: std::io::Error },
    /// `place` is the file, and the line if it is known.
    #[error("{place}: {source}")]
    Config { place: String, source: realitysim_config::ConfigError },
    #[error(transparent)]
    Encode(#[from] EncodeError),
}

fn unreadable(error: &std::io::Error) -> String {
    match error.kind() {
        ErrorKind::IsADirectory => "it is a folder, and a scene is a file (replay/scenes has some)".to_owned(),
        ErrorKind::InvalidData => "it is not UTF-8 text: is it a scene file?".to_owned(),
        _ => error.to_string(),
    }
}

/// A scene with hundreds of effects and events takes some ten KiB.
pub const MAX_SCENE_BYTES: u64 = 1 << 20;

/// A scene file with the field and lens that it names.
pub fn load(path: impl AsRef<Path>) -> Result<Scene, SceneSourceError> {
    let path = path.as_ref();
    let name = path.display().to_string();
    match plain_file::read_text(path, MAX_SCENE_BYTES) {
        Ok(text) => parse(&text, &name),
        Err(source) => Err(SceneSourceError::Open { path: name, source }),
    }
}

/// The same from text; `name` is for messages, and where paths in it start.
pub fn parse(text: &str, name: &str) -> Result<Scene, SceneSourceError> {
    let scene = |source| SceneSourceError::Scene { path: name.to_owned(), source };
    let mut file = SceneFile::from_toml(text).map_err(scene)?;
    file.scene.field = field_seen_from(Path::new(name), &file.scene.field);
    file.camera.lens = lens_seen_from(Path::new(name), &file.camera.lens);
    let refused = |key: &str, source| {
        let place = file.line(key).map_or_else(|| name.to_owned(), |line| format!("{name}: line {line}"));
        SceneSourceError::Config { place, source }
    };
    let field = load_field(&file.scene.field).map_err(|source| refused("scene.field", source))?;
    let lens = load_lens(&file.camera.lens).map_err(|source| refused("camera.lens", source))?;
    Scene::build(file, field, lens.lens.parameters().clone()).map_err(scene)
}

/// All messages of a scene in time order, on the default topics; the truth among them.
pub struct SceneSource<'a> {
    scene: &'a Scene,
    renderer: Renderer,
    events: Events<'a>,
    topics: Topics,
    channels: BTreeMap<String, Arc<Channel>>,
    waiting: VecDeque<LogMessage>,
    pixels: Vec<u8>,
}

impl<'a> SceneSource<'a> {
    pub fn new(scene: &'a Scene) -> Self {
        let topics = Topics::default();
        let mut source = Self {
            scene,
            renderer: Renderer::new(scene),
            events: scene.events(),
            topics,
            channels: BTreeMap::new(),
            waiting: VecDeque::new(),
            pixels: Vec::new(),
        };
        let constants = [
            source.message(&source.topics.tf_static.clone(), START_STAMP_NS, &transforms(scene)),
            source.message(&source.topics.camera_info.clone(), START_STAMP_NS, &camera_info(scene)),
        ];
        source.waiting.extend(constants);
        source.tell_drawn(START_STAMP_NS, DRAWN_FOR_EPISODE, &scene.drawn());
        source
    }

    /// What the log of this scene would have on its topics, without rendering it.
    pub fn topic_types(scene: &Scene) -> TopicTypes {
        let (topics, file) = (Topics::default(), scene.file());
        let mut types = TopicTypes::new();
        let mut there = |topic: &str, kind: &str| types.entry(topic.to_owned()).or_default().insert(kind.to_owned());
        there(&topics.tf_static, TFMessage::TYPE);
        there(&topics.camera_info, CameraInfo::TYPE);
        let image = match file.camera.jpeg_quality {
            Some(_) => (topics.image.as_str(), CompressedImage::TYPE),
            None => (RAW_TOPIC, Image::TYPE),
        };
        let senders = 1 + usize::from(file.odometry.is_some()) + usize::from(file.imu.is_some());
        let mut heard: BTreeSet<&str> = BTreeSet::new();
        // What the wires lose may be the first messages, or all.
        for event in scene.events() {
            let (topic, kind) = match event.kind {
                SceneEventKind::InitialPose(_) => continue,
                SceneEventKind::Odometry(_) => (topics.odometry.as_str(), Odometry::TYPE),
                SceneEventKind::Imu(_) => (topics.imu.as_str(), Imu::TYPE),
                SceneEventKind::Joints(_) => (topics.joints.as_str(), JointState::TYPE),
                SceneEventKind::Frame { .. } => image,
            };
            there(topic, kind);
            heard.insert(topic);
            if heard.len() == senders + usize::from(scene.has_joints()) {
                break;
            }
        }
        types
    }

    /// Of a scene that leaves nothing open there is no such message.
    fn tell_drawn(&mut self, stamp_ns: i64, what_for: &str, drawn: &[Drawn]) {
        if drawn.is_empty() {
            return;
        }
        let values = drawn.iter().map(|drawn| KeyValue { key: drawn.name.clone(), value: drawn.value.to_string() });
        let status = DiagnosticStatus {
            name: "realitysim: scene".to_owned(),
            message: what_for.to_owned(),
            values: values.collect(),
            ..Default::default()
        };
        let told = DiagnosticArray { header: Header::at(stamp_ns, ""), status: vec![status] };
        let message = self.message(topics::SCENE_DRAWN, stamp_ns, &told);
        self.waiting.push_back(message);
    }

    fn message<M: Message>(&mut self, topic: &str, stamp_ns: i64, message: &M) -> LogMessage {
        let next_id = self.channels.len() as u16 + 1;
        let constant = topic == self.topics.tf_static || topic == self.topics.camera_info;
        let durability = if constant { Durability::TransientLocal } else { Durability::Volatile };
        let channel = self
            .channels
            .entry(topic.to_owned())
            .or_insert_with(|| Arc::new(Channel::of::<M>(next_id, topic, channel_metadata(durability))));
        let (channel, data) = (Arc::clone(channel), message.encode());
        LogMessage { channel, sequence: 0, log_time_ns: stamp_ns, publish_time_ns: stamp_ns, data }
    }

    fn event(&mut self, event: SceneEvent) -> Result<(), SceneSourceError> {
        let stamp = event.stamp_ns;
        let header = |frame: &str| Header::at(stamp, frame);
        let topics = self.topics.clone();
        let mut message = match event.kind {
            SceneEventKind::InitialPose(estimate) => {
                let mut initial = PoseWithCovarianceStamped { header: header("map"), ..Default::default() };
                initial.pose.pose = Pose::from(estimate.map_from_base_footprint.to_isometry());
                for (index, variance) in [(0, 0.01), (7, 0.01), (35, 0.0025)] {
                    initial.pose.covariance[index] = variance;
                }
                self.message(&topics.initial_pose, stamp, &initial)
            }
            SceneEventKind::Odometry(step) => {
                let mut odometry = Odometry { header: header("odom"), ..Default::default() };
                odometry.child_frame_id = "base_footprint".to_owned();
                odometry.pose.pose = Pose::from(step.odom_from_base_footprint.to_isometry());
                odometry.twist.twist.linear = Vector3 { x: step.twist.x, y: step.twist.y, z: 0.0 };
                odometry.twist.twist.angular = Vector3 { x: 0.0, y: 0.0, z: step.twist.yaw };
                self.message(&topics.odometry, stamp, &odometry)
            }
            SceneEventKind::Imu(measured) => {
                let imu = Imu {
                    header: header("base_link"),
                    orientation: Quaternion::from(measured.orientation),
                    angular_velocity: Vector3::from(measured.angular_velocity),
                    linear_acceleration: Vector3::from(measured.linear_acceleration),
                    ..Default::default()
                };
                self.message(&topics.imu, stamp, &imu)
            }
            SceneEventKind::Joints(joints) => {
                let joints = JointState {
                    header: header(""),
                    name: vec!["head_pan".to_owned(), "head_tilt".to_owned()],
                    position: vec![joints.pan, joints.tilt],
                    ..Default::default()
                };
                self.message(&topics.joints, stamp, &joints)
            }
            SceneEventKind::Frame { index, map_from_camera_link } => {
                let truth = PoseStamped { header: header("map"), pose: Pose::from(map_from_camera_link) };
                let truth = self.message(&topics.ground_truth, stamp, &truth);
                self.waiting.push_back(truth);
                self.tell_drawn(stamp, "drawn for this frame", &self.scene.drawn_for(index));
                self.frame(index, stamp)?
            }
        };
        if let Some(which) = event.corrupt {
            flip_a_bit(&mut message.data, which);
        }
        self.waiting.push_back(message);
        Ok(())
    }

    fn frame(&mut self, index: u64, stamp_ns: i64) -> Result<LogMessage, SceneSourceError> {
        let mut pixels = std::mem::take(&mut self.pixels);
        self.renderer.render(index, &mut pixels);
        let (width, height) = (self.renderer.width(), self.renderer.height());
        let header = Header::at(stamp_ns, OPTICAL);
        let message = match self.scene.file().camera.jpeg_quality {
            Some(quality) => {
                let mut data = jpeg(&pixels, width as usize, height as usize, ColorType::Rgb, quality)?;
                if let Some(share) = self.scene.torn(index) {
                    data.truncate((data.len() as f64 * share) as usize);
                }
                let image = CompressedImage { header, format: "jpeg".to_owned(), data };
                self.message(&self.topics.image.clone(), stamp_ns, &image)
            }
            None => {
                let step = 3 * width;
                let encoding = "rgb8".to_owned();
                let mut data = pixels.clone();
                if let Some(share) = self.scene.torn(index) {
                    data.truncate((data.len() as f64 * share) as usize);
                }
                let image = Image { header, height, width, encoding, is_bigendian: 0, step, data };
                self.message(RAW_TOPIC, stamp_ns, &image)
            }
        };
        self.pixels = pixels;
        Ok(message)
    }
}

const OPTICAL: &str = "camera_optical_frame";
/// What the scene left open and was drawn: for the whole scene at its start, for a frame with the frame.
const DRAWN_FOR_EPISODE: &str = "drawn for the episode";
/// Where images go that were not compressed.
const RAW_TOPIC: &str = "/camera/image_raw";

impl Iterator for SceneSource<'_> {
    type Item = Result<LogMessage, SceneSourceError>;

    fn next(&mut self) -> Option<Self::Item> {
        if let Some(message) = self.waiting.pop_front() {
            return Some(Ok(message));
        }
        let event = self.events.next()?;
        match self.event(event) {
            Ok(()) => self.waiting.pop_front().map(Ok),
            Err(error) => Some(Err(error)),
        }
    }
}

/// Whether a message of [`topics::SCENE_DRAWN`] holds for the whole scene.
pub fn is_drawn_for_episode(message: &LogMessage) -> bool {
    message.channel.topic == topics::SCENE_DRAWN
        && DiagnosticArray::decode(&message.data)
            .is_ok_and(|told| told.status.iter().any(|status| status.message == DRAWN_FOR_EPISODE))
}

/// Anywhere behind the encapsulation's four bytes: a stamp, a name, a value.
fn flip_a_bit(data: &mut [u8], which: u64) {
    let bits = 8 * data.len().saturating_sub(4) as u64;
    if bits > 0 {
        let bit = which % bits;
        data[4 + (bit / 8) as usize] ^= 1 << (bit % 8);
    }
}

fn transforms(scene: &Scene) -> TFMessage {
    let mount = scene.announced_mount();
    let step = |parent: &str, child: &str, parent_from_child: &Isometry| TransformStamped {
        header: Header::at(START_STAMP_NS, parent),
        child_frame_id: child.to_owned(),
        transform: Transform::from(*parent_from_child),
    };
    TFMessage {
        transforms: vec![
            step("base_footprint", "base_link", &mount.base_footprint_from_base_link),
            step("base_link", "camera_link", &mount.base_link_from_camera_link),
            step("camera_link", OPTICAL, &mount.camera_link_from_camera_optical_frame),
        ],
    }
}

fn camera_info(scene: &Scene) -> CameraInfo {
    CameraInfo::of_lens(scene.announced_lens(), Header::at(START_STAMP_NS, OPTICAL))
}
