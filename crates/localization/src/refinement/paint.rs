//! How painted lines stand out of the carpet in one picture: docs/lines.md.

use realitysim_vision::LineImage;
use realitysim_vision::contrast::{BEST_RESPONSE, STRAY_LEVELS};

/// How lines stand out in this picture, both as shares of the carpet's brightness.
#[derive(Clone, Copy, Debug)]
pub(super) struct Paint {
    /// A line of the best width.
    contrast: f64,
    /// Standard deviation of plain carpet.
    noise: f64,
}

/// Width in pixels of a line that shows half the time, where a line of the best width stands out no more than the carpet's noise, and
/// the limits of that width: the pile, the blur and the colour filter hide thin lines the sooner the fainter they are.
const HALF_SEEN_PX: f64 = 25.0;
const HALF_SEEN_LIMITS_PX: (f64, f64) = (0.6, 4.0);
/// Share of the expected contrast that makes a line.
const LEAST_CONTRAST: f64 = 0.12;
/// And so many standard deviations of plain carpet.
const ABOVE_NOISE: f64 = 1.2;
/// Carpet is as bright on both sides of a line, up to this share of the expected contrast.
const MOST_SLOPE: f64 = 0.35;
/// Carpet that is lit at all is brighter than this share of the step from it to a line: of the gray that a camera writes it is about as
/// much as the step itself.
const UNLIT: f64 = 0.2;
/// Very clear paint asks for no more than if it were so many gray levels brighter than its carpet.
const MOST_UNLIT_LEVELS: f64 = 100.0;

impl Paint {
    /// `None` if nothing in the picture can be a line.
    pub(super) fn of(image: &LineImage) -> Option<Self> {
        let contrast = f64::from(image.full_contrast()) / BEST_RESPONSE;
        contrast.is_finite().then(|| Self { contrast, noise: f64::from(image.noise()) })
    }

    /// Standard deviation of plain carpet, as a share of its brightness.
    pub(super) fn noise(&self) -> f64 {
        self.noise
    }

    /// Width of a line that shows half the time, in pixels.
    pub(super) fn half_seen_px(&self) -> f64 {
        let (thinnest, widest) = HALF_SEEN_LIMITS_PX;
        (HALF_SEEN_PX * self.noise / self.contrast.max(1e-3)).clamp(thinnest, widest)
    }

    /// A line of this width is one if it stands out by so much.
    pub(super) fn least(&self, width_px: f64) -> f64 {
        // A line thinner than the pixels' own blur shows less.
        let shown = self.contrast * (width_px / 2.0).min(1.0);
        (LEAST_CONTRAST * shown).max(ABOVE_NOISE * self.noise)
    }

    /// Share of lines of this width that a picture shows.
    pub(super) fn visibility(&self, width_px: f64) -> f64 {
        let thin = self.half_seen_px() / width_px;
        1.0 / (1.0 + thin * thin * thin)
    }

    /// Both flanks of a line are carpet, in the same light.
    pub(super) fn are_carpet(&self, (left, right): (f32, f32)) -> bool {
        let (left, right) = (f64::from(left), f64::from(right));
        let step = self.contrast * (0.5 * (left + right) + f64::from(STRAY_LEVELS));
        (left - right).abs() < MOST_SLOPE * step && left.max(right) > UNLIT * step.min(MOST_UNLIT_LEVELS)
    }
}
