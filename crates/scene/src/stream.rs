//! Random numbers that depend only on the seed of the scene, their purpose and a sample index. No draw changes another.

/// The purpose of a stream. The numbers determine every recorded scene: never reuse or renumber one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Purpose {
    Carpet = 1,
    Hall = 2,
    GaitSway = 3,
    SensorNoise = 4,
    OdometryError = 5,
    ImuError = 6,
    Obstacles = 7,
    HeadMotion = 8,
    WornLines = 9,
    Ranges = 10,
    SerialNoise = 11,
    CameraFault = 12,
    Turf = 13,
    SunPatches = 14,
}

/// A counter-based random number generator: the n-th number is a hash of key and n.
#[derive(Clone, Debug)]
pub(super) struct Stream {
    key: u64,
    counter: u64,
}

/// 2^64 divided by the golden ratio. Multiplying by it spreads neighbouring counters over all bits.
const GOLDEN: u64 = 0x9E37_79B9_7F4A_7C15;

impl Stream {
    /// The stream of one sample of one purpose.
    pub(super) fn new(seed: u64, purpose: Purpose, index: u64) -> Self {
        let purpose_key = mix(mix(seed.wrapping_add(GOLDEN)) ^ (purpose as u64).wrapping_mul(0xD6E8_FEB8_6659_FD93));
        Self { key: mix(purpose_key.wrapping_add(index.wrapping_mul(GOLDEN))), counter: 0 }
    }

    /// Key of the stream, for loops that count by themselves: [`at`] gives their n-th number, `mix(key + n * GOLDEN)`.
    pub(super) fn key(&self) -> u64 {
        self.key
    }

    pub(super) fn next_u64(&mut self) -> u64 {
        self.counter += 1;
        at(self.key, self.counter)
    }

    /// Uniformly distributed number in [0, 1).
    pub(super) fn uniform(&mut self) -> f64 {
        (self.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    /// Uniformly distributed number x with `low` <= x < `high`.
    pub(super) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Normally distributed number with mean 0 and standard deviation 1, by the Box-Muller transform.
    ///
    /// The argument of the logarithm is never 0.
    pub(super) fn gaussian(&mut self) -> f64 {
        let radius = libm::sqrt(-2.0 * libm::log(1.0 - self.uniform()));
        radius * libm::cos(core::f64::consts::TAU * self.uniform())
    }
}

/// The number at position `counter` of the stream with this key.
#[inline]
pub(super) fn at(key: u64, counter: u64) -> u64 {
    mix(key.wrapping_add(counter.wrapping_mul(GOLDEN)))
}

/// The finalizer of SplitMix64.
#[inline]
fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaussians_have_mean_0_and_deviation_1() {
        let count = 40_000;
        let (mut sum, mut squares) = (0.0, 0.0);
        for index in 0..count {
            let value = Stream::new(7, Purpose::ImuError, index).gaussian();
            sum += value;
            squares += value * value;
        }
        let n = count as f64;
        assert!((sum / n).abs() < 0.02, "{}", sum / n);
        assert!((squares / n - 1.0).abs() < 0.03, "{}", squares / n);
    }

    #[test]
    fn every_part_of_the_key_matters() {
        let first = |seed, purpose, index| Stream::new(seed, purpose, index).next_u64();
        let base = first(1, Purpose::Hall, 0);
        assert_eq!(base, first(1, Purpose::Hall, 0));
        assert_ne!(base, first(2, Purpose::Hall, 0));
        assert_ne!(base, first(1, Purpose::Carpet, 0));
        assert_ne!(base, first(1, Purpose::Hall, 1));
    }
}
