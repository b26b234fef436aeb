//! Renders a scene in place of the hardware: its events become the messages that a robot would have logged.

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

/// Why a scene cannot be read or rendered.
#[derive(Debug, Error)]
pub enum SceneSourceError {
    /// The scene is not valid.
    #[error("{path}: {source}")]
    Scene {
        /// Name of the scene file.
        path: String,
        /// What is wrong with it.
        source: SceneError,
    },
    /// The scene file cannot be read.
    #[error("{path}: {}", unreadable(source))]
    Open {
        /// Name of the scene file.
        path: String,
        /// What the operating system says.
        source: std::io::Error,
    },
    /// The field or lens that the scene names cannot be loaded.
    #[error("{place}: {source}")]
    Config {
        /// The scene file, and the line if it is known.
        place: String,
        /// What is wrong with the field or lens.
        source: realitysim_config::ConfigError,
    },
    /// A rendered image cannot be encoded.
    #[error(transparent)]
    Encode(#[from] EncodeError),
}

/// Says why a scene file cannot be read, in words for the person who named it.
fn unreadable(error: &std::io::Error) -> String {
    match error.kind() {
        ErrorKind::IsADirectory => "it is a folder, and a scene is a file (replay/scenes has some)".to_owned(),
        ErrorKind::InvalidData => "it is not UTF-8 text: is it a scene file?".to_owned(),
        _ => error.to_string(),
    }
}

/// Largest scene file, bytes. One with hundreds of effects and events takes some ten KiB.
pub const MAX_SCENE_BYTES: u64 = 1 << 20;

/// Loads a scene file with the field and lens that it names.
pub fn load(path: impl AsRef<Path>) -> Result<Scene, SceneSourceError> {
    let path = path.as_ref();
    let name = path.display().to_string();
    match plain_file::read_text(path, MAX_SCENE_BYTES) {
        Ok(text) => parse(&text, &name),
        Err(source) => Err(SceneSourceError::Open { path: name, source }),
    }
}

/// Builds a scene from the text of a scene file. `name` is the file's path: errors show it, and paths in the text start there.
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

/// Iterator over all messages of a scene in the order of time, on the default topics, the ground truth included.
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
    /// Creates a source that begins with the constant messages: transforms, calibration, and what was drawn for the scene.
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
        source.push_drawn(START_STAMP_NS, DRAWN_FOR_EPISODE, &scene.drawn());
        source
    }

    /// Returns the topics that the log of this scene would have, with their types, without rendering it.
    pub fn topic_types(scene: &Scene) -> TopicTypes {
        let (topics, file) = (Topics::default(), scene.file());
        let mut types = TopicTypes::new();
        let mut add = |topic: &str, kind: &str| types.entry(topic.to_owned()).or_default().insert(kind.to_owned());
        add(&topics.tf_static, TFMessage::TYPE);
        add(&topics.camera_info, CameraInfo::TYPE);
        let image = match file.camera.jpeg_quality {
            Some(_) => (topics.image.as_str(), CompressedImage::TYPE),
            None => (RAW_TOPIC, Image::TYPE),
        };
        let senders = 1 + usize::from(file.odometry.is_some()) + usize::from(file.imu.is_some());
        let mut heard: BTreeSet<&str> = BTreeSet::new();
        // Messages may be lost in the scene, the first ones or all of a sensor, so the events themselves are looked at.
        for event in scene.events() {
            let (topic, kind) = match event.kind {
                SceneEventKind::InitialPose(_) => continue,
                SceneEventKind::Odometry(_) => (topics.odometry.as_str(), Odometry::TYPE),
                SceneEventKind::Imu(_) => (topics.imu.as_str(), Imu::TYPE),
                SceneEventKind::Joints(_) => (topics.joints.as_str(), JointState::TYPE),
                SceneEventKind::Frame { .. } => image,
            };
            add(topic, kind);
            heard.insert(topic);
            if heard.len() == senders + usize::from(scene.has_joints()) {
                break;
            }
        }
        types
    }

    /// Queues the message that says which values were drawn at random; none if the scene leaves nothing open.
    fn push_drawn(&mut self, stamp_ns: i64, what_for: &str, drawn: &[Drawn]) {
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

    /// Makes a message on a topic, whose channel is created at its first message.
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

    /// Queues the messages of one event.
    fn push_event(&mut self, event: SceneEvent) -> Result<(), SceneSourceError> {
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
                self.push_drawn(stamp, "drawn for this frame", &self.scene.drawn_for(index));
                self.frame(index, stamp)?
            }
        };
        if let Some(which) = event.corrupt {
            flip_a_bit(&mut message.data, which);
        }
        self.waiting.push_back(message);
        Ok(())
    }

    /// Renders a frame into its message, compressed or raw, cut short if the scene says that it is torn.
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

/// Coordinate frame of the camera's images.
const OPTICAL: &str = "camera_optical_frame";
/// Marks the message with the values that were drawn for the whole scene, at its start.
const DRAWN_FOR_EPISODE: &str = "drawn for the episode";
/// Topic of images that are not compressed.
const RAW_TOPIC: &str = "/camera/image_raw";

impl Iterator for SceneSource<'_> {
    type Item = Result<LogMessage, SceneSourceError>;

    fn next(&mut self) -> Option<Self::Item> {
        if let Some(message) = self.waiting.pop_front() {
            return Some(Ok(message));
        }
        let event = self.events.next()?;
        match self.push_event(event) {
            Ok(()) => self.waiting.pop_front().map(Ok),
            Err(error) => Some(Err(error)),
        }
    }
}

/// Returns whether a message of [`topics::SCENE_DRAWN`] holds for the whole scene, not for one frame.
pub fn is_drawn_for_episode(message: &LogMessage) -> bool {
    message.channel.topic == topics::SCENE_DRAWN
        && DiagnosticArray::decode(&message.data)
            .is_ok_and(|told| told.status.iter().any(|status| status.message == DRAWN_FOR_EPISODE))
}

/// Flips one bit anywhere behind the four bytes of the encapsulation: in a stamp, a name or a value.
fn flip_a_bit(data: &mut [u8], which: u64) {
    let bits = 8 * data.len().saturating_sub(4) as u64;
    if bits > 0 {
        let bit = which % bits;
        data[4 + (bit / 8) as usize] ^= 1 << (bit % 8);
    }
}

/// Returns the constant transforms of the mount, as the scene announces them.
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

/// Returns the calibration of the lens, as the scene announces it.
fn camera_info(scene: &Scene) -> CameraInfo {
    CameraInfo::of_lens(scene.announced_lens(), Header::at(START_STAMP_NS, OPTICAL))
}
