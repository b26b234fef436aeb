//! Decides how many particles and how many rounds a frame needs.
//!
//! KLD-sampling (D. Fox, "Adapting the sample size in particle filters through KLD-sampling", IJRR 22, 2003) takes as many
//! particles as keep the error of the sampled distribution below a bound, by the number of bins that it fills.
//! Rounds of weighing and resampling go on until the effective sample size shows that the particles are distributed as the weights are.

use super::particles::Particles;
use super::weights::Weights;
use realitysim_geometry::Pose2;

/// Numbers of particles and of rounds, fixed or adaptive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sampling {
    /// Number of particles, N of the paper; the largest number if [`Self::adaptive`].
    pub particles: usize,
    /// Number of rounds, T of the paper; the largest number if [`Self::adaptive`].
    pub iterations: usize,
    /// Whether fewer particles and rounds are used where they suffice.
    pub adaptive: bool,
    /// Smallest number of particles if [`Self::adaptive`].
    pub fewest: usize,
}

/// Bound of the Kullback-Leibler distance between the particles and the distribution that they represent.
const KLD_ERROR: f64 = 0.1;
/// Standard normal quantile of the probability with which that bound is kept: 99 %.
const KLD_QUANTILE: f64 = 2.326_347_874_040_841;
/// Width of a bin in x and y, metres: that of the basin of refinement.
const BIN_M: f64 = 0.1;
/// Number of bins in yaw.
const BINS_PER_TURN: f64 = 72.0;
/// A bin counts if a full set would put this many particles there.
const MIN_COPIES: f64 = 0.5;
/// Effective sample size, as a share of the particles, above which another round would change little.
const SETTLED_SHARE: f64 = 0.5;

impl Sampling {
    /// Number of particles that the next round or frame needs.
    pub fn needed(&self, particles: &Particles, weights: &Weights, bins: &mut Bins) -> usize {
        if !self.adaptive {
            return self.particles;
        }
        let fewest = self.fewest.min(self.particles);
        let bins = bins.filled(particles, weights, MIN_COPIES / self.particles as f64);
        (libm::ceil(kld_bound(bins, KLD_ERROR, KLD_QUANTILE)).min(self.particles as f64) as usize)
            .clamp(fewest, self.particles)
    }

    /// Whether no round is needed after the `round`-th, counted from 1.
    pub fn is_settled(&self, round: usize, weights: &Weights) -> bool {
        let settled = weights.effective_sample_size >= SETTLED_SHARE * weights.shares.len() as f64;
        round >= self.iterations || (self.adaptive && settled)
    }
}

/// Number of particles that keep the Kullback-Leibler distance below `error`, with the probability of the normal `quantile`,
/// if `bins` are filled (Eq. 7 of the source); 0 for one bin or less.
pub fn kld_bound(bins: usize, error: f64, quantile: f64) -> f64 {
    if bins <= 1 {
        return 0.0;
    }
    let freedom = (bins - 1) as f64;
    let ninth = 2.0 / (9.0 * freedom);
    let root = 1.0 - ninth + libm::sqrt(ninth) * quantile;
    freedom / (2.0 * error) * root * root * root
}

/// Counts bins of x, y and yaw, in a buffer that is kept.
#[derive(Clone, Debug, Default)]
pub struct Bins {
    /// Bin, number and share of the weight of each particle.
    entries: Vec<([i32; 3], u32, f64)>,
}

impl Bins {
    /// Number of bins whose particles together have at least the share `least` of the weight.
    fn filled(&mut self, particles: &Particles, weights: &Weights, least: f64) -> usize {
        let entries = particles.poses.iter().zip(&weights.shares).zip(0..);
        self.entries.clear();
        self.entries.extend(entries.map(|((pose, share), number)| (bin(pose), number, *share)));
        // Within a bin shares are added in the particles' order, so that the sum is always the same.
        self.entries.sort_unstable_by_key(|(bin, number, _)| (*bin, *number));
        let of_bins = self.entries.chunk_by(|a, b| a.0 == b.0);
        of_bins.filter(|bin| bin.iter().map(|(_, _, share)| share).sum::<f64>() >= least).count()
    }
}

/// The bin that a pose lies in.
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
