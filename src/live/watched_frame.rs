//! A frame of a watched recorder, read from what the recorder says of it.

use std::time::Instant;

use glam::DVec2;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::evaluation::drawing::projected_lines;
use crate::geometry::{Field, FieldDimensions, Isometry, Lens, LensParameters};
use crate::ros2::messages::FrameTag;

/// Largest distance between a line and the points left out of it, pixels.
const MAX_DEVIATION_PX: f64 = 0.2;

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
        let places = |line: &Vec<DVec2>| thinned(line).map(|point| [tenth(point.x), tenth(point.y)]).collect();
        json!(lines.iter().map(places).collect::<Vec<Vec<[f64; 2]>>>())
    }
}

/// Leaves points out as long as the line through the others passes them within [`MAX_DEVIATION_PX`]: most of them, since lines are
/// nearly straight in most of an image.
fn thinned(line: &[DVec2]) -> impl Iterator<Item = DVec2> + '_ {
    let mut from = 0;
    let fits = move |from: usize, to: usize| {
        let (start, along) = (line[from], (line[to] - line[from]).normalize_or_zero());
        line[from + 1..to].iter().all(|point| (point - start).perp_dot(along).abs() <= MAX_DEVIATION_PX)
    };
    let next = move || {
        let last = line.len().checked_sub(1)?;
        (from < last).then(|| {
            from = (from + 1..=last).take_while(|to| fits(from, *to)).last().unwrap_or(last);
            line[from]
        })
    };
    line.first().copied().into_iter().chain(core::iter::from_fn(next))
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
    fn points_on_a_straight_line_are_left_out_and_no_line_moves() {
        let arc = (0..=400).map(|i| DVec2::from_angle(f64::from(i) * 0.004) * 200.0);
        let line: Vec<DVec2> = (0..100).map(|i| DVec2::new(200.0, f64::from(i) - 100.0)).chain(arc).collect();
        let thin: Vec<DVec2> = thinned(&line).collect();
        assert!(thin.len() < 30, "{}", thin.len());
        assert_eq!((thin.first(), thin.last()), (line.first(), line.last()));
        for point in &line {
            let nearest = thin.windows(2).map(|ends| {
                let along = ends[1] - ends[0];
                let share = ((point - ends[0]).dot(along) / along.length_squared()).clamp(0.0, 1.0);
                point.distance(ends[0] + along * share)
            });
            assert!(nearest.fold(f64::INFINITY, f64::min) <= MAX_DEVIATION_PX + 1e-9, "{point}");
        }
        assert_eq!(thinned(&[]).count() + thinned(&line[..1]).count() + thinned(&line[..2]).count(), 3);
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
