//! The matched filter that finds a line in the luma profile across it.

use glam::DVec2;

use realitysim_vision::LineImage;
use realitysim_vision::contrast::STRAY_LEVELS;

/// A short piece of a line as it is expected to appear, in pixels of the working image.
pub(super) struct Strip {
    /// The point midway between the drawn edges.
    pub(super) middle: DVec2,
    /// Unit vector across the line.
    pub(super) direction: DVec2,
    /// Distance between the drawn edges.
    pub(super) width_px: f64,
}

const MAX_SAMPLES: usize = 160;

/// Luma across an expected line, and a matched filter on it: the mean over the line's band less that of the carpet beside it.
pub(super) struct Profile {
    /// Distance between samples, pixels. The line is expected at sample `half`.
    step: f32,
    half: usize,
    /// Half the width of the line, samples.
    band: usize,
    /// Width of the strip of carpet beside the line, samples.
    flank: usize,
    /// Distance from the line's middle to the far end of that strip, samples.
    margin: usize,
    count: usize,
    /// The position of sample `half`, pixels.
    middle: [f32; 2],
    /// The step from sample to sample, pixels.
    along: [f32; 2],
    values: [f32; MAX_SAMPLES],
    /// Prefix sums of `values`.
    sums: [f32; MAX_SAMPLES + 1],
}

impl Profile {
    /// Reads the profile of `strip`, searching `reach_px` to either side. `None` if a part of it lies outside of the image.
    pub(super) fn across(strip: &Strip, image: &LineImage, reach_px: f64) -> Option<Self> {
        let width = strip.width_px as f32;
        let step = (width / 6.0).clamp(0.5, 1.5);
        let in_steps = |pixels: f32| libm::roundf(pixels / step) as usize;
        // Half the line, the blur at its edge, the carpet beside it.
        let (band, gap, flank) = (in_steps(0.5 * width - 0.25), in_steps(1.5), in_steps((width / 3.0).max(2.0)));
        let margin = band + gap + flank;
        let reach = (in_steps(reach_px as f32)).min((MAX_SAMPLES - 1) / 2 - margin.min((MAX_SAMPLES - 1) / 2 - 1));
        let half = reach + margin;
        let count = 2 * half + 1;
        if count > MAX_SAMPLES {
            return None;
        }
        let middle = [strip.middle.x as f32, strip.middle.y as f32];
        let along = [strip.direction.x as f32 * step, strip.direction.y as f32 * step];
        let (mut values, mut sums) = ([0.0f32; MAX_SAMPLES], [0.0f32; MAX_SAMPLES + 1]);
        if !image.profile(middle, along, &mut values[..count]) {
            return None;
        }
        let mut sum = 0.0;
        for (total, value) in sums[1..].iter_mut().zip(&values[..count]) {
            sum += value;
            *total = sum;
        }
        Some(Self { step, half, band, flank, margin, count, middle, along, values, sums })
    }

    /// The sample at which the line is expected.
    pub(super) fn middle(&self) -> usize {
        self.half
    }

    /// Distance between samples, pixels.
    pub(super) fn step_px(&self) -> f64 {
        f64::from(self.step)
    }

    /// The samples at which the line's middle may lie.
    pub(super) fn middles(&self) -> core::ops::Range<usize> {
        self.margin..self.count - self.margin
    }

    fn sum(&self, from: usize, to: usize) -> f32 {
        self.sums[to] - self.sums[from]
    }

    /// Mean luma of the carpet on both sides of a line at sample `at`.
    pub(super) fn flanks(&self, at: usize) -> (f32, f32) {
        let Self { margin, flank, .. } = *self;
        let per_flank = 1.0 / flank as f32;
        let left = self.sum(at - margin, at - margin + flank);
        let right = self.sum(at + margin + 1 - flank, at + margin + 1);
        (left * per_flank, right * per_flank)
    }

    /// The sample at which the line stands out most, and by which share of the brighter carpet beside it.
    pub(super) fn peak(&self) -> (usize, f64) {
        let per_band = 1.0 / (2 * self.band + 1) as f32;
        let (mut best, mut at) = (f32::NEG_INFINITY, self.half);
        for middle in self.middles() {
            let (left, right) = self.flanks(middle);
            let carpet = left.max(right);
            let band = self.sum(middle - self.band, middle + self.band + 1) * per_band;
            let response = (band - carpet) / (carpet + STRAY_LEVELS);
            if response > best {
                (best, at) = (response, middle);
            }
        }
        (at, f64::from(best))
    }

    /// Whether something stands before the line at sample `at` or before the carpet beside it.
    pub(super) fn is_hidden(&self, image: &LineImage, at: usize) -> bool {
        let beside = (self.margin - self.flank + self.flank / 2) as f32;
        let steps = at as f32 - self.half as f32;
        [steps, steps - beside, steps + beside]
            .iter()
            .any(|steps| image.hides(self.middle[0] + steps * self.along[0], self.middle[1] + steps * self.along[1]))
    }

    /// The centre of a line at about sample `at`, to a fraction of a sample.
    pub(super) fn centroid(&self, at: usize) -> f32 {
        centroid(&self.values[..self.count], at, self.margin - self.flank, self.flanks(at))
    }

    /// Distance of a sample from where the line is expected, pixels.
    pub(super) fn offset_px(&self, sample: f32) -> f64 {
        f64::from(sample - self.half as f32) * f64::from(self.step)
    }
}

/// Centroid of what is brighter than the carpet within `reach` samples of the peak. The carpet's brightness is interpolated
/// linearly between the two flanks.
fn centroid(profile: &[f32], peak: usize, reach: usize, (left, right): (f32, f32)) -> f32 {
    let (mut sum, mut moment) = (0.0f32, 0.0f32);
    let (carpet, slope) = (0.5 * (left + right), (right - left) / (2.0 * reach as f32 + 1.0));
    for (k, value) in profile[peak - reach..=peak + reach].iter().enumerate() {
        let off = k as f32 - reach as f32;
        let above = value - (carpet + slope * off);
        sum += above;
        moment += above * off;
    }
    if sum > 0.0 { peak as f32 + (moment / sum).clamp(-(reach as f32), reach as f32) } else { peak as f32 }
}
