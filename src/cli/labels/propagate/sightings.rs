//! Whether each frame sees the object.

use core::ops::RangeInclusive;

use super::super::super::output;
use super::super::posed_images::PosedImages;
use super::click::{Clicked, Frame};
use crate::database::in_parallel;
use crate::labels::{Appearance, NoBox, SphereBox};

/// A frame, and what it shows where the object stands.
pub(super) struct Sighting {
    pub(super) frame: Frame,
    pub(super) finding: Finding,
}

/// What a frame shows where the object stands.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Finding {
    /// The object, as like the picture that was pointed at as stated.
    Object(SphereBox, f64),
    /// Something else.
    SomethingElse(SphereBox, f64),
    /// It has no box in this frame.
    NoBox(NoBox),
    /// The image cannot be read.
    Unreadable(String),
}

/// Images that are looked at between two reports of progress.
const BATCH: usize = 64;
/// Least similarity of a frame that sees the object.
///
/// Of rendered balls that nothing hides it is 0.61 and more; of those that are gone, hidden for the most part or moved by their own
/// diameter at most 0.58, and that where a leg of the ball's colour stands before it (printed by
/// `cargo test --release --test integration -- replay::propagate --nocapture`).
const MIN_SIMILARITY: f64 = 0.6;

impl Sighting {
    /// When the frame was taken, seconds, and whether it shows the object; `None` if it has no box.
    pub(super) fn seen(&self) -> Option<(f64, bool)> {
        match self.finding {
            Finding::Object(..) => Some((self.frame.time_s, true)),
            Finding::SomethingElse(..) => Some((self.frame.time_s, false)),
            Finding::NoBox(_) | Finding::Unreadable(_) => None,
        }
    }

    /// The box, if the frame sees the object.
    pub(super) fn labelled(&self) -> Option<&SphereBox> {
        match &self.finding {
            Finding::Object(found, _) => Some(found),
            _ => None,
        }
    }
}

/// Looks for the object in all frames within a time, seconds after the first frame.
pub(super) fn look(
    images: &PosedImages,
    clicked: &Clicked,
    time_s: RangeInclusive<f64>,
) -> anyhow::Result<Vec<Sighting>> {
    let frames: Vec<Frame> = clicked.frames.iter().filter(|frame| time_s.contains(&frame.time_s)).copied().collect();
    let mut progress = output::Progress::new("looking");
    let mut sightings = Vec::with_capacity(frames.len());
    for part in frames.chunks(BATCH) {
        progress.set(sightings.len() as u64, Some(frames.len() as u64));
        let findings =
            in_parallel(part.len(), |place| finding(images, clicked, &part[place]).unwrap_or_else(Finding::Unreadable));
        sightings.extend(part.iter().zip(findings).map(|(frame, finding)| Sighting { frame: *frame, finding }));
    }
    progress.finish();
    Ok(sightings)
}

fn finding(images: &PosedImages, clicked: &Clicked, frame: &Frame) -> Result<Finding, String> {
    let image = images.posed(&frame.record, &[])?;
    let found = match clicked.sphere.label(&image) {
        Ok(found) => found,
        Err(why) => return Ok(Finding::NoBox(why)),
    };
    let picture = images.database().image(frame.number)?;
    let appearance = Appearance::of(&clicked.sphere, &image, picture.full());
    let similarity = appearance.and_then(|seen| seen.similarity(&clicked.appearance)).unwrap_or(0.0);
    Ok(if similarity >= MIN_SIMILARITY {
        Finding::Object(found, similarity)
    } else {
        Finding::SomethingElse(found, similarity)
    })
}
