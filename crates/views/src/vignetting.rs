//! Measurement of a lens's vignetting from the images that it took.
//!
//! The same point of the ground lies nearer to the centre in one image than in another. Brightness that it loses on the way
//! out is due to the lens; a factor common to all points of a pair is due to exposure. The illumination is a polynomial in
//! the squared distance from the centre ([`Vignetting`]; the form of PTLens and of Goldman 2010, "Vignette and exposure
//! calibration"), fitted to the logarithms of all pairs by Gauss-Newton with a robust loss (Geman-McClure).

use nalgebra::{Cholesky, DMatrix, DVector};

use super::ground_warp::Warp;
use super::photometry::reading;
use super::target_rays::Target;
use super::world::Surface;
use super::{Candidate, Vignetting, World};

/// A point of the ground that two images show.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Overlap {
    /// Squared distance from the centre of each image, as a share of half the diagonal's square.
    pub r2: [f64; 2],
    /// Brightness in each image, gray levels.
    pub light: [f64; 2],
}

/// A pair with fewer common points is ignored.
const MIN_PLACES_IN_PAIR: usize = 60;
/// Fewer points over all pairs give no result.
const MIN_PLACES: usize = 2000;
/// The widest radius that is trusted is the one within which this share of all points lies.
const TRUSTED_RADIUS_SHARE: f64 = 0.98;
/// A lens that darkens less than this at the widest radius is taken to darken nothing ...
const MIN_DARKENING: f64 = 0.04;
/// ... as is one whose darkening is fewer standard deviations away from zero.
const MIN_SIGMAS: f64 = 6.0;
/// Neighbouring points share grain and errors: this many count as one independent point.
const CORRELATED_PLACES: f64 = 8.0;
/// Range of illumination, from the centre to the border, that lenses have.
const ILLUMINATION_RANGE: core::ops::RangeInclusive<f64> = 0.12..=1.01;
/// Scale of the robust loss, in median deviations.
const ROBUST_SCALE: f64 = 3.0;
/// Largest number of Gauss-Newton iterations.
const ROUNDS: usize = 12;

/// Points of the ground that both images show, at the corners of the first one's cells. `world` should be without goals.
pub fn overlap(first: &Candidate, second: &Candidate, world: &World) -> Vec<Overlap> {
    let target = Target::new(first.camera, &first.map_from_link, world);
    let (own, other) = (Warp::new(&target, first), Warp::new(&target, second));
    let r2 =
        |candidate: &Candidate, [u, v]: [f32; 2]| Vignetting::r2(candidate.camera.lens(), f64::from(u), f64::from(v));
    let mean = |rgb: [f64; 3]| (rgb[0] + rgb[1] + rgb[2]) / 3.0;
    let place = |node: usize| {
        let ground = target.surface_at(node) == Some(Surface::Ground);
        let (a, b) = (reading((&own, first), node)?, reading((&other, second), node)?);
        let r2 = [r2(first, own.node(node)), r2(second, other.node(node))];
        ground.then(|| Overlap { r2, light: [mean(a), mean(b)] })
    };
    (0..target.node_count()).filter_map(place).collect()
}

/// The vignetting of a lens from pairs of its images. `None` if it has none, or if there are too few points to tell.
pub fn darkening(pairs: &[Vec<Overlap>]) -> Option<Vignetting> {
    let pairs: Vec<&Vec<Overlap>> = pairs.iter().filter(|pair| pair.len() >= MIN_PLACES_IN_PAIR).collect();
    let mut radii: Vec<f64> = pairs.iter().flat_map(|pair| pair.iter().flat_map(|place| place.r2)).collect();
    if radii.len() < 2 * MIN_PLACES {
        return None;
    }
    radii.sort_by(f64::total_cmp);
    let widest = radii[(radii.len() as f64 * TRUSTED_RADIUS_SHARE) as usize];
    // Too many terms for the radii at hand give polynomials that no lens has: fewer terms are tried then.
    (1..=3).rev().find_map(|terms| {
        let (vignetting, sigma) = fit(&pairs, terms, widest)?;
        let at = |r2: f64| vignetting.illumination(r2);
        let sound = (0..=20).all(|i| ILLUMINATION_RANGE.contains(&at(f64::from(i) / 20.0)));
        let darkening = 1.0 - at(widest);
        let shows = darkening > MIN_DARKENING && darkening > MIN_SIGMAS * sigma;
        sound.then(|| shows.then_some(vignetting))
    })?
}

/// Fits this many terms. Returns them with the standard deviation of the illumination at the widest radius.
fn fit(pairs: &[&Vec<Overlap>], terms: usize, widest: f64) -> Option<(Vignetting, f64)> {
    let mut found = Vignetting::default();
    let mut sigma = 0.0;
    for _ in 0..ROUNDS {
        let off = |place: &Overlap| {
            let [a, b] = place.r2.map(|r2| libm::log(found.illumination(r2)));
            libm::log(place.light[0] / place.light[1]) - (a - b)
        };
        // The exposure is the median over the pair.
        let residuals: Vec<Vec<f64>> = pairs
            .iter()
            .map(|pair| {
                let off: Vec<f64> = pair.iter().map(off).collect();
                let exposure = median(off.clone());
                off.into_iter().map(|off| off - exposure).collect()
            })
            .collect();
        let scale = ROBUST_SCALE * median(residuals.iter().flatten().map(|off| off.abs()).collect()).max(1e-4);
        let (mut normal, mut right) = (DMatrix::zeros(terms, terms), DVector::zeros(terms));
        let (mut squares, mut weights) = (0.0, 0.0);
        for (pair, residuals) in pairs.iter().zip(&residuals) {
            let weight = |off: f64| {
                let share = 1.0 / (1.0 + (off / scale) * (off / scale));
                share * share
            };
            let rows: Vec<DVector<f64>> = pair.iter().map(|place| derivatives(&found, place, terms)).collect();
            let sum: f64 = residuals.iter().map(|off| weight(*off)).sum();
            // The exposure is a free unknown: what all points of a pair have in common is removed.
            let (mut mean, mut mean_off) = (DVector::zeros(terms), 0.0);
            for (row, off) in rows.iter().zip(residuals) {
                mean += row * (weight(*off) / sum);
                mean_off += off * weight(*off) / sum;
            }
            for (row, off) in rows.iter().zip(residuals) {
                let (row, left) = (row - &mean, off - mean_off);
                normal += &row * row.transpose() * weight(*off);
                right += &row * (left * weight(*off));
                squares += weight(*off) * left * left;
            }
            weights += sum;
        }
        let solved = Cholesky::new(normal)?;
        let step = solved.solve(&right);
        (0..terms).for_each(|i| found.k[i] += step[i]);
        if !found.k.iter().all(|k| k.is_finite() && k.abs() < 20.0) {
            return None;
        }
        let at_widest = DVector::from_fn(terms, |i, _| libm::pow(widest, (i + 1) as f64));
        let variance = at_widest.dot(&solved.solve(&at_widest)) * CORRELATED_PLACES * squares / weights.max(1.0);
        sigma = libm::sqrt(variance);
        if step.norm() < 1e-5 {
            break;
        }
    }
    Some((found, sigma))
}

/// Derivatives of the logarithm of a point's brightness ratio by each coefficient.
fn derivatives(vignetting: &Vignetting, place: &Overlap, terms: usize) -> DVector<f64> {
    let [a, b] = place.r2.map(|r2| (r2, vignetting.illumination(r2)));
    let power = |(r2, light): (f64, f64), i: usize| libm::pow(r2, (i + 1) as f64) / light;
    DVector::from_fn(terms, |i, _| power(a, i) - power(b, i))
}

fn median(mut values: Vec<f64>) -> f64 {
    let middle = values.len() / 2;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Points of a pair at all radii, with grain, an exposure, and outliers.
    fn pair(vignetting: &Vignetting, exposure: f64, grain: f64, seed: u32) -> Vec<Overlap> {
        let noise = |i: u32| {
            f64::from(i.wrapping_mul(2_654_435_761).rotate_left(13).wrapping_mul(40_503) >> 8) / f64::from(1 << 24)
        };
        let place = |i: u32| {
            let at = |k: u32| noise(seed.wrapping_mul(7919) + 5 * i + k);
            let r2 = [0.7 * at(0), 0.7 * at(1)];
            let odd = if i % 20 == 7 { 2.0 } else { 1.0 };
            let light = [
                vignetting.illumination(r2[0]) * (1.0 + grain * (at(2) - 0.5)) * odd,
                vignetting.illumination(r2[1]) * (1.0 + grain * (at(3) - 0.5)) * exposure,
            ];
            Overlap { r2, light: light.map(|light| 100.0 * light) }
        };
        (0..400).map(place).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn the_darkening_comes_back_whatever_the_exposures(
            k1 in -0.7..-0.2f64, k2 in -0.1..0.1f64, exposures in proptest::array::uniform8(0.5..2.0f64), seed in 0..1000u32,
        ) {
            let wanted = Vignetting { k: [k1, k2, 0.0] };
            let pairs: Vec<Vec<Overlap>> =
                exposures.iter().zip(seed..).map(|(exposure, seed)| pair(&wanted, *exposure, 0.2, seed)).collect();
            let found = darkening(&pairs).expect("it darkens");
            for r2 in [0.1, 0.3, 0.5, 0.7] {
                let (found, wanted) = (found.illumination(r2), wanted.illumination(r2));
                prop_assert!((found - wanted).abs() < 0.02, "{r2}: {found} for {wanted}");
            }
        }

        #[test]
        fn a_lens_that_darkens_nothing_is_left_alone(grain in 0.02..0.4f64, seed in 0..1000u32) {
            let pairs: Vec<Vec<Overlap>> = (seed..seed + 8).map(|seed| pair(&Vignetting::default(), 1.3, grain, seed)).collect();
            prop_assert_eq!(darkening(&pairs), None);
        }
    }

    #[test]
    fn too_little_says_nothing() {
        let dark = Vignetting { k: [-0.5, 0.0, 0.0] };
        assert_eq!(darkening(&[]), None);
        assert_eq!(darkening(&[pair(&dark, 1.0, 0.1, 3)]), None, "one pair of 400 places");
        let few: Vec<Vec<Overlap>> = (0..100).map(|seed| pair(&dark, 1.0, 0.1, seed)[..40].to_vec()).collect();
        assert_eq!(darkening(&few), None, "pairs of 40 places");
    }
}
