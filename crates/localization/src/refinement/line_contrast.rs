//! Contrast of painted lines and noise of the carpet in one picture: docs/explanation/lines.md.

use realitysim_vision::LineImage;
use realitysim_vision::contrast::{BEST_RESPONSE, STRAY_LEVELS};

/// Contrast of lines and noise of the carpet in one picture, both as shares of the carpet's brightness.
#[derive(Clone, Copy, Debug)]
pub(super) struct Paint {
    /// Contrast of a line of the best width.
    contrast: f64,
    /// Standard deviation of plain carpet.
    noise: f64,
}

/// Width in pixels of a line that is seen half the time, where a line of the best width stands out no more than the carpet's
/// noise. The pile, the blur and the colour filter hide thin lines the sooner the fainter they are.
const HALF_SEEN_PX: f64 = 25.0;
/// Limits of the width that is seen half the time, pixels.
const HALF_SEEN_LIMITS_PX: (f64, f64) = (0.6, 4.0);
/// Smallest share of the expected contrast that counts as a line.
const MIN_CONTRAST: f64 = 0.12;
/// Smallest contrast of a line, in standard deviations of plain carpet.
const MIN_CONTRAST_TO_NOISE: f64 = 1.2;
/// Largest difference of the carpet on both sides of a line, as a share of the expected contrast.
const SLOPE_LIMIT: f64 = 0.35;
/// Carpet that is lit at all is brighter than this share of the step from carpet to line. The gray values of lit carpet are
/// about as large as the step itself.
const MIN_LIT_SHARE: f64 = 0.2;
/// Largest step that this share is taken of, gray levels: very clear paint asks for no brighter carpet.
const LIT_STEP_LIMIT_LEVELS: f64 = 100.0;

impl Paint {
    /// The paint of a picture, or `None` if nothing in it can be a line.
    pub(super) fn of(image: &LineImage) -> Option<Self> {
        let contrast = f64::from(image.full_contrast()) / BEST_RESPONSE;
        contrast.is_finite().then(|| Self { contrast, noise: f64::from(image.noise()) })
    }

    /// Standard deviation of plain carpet, as a share of its brightness.
    pub(super) fn noise(&self) -> f64 {
        self.noise
    }

    /// Width of a line that is seen half the time, pixels.
    pub(super) fn half_seen_px(&self) -> f64 {
        let (thinnest, widest) = HALF_SEEN_LIMITS_PX;
        (HALF_SEEN_PX * self.noise / self.contrast.max(1e-3)).clamp(thinnest, widest)
    }

    /// The smallest contrast that counts as a line of this width.
    pub(super) fn min_contrast(&self, width_px: f64) -> f64 {
        // A line thinner than the blur of the pixels shows less.
        let shown = self.contrast * (width_px / 2.0).min(1.0);
        (MIN_CONTRAST * shown).max(MIN_CONTRAST_TO_NOISE * self.noise)
    }

    /// Share of the lines of this width that the picture shows.
    pub(super) fn visibility(&self, width_px: f64) -> f64 {
        let thin = self.half_seen_px() / width_px;
        1.0 / (1.0 + thin * thin * thin)
    }

    /// Whether both flanks of a line are carpet in the same light.
    pub(super) fn are_carpet(&self, (left, right): (f32, f32)) -> bool {
        let (left, right) = (f64::from(left), f64::from(right));
        let step = self.contrast * (0.5 * (left + right) + f64::from(STRAY_LEVELS));
        (left - right).abs() < SLOPE_LIMIT * step && left.max(right) > MIN_LIT_SHARE * step.min(LIT_STEP_LIMIT_LEVELS)
    }
}
