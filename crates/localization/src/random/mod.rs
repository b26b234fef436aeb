//! Counter-based random numbers: a draw depends on (seed, purpose, frame, iteration, particle) only, not on the order or thread
//! in which draws are made.
//!
//! The generator is Philox4x32-10: Salmon, Moraes, Dror and Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC 2011.

mod quantile;

use core::convert::Infallible;

use rand::TryRng;

use realitysim_geometry::multiversioned;

/// What random numbers are drawn for; each purpose has streams of its own under one seed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Purpose {
    /// Particles around an initial pose.
    Start = 0,
    /// Errors of odometry.
    Motion = 1,
    /// Noise between the rounds of a frame.
    Jitter = 2,
    /// Choice of the particles that are copied.
    Resampling = 3,
}

/// A short stream of random numbers for one particle in one step.
#[derive(Clone, Debug)]
pub struct Stream {
    key: [u32; 2],
    counter: [u32; 4],
    block: [u32; 4],
    used: usize,
}

/// Number of particles whose random numbers are drawn together.
pub const TOGETHER: usize = 64;

/// Three standard normal numbers for each of [`TOGETHER`] particles from index `first` on: the first three of each particle's [`Stream`].
pub fn normals(seed: u64, purpose: Purpose, frame: u64, iteration: u32, first: u32) -> [[f64; TOGETHER]; 3] {
    let Stream { key, counter, .. } = Stream::new(seed, purpose, frame, iteration, first);
    let [xs, ys, zs] = multiversioned!(|key: [u32; 2], counter: [u32; 4]| -> [[f64; TOGETHER]; 3] {
        let mut counters =
            [[counter[0]; TOGETHER], [counter[1]; TOGETHER], [counter[2]; TOGETHER], [counter[3]; TOGETHER]];
        for (i, index) in counters[0].iter_mut().enumerate() {
            *index = index.wrapping_add(i as u32);
        }
        let [xs, ys, zs, _] = philox4x32_10(counters, key);
        let mut uniforms = [[0.0; TOGETHER]; 3];
        for (uniforms, words) in uniforms.iter_mut().zip([&xs, &ys, &zs]) {
            for (uniform, word) in uniforms.iter_mut().zip(words) {
                *uniform = uniform_of(*word);
            }
        }
        uniforms
    });
    [quantile::normals(&xs), quantile::normals(&ys), quantile::normals(&zs)]
}

impl Stream {
    /// Opens the stream of a key. `frame` counts the filter's steps, `index` is that of a particle, or 0.
    pub fn new(seed: u64, purpose: Purpose, frame: u64, iteration: u32, index: u32) -> Self {
        let key = [seed as u32, (seed >> 32) as u32];
        // Blocks within a stream are counted in the iteration's upper half: 65536 iterations, 65536 blocks.
        let counter = [index, (iteration & 0xffff) | ((purpose as u32) << 29), frame as u32, (frame >> 32) as u32];
        Self { key, counter, block: [0; 4], used: 4 }
    }

    /// Draws a number uniform in (0, 1): never 0, so that its logarithm exists.
    pub fn uniform(&mut self) -> f64 {
        uniform_of(self.word())
    }

    /// Draws a standard normal number: the quantile of a uniform one.
    pub fn normal(&mut self) -> f64 {
        quantile::normal(self.uniform())
    }

    /// Draws an integer uniform in 0..bound, with a bias of 2^-64 at most.
    pub fn below(&mut self, bound: u64) -> u64 {
        let word = (u64::from(self.word()) << 32) | u64::from(self.word());
        ((u128::from(word) * u128::from(bound)) >> 64) as u64
    }

    /// The next 32 bits.
    fn word(&mut self) -> u32 {
        if self.used == 4 {
            self.block = philox4x32_10(self.counter.map(|word| [word]), self.key).map(|[word]| word);
            self.counter[1] = self.counter[1].wrapping_add(1 << 16);
            self.used = 0;
        }
        self.used += 1;
        self.block[self.used - 1]
    }
}

/// Lets the distributions of `rand` draw from a stream.
impl TryRng for Stream {
    type Error = Infallible;

    fn try_next_u32(&mut self) -> Result<u32, Infallible> {
        Ok(self.word())
    }

    fn try_next_u64(&mut self) -> Result<u64, Infallible> {
        Ok(u64::from(self.word()) | (u64::from(self.word()) << 32))
    }

    fn try_fill_bytes(&mut self, bytes: &mut [u8]) -> Result<(), Infallible> {
        for chunk in bytes.chunks_mut(4) {
            let word = self.word().to_le_bytes();
            chunk.copy_from_slice(&word[..chunk.len()]);
        }
        Ok(())
    }
}

/// The middle of the `word`-th of 2^32 equal parts of (0, 1).
#[inline(always)]
fn uniform_of(word: u32) -> f64 {
    (f64::from(word) + 0.5) / 4_294_967_296.0
}

/// Ten rounds of Philox for N counters side by side.
#[inline(always)]
fn philox4x32_10<const N: usize>(mut counters: [[u32; N]; 4], mut key: [u32; 2]) -> [[u32; N]; 4] {
    for _ in 0..10 {
        let [a, b, c, d] = &mut counters;
        for i in 0..N {
            let low = u64::from(a[i]) * 0xD251_1F53;
            let high = u64::from(c[i]) * 0xCD9E_8D57;
            (a[i], c[i]) = ((high >> 32) as u32 ^ b[i] ^ key[0], (low >> 32) as u32 ^ d[i] ^ key[1]);
            (b[i], d[i]) = (high as u32, low as u32);
        }
        key = [key[0].wrapping_add(0x9E37_79B9), key[1].wrapping_add(0xBB67_AE85)];
    }
    counters
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The answers are those of Random123's `kat_vectors`.
    #[test]
    fn known_answers_of_random123() {
        let philox4x32_10 = |counter: [u32; 4], key| philox4x32_10(counter.map(|word| [word]), key).map(|[word]| word);
        assert_eq!(philox4x32_10([0; 4], [0; 2]), [0x6627e8d5, 0xe169c58d, 0xbc57ac4c, 0x9b00dbd8]);
        assert_eq!(philox4x32_10([u32::MAX; 4], [u32::MAX; 2]), [0x408f276d, 0x41c83b0e, 0xa20bc7c6, 0x6d5451fd]);
        let pi = [0x243f6a88, 0x85a308d3, 0x13198a2e, 0x03707344];
        assert_eq!(philox4x32_10(pi, [0xa4093822, 0x299f31d0]), [0xd16cfe09, 0x94fdcceb, 0x5001e420, 0x24126ea1]);
    }

    #[test]
    fn normal_numbers_have_mean_0_and_variance_1() {
        let n = 20_000;
        let draws: Vec<f64> = (0..n).map(|i| Stream::new(7, Purpose::Motion, 3, 0, i).normal()).collect();
        let mean = draws.iter().sum::<f64>() / draws.len() as f64;
        let variance = draws.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / draws.len() as f64;
        assert!(mean.abs() < 0.02 && (variance - 1.0).abs() < 0.03, "{mean} {variance}");
    }

    #[test]
    fn numbers_drawn_together_are_those_of_each_stream() {
        let [xs, ys, zs] = normals(7, Purpose::Jitter, 5, 2, 100);
        for i in 0..TOGETHER {
            let mut stream = Stream::new(7, Purpose::Jitter, 5, 2, 100 + i as u32);
            assert_eq!([xs[i], ys[i], zs[i]], [stream.normal(), stream.normal(), stream.normal()]);
        }
    }

    #[test]
    fn streams_differ_in_every_coordinate() {
        let first = |s: &mut Stream| s.below(u64::MAX);
        let base = first(&mut Stream::new(1, Purpose::Motion, 2, 3, 4));
        for mut other in [
            Stream::new(2, Purpose::Motion, 2, 3, 4),
            Stream::new(1, Purpose::Jitter, 2, 3, 4),
            Stream::new(1, Purpose::Motion, 3, 3, 4),
            Stream::new(1, Purpose::Motion, 2, 4, 4),
            Stream::new(1, Purpose::Motion, 2, 3, 5),
        ] {
            assert_ne!(first(&mut other), base);
        }
    }
}
