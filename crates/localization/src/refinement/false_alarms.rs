//! A test whether lines lie where a pose has them by more than chance.
//!
//! This is an a-contrario test (Desolneux, Moisan and Morel 2000). The null hypothesis is that the picture has no line where the
//! pose puts one. Then what stands out most across the expected line, within [`WITHIN_PX`] to each side, may lie anywhere
//! there, and with a known probability p it lies as near to the middle as a line would. That holds for any noise and contrast,
//! because places are only compared with their own neighbours. Of n places, k hit the middle by chance with a probability of
//! at most exp(-n KL(k/n, p)), where KL is the relative entropy of two coins (Hoeffding's bound).

use super::line_contrast::Paint;
use super::line_measurement::{CameraModel, each_place};
use super::points::LinePoints;
use super::share;
use realitysim_geometry::Isometry;
use realitysim_vision::LineImage;

/// Half the width of the strip across a line in which it has to stand out most.
const WITHIN_PX: f64 = 16.0;
/// Smallest distance between tested places: neighbours this far apart share no blade, no glint and hardly a block of JPEG.
const MIN_SPACING_PX: f64 = 8.0;

/// Result of the test.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct ChanceTest {
    /// Share, weighted by visibility, of the places that nothing hides at which the line stands out most.
    pub(super) foremost: f64,
    /// -log10 of the bound on the probability that chance puts so many lines where the pose has them. 0 if there are no more than
    /// chance would put.
    pub(super) digits: f64,
    /// Width of a line that is seen half the time, pixels.
    pub(super) half_seen_px: f64,
}

/// Tests the lines of the image against this pose.
pub(super) fn test(
    points: &LinePoints,
    image: &LineImage,
    camera_model: CameraModel,
    map_from_optical: &Isometry,
) -> ChanceTest {
    let Some(paint) = Paint::of(image) else { return ChanceTest::default() };
    let (mut places, mut hits, mut by_chance) = (0.0, 0.0, 0.0);
    let (mut visible, mut foremost) = (0.0, 0.0);
    each_place(points, image, camera_model, map_from_optical, MIN_SPACING_PX, |_, _, expected| {
        if let Some((is_foremost, chance)) = expected.is_foremost(image, paint, WITHIN_PX) {
            places += 1.0;
            hits += f64::from(u8::from(is_foremost));
            by_chance += chance;
            // A line too thin to be seen says little by its absence.
            let counts = paint.visibility(expected.strip.width_px);
            visible += counts;
            foremost += if is_foremost { counts } else { 0.0 };
        }
    });
    ChanceTest {
        foremost: share(foremost, visible, hits / f64::max(places, 1.0)),
        digits: digits_of(places, hits, by_chance),
        half_seen_px: paint.half_seen_px(),
    }
}

/// The digits for this many hits among the places where `by_chance` are expected.
fn digits_of(places: f64, hits: f64, by_chance: f64) -> f64 {
    // The comparison is false for NaN.
    if !(hits > by_chance && by_chance > 0.0) {
        return 0.0;
    }
    let (share, chance) = (hits / places, by_chance / places);
    let miss = if share < 1.0 { (1.0 - share) * libm::log((1.0 - share) / (1.0 - chance)) } else { 0.0 };
    places * (share * libm::log(share / chance) + miss) / core::f64::consts::LN_10
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The tail of the binomial distribution, exactly.
    fn tail(places: u32, hits: u32, chance: f64) -> f64 {
        let binomial = |k: u32| (0..k).fold(1.0, |value, i| value * f64::from(places - i) / f64::from(i + 1));
        (hits..=places).map(|k| binomial(k) * chance.powi(k as i32) * (1.0 - chance).powi((places - k) as i32)).sum()
    }

    #[test]
    fn the_bound_is_never_below_the_exact_probability_and_not_far_above_it() {
        for places in [5, 20, 60, 100] {
            for hits in 0..=places {
                let chance = 0.094;
                let bound = 10f64.powf(-digits_of(f64::from(places), f64::from(hits), chance * f64::from(places)));
                let exact = tail(places, hits, chance);
                assert!(bound >= exact * (1.0 - 1e-9), "{hits} of {places}: {bound:e} {exact:e}");
                assert!(bound < 40.0 * exact + 1e-300, "{hits} of {places}: {bound:e} {exact:e}");
            }
        }
    }

    #[test]
    fn no_place_and_no_hit_say_nothing() {
        assert_eq!(digits_of(0.0, 0.0, 0.0), 0.0);
        assert_eq!(digits_of(10.0, 0.0, 1.0), 0.0);
        assert_eq!(digits_of(10.0, 1.0, 1.0), 0.0);
        assert_eq!(digits_of(f64::NAN, 1.0, 1.0), 0.0);
    }
}
