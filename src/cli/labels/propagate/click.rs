//! The frame and the pixel that a person points at.

use std::collections::HashMap;
use std::path::Path;

use anyhow::{Context, bail};
use glam::DVec2;

use super::super::super::settings::{UsageError, numbers};
use super::super::posed_images::PosedImages;
use crate::database::{Record, SourceKind, best_tags};
use crate::labels::{Appearance, RestingSphere};
use crate::ros2::messages::FrameTag;

/// What a person states: a frame, the pixel of an object's middle in it, and the object's radius.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Click {
    frame: u64,
    /// The first pixel's centre is (0, 0).
    at: DVec2,
    radius_m: f64,
}

/// Parses `FRAME,u,v,radius`.
pub(super) fn parse(text: &str) -> Result<Click, String> {
    let form = "FRAME,u,v,radius as in 42,311,207,0.07";
    let [frame, u, v, radius_m] = numbers::<4>(text, form)?;
    if frame < 0.0 || frame.fract() != 0.0 {
        return Err(format!("expected {form}: the frame is a whole number, 0 or more"));
    }
    if !(0.01..=1.0).contains(&radius_m) {
        return Err(format!("expected {form}: the radius is 0.01 to 1 m"));
    }
    Ok(Click { frame: frame as u64, at: DVec2::new(u, v), radius_m })
}

/// The object that a click determines, and the frames of its capture.
pub(super) struct Clicked {
    pub(super) sphere: RestingSphere,
    pub(super) appearance: Appearance,
    /// All frames of the capture that have an image and a pose, in the order of time.
    pub(super) frames: Vec<Frame>,
}

/// A frame of the capture.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    /// Its number in the session.
    pub(super) sequence: u64,
    /// Seconds after the session's first frame.
    pub(super) time_s: f64,
    /// Number of its image in the database.
    pub(super) number: usize,
    pub(super) record: Record,
}

/// Finds the object that a click in a database's only capture determines.
pub(super) fn find(images: &PosedImages, input: &Path, click: Click) -> anyhow::Result<Clicked> {
    let input = input.display();
    let database = images.database();
    let [source] = &database.contents().sources[..] else {
        let count = database.contents().sources.len();
        let what =
            format!("{input}: holds {count} sources, and --at counts the frames of one capture: name that capture");
        return Err(UsageError(what).into());
    };
    if source.kind == SourceKind::Folder {
        return Err(
            UsageError(format!("{input}: holds images of a folder, which have no frames: name a capture")).into()
        );
    }
    let (_, tags) = best_tags(&source.path)?;
    let frames = frames(images, &tags.found);
    let clicked = frames.iter().find(|frame| frame.sequence == click.frame);
    let Some(clicked) = clicked else { bail!(no_such_frame(&tags.found, &frames, click.frame)) };
    let named = || format!("--at: frame {}", click.frame);
    let picture = database.image(clicked.number).map_err(anyhow::Error::msg).with_context(named)?;
    let shown = picture.full().mask();
    let image = images.posed(&clicked.record, &shown).map_err(anyhow::Error::msg)?;
    let sphere = RestingSphere::find(&image, click.at, click.radius_m).map_err(|why| {
        UsageError(format!("--at: frame {}, pixel {}, {}: {why}", click.frame, click.at.x, click.at.y))
    })?;
    check_place(&sphere, database.field().carpet_half_extent())?;
    let appearance = Appearance::of(&sphere, &image, picture.full()).with_context(|| {
        format!(
            "--at: frame {} shows too little around the object: point at it where all of it is in the picture",
            click.frame
        )
    })?;
    Ok(Clicked { sphere, appearance, frames })
}

/// Farthest from the carpet that an object may stand, metres: beyond, the carpet's plane goes on no more.
const MAX_ASIDE_M: f64 = 2.0;

fn check_place(sphere: &RestingSphere, half: DVec2) -> Result<(), UsageError> {
    let at = sphere.centre.truncate();
    if (at.abs() - half).max_element() <= MAX_ASIDE_M {
        return Ok(());
    }
    Err(UsageError(format!(
        "--at: an object with this middle and radius would stand at {:.1}, {:.1} m, beyond the carpet: check pixel and radius",
        at.x, at.y
    )))
}

fn frames(images: &PosedImages, tags: &[FrameTag]) -> Vec<Frame> {
    let stamp_ns = |tag: &FrameTag| tag.header.stamp.to_nanoseconds();
    let first_ns = tags.iter().map(stamp_ns).min().unwrap_or_default();
    let sequences: HashMap<i64, u64> = tags.iter().map(|tag| (stamp_ns(tag), tag.sequence)).collect();
    let frame = |(number, record): (usize, Record)| {
        let sequence = *sequences.get(&record.stamp_ns)?;
        let time_s = record.stamp_ns.saturating_sub(first_ns) as f64 / 1e9;
        Some(Frame { sequence, time_s, number, record })
    };
    let mut frames: Vec<Frame> = images.database().index().records().enumerate().filter_map(frame).collect();
    frames.sort_by_key(|frame| frame.record.stamp_ns);
    frames
}

/// Says why a frame cannot be pointed at, and which can.
fn no_such_frame(tags: &[FrameTag], frames: &[Frame], wanted: u64) -> String {
    let nearest = frames.iter().min_by_key(|frame| frame.sequence.abs_diff(wanted));
    let nearest = nearest.map_or(String::new(), |frame| format!("; the nearest that has is {}", frame.sequence));
    match tags.iter().find(|tag| tag.sequence == wanted) {
        Some(tag) if !tag.valid => format!("--at: frame {wanted} has no valid pose ({}){nearest}", tag.reason),
        Some(_) => format!(
            "--at: frame {wanted} has no image, or its pose may be that of the other half of the field{nearest}"
        ),
        None => {
            let last = tags.iter().map(|tag| tag.sequence).max().unwrap_or_default();
            format!("--at: there is no frame {wanted}; the frames are 0 to {last}")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_click_is_a_frame_a_pixel_and_a_radius() {
        let click = Click { frame: 42, at: DVec2::new(311.5, 207.0), radius_m: 0.07 };
        assert_eq!(parse("42, 311.5,207,0.07"), Ok(click));
        for (text, said) in [
            ("42,311,207", "4 numbers, and there are 3"),
            ("-1,311,207,0.07", "whole number"),
            ("1.5,311,207,0.07", "whole number"),
            ("1,311,207,7", "radius is 0.01 to 1 m"),
            ("1,nan,207,0.07", "numbers with commas"),
            ("", "numbers with commas"),
        ] {
            let error = parse(text).expect_err(text);
            assert!(error.contains(said), "{text}: {error}");
        }
    }
}
