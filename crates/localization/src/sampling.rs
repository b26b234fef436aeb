//! How many particles and how many rounds a frame needs.
//!
//! KLD-sampling (D. Fox, "Adapting the sample size in particle filters through KLD-sampling", IJRR 22, 2003): as many
//! particles as keep the error of the sampled distribution below a bound, by the number of bins that it fills.
//! Rounds of weighting and resampling go on until the effective sample size says that the particles lie as the weights do.

use super::particles::Particles;
use super::weights::Weights;
use realitysim_geometry::Pose2;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sampling {
    /// N of the paper; with [`Self::adaptive`] the most.
    pub particles: usize,
    /// T of the paper; with [`Self::adaptive`] the most.
    pub iterations: usize,
    /// Fewer where fewer do, down to [`Self::fewest`] particles.
    pub adaptive: bool,
    pub fewest: usize,
}

/// Bound of the Kullback-Leibler distance between the particles and what they stand for, ...
const KLD_ERROR: f64 = 0.1;
/// ... kept with a probability of 99 %: the standard normal quantile.
const KLD_QUANTILE: f64 = 2.326_347_874_040_841;
/// Bins as wide as the basin of refinement.
const BIN_M: f64 = 0.1;
const BINS_PER_TURN: f64 = 72.0;
/// A bin counts if a full set would put half a particle there.
const LEAST_COPIES: f64 = 0.5;
/// Effective share of the particles above which another round would change little.
const SETTLED: f64 = 0.5;

impl Sampling {
    /// How many particles the next round or frame needs.
    pub fn needed(&self, particles: &Particles, weights: &Weights, bins: &mut Bins) -> usize {
        if !self.adaptive {
            return self.particles;
        }
        let fewest = self.fewest.min(self.particles);
        let bins = bins.filled(particles, weights, LEAST_COPIES / self.particles as f64);
        (libm::ceil(kld_bound(bins, KLD_ERROR, KLD_QUANTILE)).min(self.particles as f64) as usize)
            .clamp(fewest, self.particles)
    }

    /// No further round after this one, the `round`-th, is needed.
    pub fn is_settled(&self, round: usize, weights: &Weights) -> bool {
        let settled = weights.effective_sample_size >= SETTLED * weights.shares.len() as f64;
        round >= self.iterations || (self.adaptive && settled)
    }
}

/// Particles that keep the distance below `error`, with the probability of the normal `quantile`, if `bins` are filled
/// (Eq. 7 of the source). None are needed for one bin or less.
pub fn kld_bound(bins: usize, error: f64, quantile: f64) -> f64 {
    if bins <= 1 {
        return 0.0;
    }
    let freedom = (bins - 1) as f64;
    let ninth = 2.0 / (9.0 * freedom);
    let root = 1.0 - ninth + libm::sqrt(ninth) * quantile;
    freedom / (2.0 * error) * root * root * root
}

/// Bins of x, y and yaw, and what they are counted in.
#[derive(Clone, Debug, Default)]
pub struct Bins {
    /// A particle's bin, its number, its share.
    entries: Vec<([i32; 3], u32, f64)>,
}

impl Bins {
    /// Those whose particles have more than `least` of the weight together.
    fn filled(&mut self, particles: &Particles, weights: &Weights, least: f64) -> usize {
        let entries = particles.poses.iter().zip(&weights.shares).zip(0..);
        self.entries.clear();
        self.entries.extend(entries.map(|((pose, share), number)| (bin(pose), number, *share)));
        // Shares are added up in the particles' order.
        self.entries.sort_unstable_by_key(|(bin, number, _)| (*bin, *number));
        let of_bins = self.entries.chunk_by(|a, b| a.0 == b.0);
        of_bins.filter(|bin| bin.iter().map(|(_, _, share)| share).sum::<f64>() >= least).count()
    }
}

fn bin(pose: &Pose2) -> [i32; 3] {
    // Casts saturate, NaN is 0.
    let cell = |x: f64| libm::floor(x) as i32;
    [cell(pose.x / BIN_M), cell(pose.y / BIN_M), cell(pose.yaw / core::f64::consts::TAU * BINS_PER_TURN)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::particles::Spread;
    use crate::weights::normalise;

    #[test]
    fn kld_bound_is_the_known_table_and_none_for_one_bin() {
        // beluga's own test oracle (Ekumen-OS/beluga, fixed-size versus KLD): error 0.01 at 90 % and 99 %.
        let bound = |bins, quantile| libm::ceil(kld_bound(bins, 0.01, quantile)) as usize;
        assert_eq!([3, 7, 100].map(|bins| bound(bins, 1.281_551_565_545)), [228, 531, 5871]);
        assert_eq!([3, 7, 100].map(|bins| bound(bins, KLD_QUANTILE)), [462, 843, 6733]);
        assert_eq!([0, 1].map(|bins| kld_bound(bins, 0.01, KLD_QUANTILE)), [0.0, 0.0]);
        let bounds: Vec<f64> = (0..5000).map(|bins| kld_bound(bins, KLD_ERROR, KLD_QUANTILE)).collect();
        assert!(bounds.is_sorted() && bounds.iter().all(|bound| bound.is_finite()));
    }

    #[test]
    fn a_wider_cloud_needs_more_particles_within_the_limits() {
        let sampling = Sampling { particles: 800, iterations: 5, adaptive: true, fewest: 100 };
        let needed = |xy_m: f64, sampling: &Sampling| {
            let cloud = Particles::around(Pose2::default(), Spread { xy_m, yaw_rad: 0.1 * xy_m }, 800, 1, 0);
            sampling.needed(&cloud, &normalise(&cloud.log_weights), &mut Bins::default())
        };
        let widths = [0.0, 0.01, 0.05, 0.1, 0.2, 1.0];
        let counts = widths.map(|xy_m| needed(xy_m, &sampling));
        assert!(counts.is_sorted(), "{counts:?}");
        assert_eq!((counts[0], counts[5]), (100, 800));
        assert_eq!(needed(0.0, &Sampling { adaptive: false, ..sampling }), 800, "as told");
        assert_eq!(needed(0.0, &Sampling { particles: 7, ..sampling }), 7, "never more than the most");
    }

    #[test]
    fn rounds_go_on_until_the_weights_are_even() {
        let sampling = Sampling { particles: 100, iterations: 5, adaptive: true, fewest: 10 };
        let even = normalise(&[0.0; 100]);
        let mut one = vec![-50.0; 100];
        one[3] = 0.0;
        let one = normalise(&one);
        assert!(sampling.is_settled(1, &even) && !sampling.is_settled(4, &one) && sampling.is_settled(5, &one));
        assert!(!Sampling { adaptive: false, ..sampling }.is_settled(4, &even), "as told");
    }
}
