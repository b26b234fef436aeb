//! A log for 3D viewers: the images at the tagged camera, the field's lines as markers, and the lines of each tag over its image.

use std::collections::HashMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use anyhow::Context;
use serde_json::{Value, json};

use super::super::paths::{cannot_write, write};
use super::frames::{each_frame, image_topic, own_folder};
use super::overlays::session_info;
use crate::geometry::{Field, Lens};
use crate::log_input::log::{self, LogSource};
use crate::recording::Loss;
use crate::ros2::mcap_read::{Channel, LogMessage, Selection};
use crate::ros2::mcap_write::{ChannelId, Durability, LogWriter};
use crate::ros2::messages::{CompressedImage, FrameTag, Header, Image, Message};
use crate::ros2::topics;
use crate::viewer_messages::{
    CAMERA_INFO, FIELD_LINES, IMAGE_LINES, MessageSink, at_tagged_camera, field_markers, put_tag,
};

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
        let Some(image) = image_at_tagged_camera(message) else {
            return Ok(Err("it is no image message".to_owned()));
        };
        log.raw(&message.channel, message.log_time_ns, &image)?;
        put_tag(&mut log, message.log_time_ns, tag, &lens, &field)?;
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

    fn raw(&mut self, channel: &Channel, time_ns: i64, data: &[u8]) -> anyhow::Result<()> {
        let id = match self.channels.get(&channel.topic) {
            Some(id) => *id,
            None => self.log.add_raw_channel(&channel.into())?,
        };
        self.channels.insert(channel.topic.clone(), id);
        Ok(self.log.write(id, 0, time_ns, time_ns, data)?)
    }
}

impl MessageSink for ViewerLog {
    fn put<M: Message>(&mut self, topic: &str, time_ns: i64, message: &M) -> anyhow::Result<()> {
        let id = match self.channels.get(topic) {
            Some(id) => *id,
            None => self.log.add_channel::<M>(topic, Durability::Volatile)?,
        };
        self.channels.insert(topic.to_owned(), id);
        Ok(self.log.write(id, 0, time_ns, time_ns, &message.encode())?)
    }
}

/// The message of an image, with the tagged camera as its coordinate frame; `None` for other types.
fn image_at_tagged_camera(message: &LogMessage) -> Option<Vec<u8>> {
    match message.channel.type_name.as_str() {
        CompressedImage::TYPE => {
            let mut image = CompressedImage::decode(&message.data).ok()?;
            image.header = at_tagged_camera(&image.header);
            Some(image.encode())
        }
        Image::TYPE => {
            let mut image = Image::decode(&message.data).ok()?;
            image.header = at_tagged_camera(&image.header);
            Some(image.encode())
        }
        _ => None,
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
