//! How a detector did on some of the observations.

use serde::Serialize;

use super::intervals::Interval;
use super::moments::{GroundError, PixelError};
use super::observation::{Observation, Outcome};

/// How a detector did.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Statistics {
    /// Number of pictures.
    pub pictures: usize,
    /// Number of landmarks that were to be seen.
    pub to_be_seen: usize,
    /// Number of these that were found.
    pub found: usize,
    /// Number of these that were missed.
    pub missed: usize,
    /// Number of detections that are of no landmark.
    pub false_detections: usize,
    /// Probability that a landmark is found. `None` if none was to be seen.
    pub detection_probability: Option<Interval>,
    /// False detections in a picture. `None` if there was no picture.
    pub false_per_picture: Option<Interval>,
    /// Errors in the picture. `None` if nothing was found.
    pub pixel: Option<PixelError>,
    /// Errors on the ground. `None` if nothing was found there.
    pub ground: Option<GroundError>,
}

impl Statistics {
    /// Of observations in so many pictures.
    pub fn of<'a>(observations: impl Iterator<Item = &'a Observation>, pictures: usize) -> Self {
        let (mut missed, mut false_detections, mut offsets) = (0, 0, Vec::new());
        for observation in observations {
            match observation.outcome {
                Outcome::Missed => missed += 1,
                Outcome::False => false_detections += 1,
                Outcome::Found(offset) => offsets.push(offset),
            }
        }
        let found = offsets.len();
        let pixels: Vec<_> = offsets.iter().map(|offset| (offset.pixel, offset.label_px2)).collect();
        let ground: Vec<_> = offsets.iter().filter_map(|offset| offset.ground).collect();
        Self {
            pictures,
            to_be_seen: found + missed,
            found,
            missed,
            false_detections,
            detection_probability: Interval::share(found, found + missed),
            false_per_picture: Interval::rate(false_detections, pictures),
            pixel: PixelError::of(&pixels),
            ground: GroundError::of(&ground),
        }
    }

    /// Whether there was anything to count.
    pub fn is_empty(&self) -> bool {
        self.to_be_seen + self.false_detections == 0
    }
}
