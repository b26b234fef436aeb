//! Two fits of one walk, each from one half of the line evidence of every frame.
//!
//! Their difference shows the noise of the lines and what the halves see differently. It cannot show what both share: the field file,
//! the IMU, odometry, and errors of the lens or mount that move both halves alike.

use serde::Serialize;

use super::Measure;
use crate::statistics::rms;
use glam::DVec3;
use nalgebra::{Matrix2, Matrix6, Vector2};
use realitysim_geometry::{LensError, LensParameters};
use realitysim_localization::refinement::error_between;
use realitysim_localization::smoothing::{Frame, Model, Place, Smoothed, smooth};

/// How line places are divided.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Halving {
    /// Odd and even metres of line: squares of a metre on the field, like a chessboard's.
    Metres,
    /// The left and the right half of the image.
    Sides,
}

/// The difference of the two fits.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SplitHalf {
    /// How line places were divided.
    pub by: Halving,
    /// Number of frames with enough lines in both halves.
    pub frames: usize,
    /// Root mean square of the horizontal distance between the poses of both halves, centimetres.
    pub apart_cm: f64,
    /// Root mean square of the angle between them, degrees.
    pub apart_deg: f64,
    /// The distance in standard deviations that the covariances of both halves claim: about 1 if they are right and the halves share
    /// nothing, above 1 if tags are worse than they claim.
    pub claimed: f64,
    /// Noise of tags by all lines, root mean square of the horizontal distance, centimetres: what their covariances claim, times
    /// `claimed`.
    pub noise_cm: f64,
}

/// Fewest line places of a frame in each half.
const MIN_PLACES: usize = 12;
/// Fewest frames that tell anything.
const MIN_FRAMES: usize = 20;
/// Moves the edges of the squares off the lines, which lie at round numbers, metres.
const EDGE_M: f64 = 0.137;

impl Halving {
    fn is_first(self, place: &Place, lens: &LensParameters) -> bool {
        let metre = |at: f64| libm::floor(at + EDGE_M) as i64;
        match self {
            Self::Metres => (metre(place.point.x) + metre(place.point.y)).rem_euclid(2) == 0,
            Self::Sides => place.pixel.x < lens.cx,
        }
    }
}

/// Fits both halves of a walk. `smoothed` is the fit of all lines.
///
/// # Errors
///
/// A [`LensError`] if a half gives no valid lens.
pub fn split_half(
    by: Halving,
    frames: &[Frame],
    smoothed: &Smoothed,
    lens: &LensParameters,
) -> Result<Measure<SplitHalf>, LensError> {
    let model = Model::default();
    let halves = [true, false].map(|first| half(frames, |place| by.is_first(place, lens) == first));
    let enough = |index: &usize| halves.iter().all(|half| half[*index].places.len() >= MIN_PLACES);
    let chosen: Vec<usize> = (0..frames.len()).filter(enough).collect();
    if chosen.len() < MIN_FRAMES {
        return Ok(Measure::missing(format!(
            "{} frames have {MIN_PLACES} line places in both halves, and {MIN_FRAMES} are needed: walk where more lines are in view",
            chosen.len()
        )));
    }
    let [one, other] = [smooth(&halves[0], lens, &model)?, smooth(&halves[1], lens, &model)?];
    let (mut metres, mut radians, mut squares) = (Vec::new(), Vec::new(), 0.0);
    for index in &chosen {
        let off = error_between(&one.map_from_optical[*index], &other.map_from_optical[*index]);
        let flat = Vector2::new(off[0], off[1]);
        metres.push(flat.norm());
        radians.push(DVec3::new(off[3], off[4], off[5]).length());
        let spread = horizontal(&one.covariances[*index]) + horizontal(&other.covariances[*index]);
        squares += spread.try_inverse().map_or(0.0, |inverse| flat.dot(&(inverse * flat)));
    }
    let claimed = libm::sqrt(squares / (2.0 * chosen.len() as f64));
    let all = rms(chosen.iter().map(|index| libm::sqrt(horizontal(&smoothed.covariances[*index]).trace().max(0.0))));
    Ok(Measure::Known(SplitHalf {
        by,
        frames: chosen.len(),
        apart_cm: 100.0 * rms(metres),
        apart_deg: rms(radians).to_degrees(),
        claimed,
        noise_cm: 100.0 * all * claimed,
    }))
}

fn horizontal(covariance: &Matrix6<f64>) -> Matrix2<f64> {
    covariance.fixed_view::<2, 2>(0, 0).into()
}

/// The walk with the line places that belong to one half. The ground's texture, which the halves would share, is left out.
fn half(frames: &[Frame], belongs: impl Fn(&Place) -> bool) -> Vec<Frame> {
    let of_frame = |frame: &Frame| {
        let places = frame.places.iter().filter(|place| belongs(place)).copied().collect();
        Frame { places, overlap: None, ..*frame }
    };
    frames.iter().map(of_frame).collect()
}
