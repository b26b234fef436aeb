//! A frame of a watched recorder, read from what the recorder says of it.

use std::time::Instant;

use serde::Deserialize;
use serde_json::{Value, json};

use crate::evaluation::drawing::projected_lines;
use crate::geometry::{Field, FieldDimensions, Isometry, Lens, LensParameters};
use crate::ros2::messages::FrameTag;

/// A frame with all that is needed to draw it.
#[derive(Debug)]
pub struct WatchedFrame {
    pub tag: FrameTag,
    pub lens: Lens,
    pub field: Field,
    /// The image as the camera made it: a JPEG or PNG; nothing if the camera's images are raw.
    pub picture: Vec<u8>,
    /// Time at which it came here.
    pub came: Instant,
}

impl WatchedFrame {
    /// Reads the line that goes with a picture; `None` if the recorder is of a version that says it otherwise.
    pub fn read(line: &Value, picture: Vec<u8>) -> Option<Self> {
        // Other parts of a tag may be missing, but a pose or a time that nobody told would be a wrong one.
        let is_whole = ["header", "sequence", "valid", "pose"].iter().all(|part| !line["tag"][part].is_null());
        let tag = FrameTag::deserialize(&line["tag"]).ok().filter(|_| is_whole)?;
        let lens = Lens::new(LensParameters::deserialize(&line["lens"]).ok()?).ok()?;
        let field = Field::new(FieldDimensions::deserialize(&line["field"]).ok()?).ok()?;
        Some(Self { tag, lens, field, picture, came: Instant::now() })
    }

    /// The lines of the field where the tag puts them, pixels from the corner of the image.
    pub fn lines(&self) -> Value {
        let lines = projected_lines(&self.lens, &Isometry::from(self.tag.pose.pose), &self.field);
        let tenth = |value: f64| (10.0 * value).round() / 10.0;
        let lines = lines.iter().map(|line| line.iter().map(|point| [tenth(point.x), tenth(point.y)]).collect());
        json!(lines.collect::<Vec<Vec<[f64; 2]>>>())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Settings, load_lens};

    fn line() -> Value {
        let field = Settings::default().field_dimensions().expect("a field");
        let lens = load_lens("fisheye-640").expect("a lens").lens.parameters().clone();
        let mut tag = FrameTag { sequence: 7, valid: true, ..FrameTag::default() };
        tag.pose.pose.position.z = 0.5;
        json!({ "tag": tag, "field": field, "lens": lens, "bytes": 3 })
    }

    #[test]
    fn a_frame_is_read_as_it_was_written() {
        let line = line();
        let frame = WatchedFrame::read(&line, vec![1, 2, 3]).expect("a frame");
        assert_eq!(json!(frame.tag), line["tag"]);
        assert!(frame.lines().as_array().is_some_and(|lines| !lines.is_empty()), "{}", frame.lines());
    }

    #[test]
    fn a_tag_may_lack_what_is_new_and_never_its_pose() {
        let mut older = line();
        for part in ["lines_explained", "utc_offset_ns", "ambiguous"] {
            older["tag"].as_object_mut().expect("an object").remove(part);
        }
        assert!(WatchedFrame::read(&older, Vec::new()).is_some());
        for part in ["header", "sequence", "valid", "pose"] {
            let mut other = older.clone();
            other["tag"].as_object_mut().expect("an object").remove(part);
            assert!(WatchedFrame::read(&other, Vec::new()).is_none(), "{part}");
        }
    }
}
