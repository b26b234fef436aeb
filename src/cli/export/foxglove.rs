//! A log for 3D viewers: the images at the tagged camera, the field's lines as markers, and the lines of each tag over its image.

use core::f64::consts::{FRAC_PI_2, TAU};
use std::collections::HashMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use anyhow::Context;
use glam::DVec2;
use serde_json::{Value, json};

use super::super::paths::{cannot_write, write};
use super::frames::{each_frame, image_topic, own_folder};
use super::overlays::session_info;
use crate::evaluation::drawing::projected_lines;
use crate::geometry::field::Stroke;
use crate::geometry::{Field, Isometry, Lens};
use crate::log_input::log::{self, LogSource};
use crate::recording::{Loss, camera_transforms};
use crate::ros2::mcap_read::{Channel, LogMessage, Selection};
use crate::ros2::mcap_write::{ChannelId, Durability, LogWriter};
use crate::ros2::messages::{
    CameraInfo, Color, ColorRGBA, CompressedImage, FrameTag, Header, Image, ImageAnnotations, Marker, MarkerArray,
    Message, Point, Point2, PointsAnnotation, PoseWithCovarianceStamped, TextAnnotation, Vector3,
};
use crate::ros2::topics;

/// Topic of the field's lines as markers.
const FIELD_LINES: &str = "/field/lines";
/// Topic of the lines over the images.
const IMAGE_LINES: &str = "/camera/lines";
/// Topic of the lens as the exported images have it.
const CAMERA_INFO: &str = "/camera/tagged_info";
/// Pieces of a circle: each of them is off by less than a thousandth of the radius.
const PIECES: u32 = 72;
const VALID: Color = Color { r: 0.9, g: 0.12, b: 0.24, a: 0.9 };
const INVALID: Color = Color { r: 1.0, g: 0.67, b: 0.0, a: 0.9 };
const NO_COLOR: Color = Color { r: 0.0, g: 0.0, b: 0.0, a: 0.0 };
/// Size of the words over an image, pixels.
const FONT_PX: f64 = 16.0;

/// Writes `walk.mcap` and `layout.json` into a folder. Returns the number of frames, and what was lost.
pub(super) fn foxglove(capture: &Path, tags: &[FrameTag], folder: &Path) -> anyhow::Result<(usize, Vec<Loss>)> {
    let info = session_info(capture)?;
    let (lens, field) = (Lens::new(info.lens)?, Field::new(info.field)?);
    let topic = image_topic(capture)?;
    own_folder(folder)?;
    let path = folder.join("walk.mcap");
    let file = BufWriter::new(File::create(&path).map_err(|error| cannot_write(&path, error))?);
    let mut log = ViewerLog { log: LogWriter::new(file)?, channels: HashMap::new() };
    let map = &info.settings.frames.map;
    log.pass_other_messages(capture, &topic, tags, &field, map)?;
    let done = each_frame(capture, tags, &mut |tag, message| {
        let Some(image) = at_tagged_camera(message) else {
            return Ok(Err("it is no image message".to_owned()));
        };
        let (time, header) = (message.log_time_ns, &tag.header);
        let optical = Header { frame_id: topics::TAGGED_OPTICAL.to_owned(), ..header.clone() };
        log.raw(&message.channel, time, &image)?;
        log.put(CAMERA_INFO, time, &CameraInfo::of_lens(lens.parameters(), optical))?;
        log.put(IMAGE_LINES, time, &annotations(tag, &lens, &field))?;
        if tag.valid {
            let header = Header { frame_id: map.clone(), ..header.clone() };
            log.put(topics::CAMERA_TF, time, &camera_transforms(&header, tag))?;
            log.put(topics::POSE, time, &PoseWithCovarianceStamped { header, pose: tag.pose })?;
        }
        log.put(topics::FRAME_TAG, time, tag)?;
        Ok(Ok(()))
    });
    log.log.finish().with_context(|| path.display().to_string())?;
    write(&folder.join("layout.json"), &format!("{:#}\n", layout(&topic, map)))?;
    done
}

/// A log that is written for a viewer.
struct ViewerLog {
    log: LogWriter<BufWriter<File>>,
    channels: HashMap<String, ChannelId>,
}

impl ViewerLog {
    /// Writes the field, and what the capture holds beside images, tags and poses.
    fn pass_other_messages(
        &mut self,
        capture: &Path,
        image_topic: &str,
        tags: &[FrameTag],
        field: &Field,
        map: &str,
    ) -> anyhow::Result<()> {
        let mut is_first = true;
        for message in LogSource::new(log::files_of(capture)?, Selection::All) {
            let message = message?;
            if std::mem::take(&mut is_first) {
                let stamp = tags.first().map_or_else(Default::default, |tag| tag.header.stamp);
                let markers = field_markers(field, Header { stamp, frame_id: map.to_owned() });
                self.put(FIELD_LINES, message.log_time_ns, &markers)?;
            }
            if message.channel.topic != image_topic {
                self.raw(&message.channel, message.log_time_ns, &message.data)?;
            }
        }
        Ok(())
    }

    fn put<M: Message>(&mut self, topic: &str, time_ns: i64, message: &M) -> anyhow::Result<()> {
        let id = match self.channels.get(topic) {
            Some(id) => *id,
            None => self.log.add_channel::<M>(topic, Durability::Volatile)?,
        };
        self.channels.insert(topic.to_owned(), id);
        Ok(self.log.write(id, 0, time_ns, time_ns, &message.encode())?)
    }

    fn raw(&mut self, channel: &Channel, time_ns: i64, data: &[u8]) -> anyhow::Result<()> {
        let id = match self.channels.get(&channel.topic) {
            Some(id) => *id,
            None => self.log.add_raw_channel(&channel.into())?,
        };
        self.channels.insert(channel.topic.clone(), id);
        Ok(self.log.write(id, 0, time_ns, time_ns, data)?)
    }
}

/// The message of an image, with the tagged camera as its coordinate frame; `None` for other types.
fn at_tagged_camera(message: &LogMessage) -> Option<Vec<u8>> {
    let frame_id = topics::TAGGED_OPTICAL.to_owned();
    match message.channel.type_name.as_str() {
        CompressedImage::TYPE => {
            let mut image = CompressedImage::decode(&message.data).ok()?;
            image.header.frame_id = frame_id;
            Some(image.encode())
        }
        Image::TYPE => {
            let mut image = Image::decode(&message.data).ok()?;
            image.header.frame_id = frame_id;
            Some(image.encode())
        }
        _ => None,
    }
}

/// The lines of a tag over its image, orange if it is invalid, and then why.
fn annotations(tag: &FrameTag, lens: &Lens, field: &Field) -> ImageAnnotations {
    let timestamp = tag.header.stamp;
    let color = if tag.valid { VALID } else { INVALID };
    let point = |at: DVec2| Point2 { x: at.x, y: at.y };
    let strip = |line: Vec<DVec2>| PointsAnnotation {
        timestamp,
        kind: PointsAnnotation::LINE_STRIP,
        points: line.into_iter().map(point).collect(),
        outline_color: color,
        thickness: 1.0,
        ..PointsAnnotation::default()
    };
    let words = TextAnnotation {
        timestamp,
        position: Point2 { x: 4.0, y: FONT_PX + 4.0 },
        text: if tag.valid { format!("sigma {:.1} cm", 100.0 * tag.pose.sigma_xy_m()) } else { tag.reason.clone() },
        font_size: FONT_PX,
        text_color: color,
        background_color: NO_COLOR,
    };
    let points = projected_lines(lens, &Isometry::from(tag.pose.pose), field).into_iter().map(strip).collect();
    ImageAnnotations { circles: Vec::new(), points, texts: vec![words] }
}

/// The painted lines of the field as one marker: a list of lines as wide as the paint.
fn field_markers(field: &Field, header: Header) -> MarkerArray {
    let point = |at: DVec2| Point { x: at.x, y: at.y, z: 0.0 };
    let lines = field.painted_strokes();
    let points = lines.iter().flat_map(pieces).flatten().map(point).collect();
    let marker = Marker {
        header,
        ns: "field".to_owned(),
        kind: Marker::LINE_LIST,
        scale: Vector3 { x: field.line_width(), ..Vector3::default() },
        color: ColorRGBA { r: 1.0, g: 1.0, b: 1.0, a: 1.0 },
        points,
        ..Marker::default()
    };
    MarkerArray { markers: vec![marker] }
}

/// Straight pieces of a painted line, metres.
fn pieces(stroke: &Stroke) -> Vec<[DVec2; 2]> {
    let round = |centre: DVec2, radius: f64, side: DVec2, turn: f64| {
        let at = |piece: u32| {
            let angle = turn * f64::from(piece) / f64::from(PIECES);
            centre + radius * side * DVec2::new(libm::cos(angle), libm::sin(angle))
        };
        (0..PIECES).map(|piece| [at(piece), at(piece + 1)]).collect()
    };
    match *stroke {
        Stroke::Segment { from, to } => vec![[from, to]],
        Stroke::Circle { centre, radius } => round(centre, radius, DVec2::ONE, TAU),
        Stroke::Quarter { centre, radius, side } => round(centre, radius, side, FRAC_PI_2),
    }
}

/// A layout of Foxglove and Lichtblick: the field in 3D, beside it the image with its lines, below them what tags say.
fn layout(image_topic: &str, map: &str) -> Value {
    json!({
        "configById": {
            "3D!field": {
                "followTf": map, "followMode": "follow-none", "scene": { "backgroundColor": "#31543b" },
                "cameraState": { "distance": 12, "perspective": true, "phi": 40, "thetaOffset": 0, "fovy": 45,
                    "target": [0, 0, 0], "targetOffset": [0, 0, 0], "targetOrientation": [0, 0, 0, 1], "near": 0.1, "far": 500 },
                "transforms": {}, "layers": {}, "publish": {},
                "topics": {
                    FIELD_LINES: { "visible": true }, topics::POSE: { "visible": true },
                    CAMERA_INFO: { "visible": true }, image_topic: { "visible": true },
                },
            },
            "Image!lines": {
                "imageMode": { "imageTopic": image_topic, "calibrationTopic": CAMERA_INFO,
                    "annotations": { IMAGE_LINES: { "visible": true } } },
            },
            "Plot!tags": {
                "title": "sigma and residual of the tags", "isSynced": true, "showLegend": true, "xAxisVal": "timestamp",
                "paths": [
                    { "value": format!("{}.spread_m", topics::FRAME_TAG), "enabled": true, "timestampMethod": "headerStamp" },
                    { "value": format!("{}.lines_rms_px", topics::FRAME_TAG), "enabled": true, "timestampMethod": "headerStamp" },
                ],
            },
            "StateTransitions!valid": {
                "isSynced": true,
                "paths": [
                    { "value": format!("{}.valid", topics::FRAME_TAG), "timestampMethod": "headerStamp" },
                    { "value": format!("{}.reason", topics::FRAME_TAG), "timestampMethod": "headerStamp" },
                ],
            },
        },
        "globalVariables": {}, "userNodes": {}, "playbackConfig": { "speed": 1 },
        "layout": {
            "direction": "column", "splitPercentage": 68,
            "first": { "direction": "row", "first": "3D!field", "second": "Image!lines" },
            "second": { "direction": "row", "first": "Plot!tags", "second": "StateTransitions!valid" },
        },
    })
}
