//! Random choices of one case: the same for the same seed and number.

use realitysim::localization::random::{Purpose, Stream};

#[derive(Clone, Debug)]
pub struct Draw(Stream);

impl Draw {
    pub fn new(seed: u64, number: u64) -> Self {
        Self(Stream::new(seed, Purpose::Start, number, 0, 0))
    }

    /// 0 if the bound is 0.
    pub fn below(&mut self, bound: usize) -> usize {
        self.0.below(bound.max(1) as u64) as usize
    }

    pub fn chance(&mut self, odds: f64) -> bool {
        self.0.uniform() < odds
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.uniform()
    }

    pub fn one_of<'a, T>(&mut self, of: &'a [T]) -> &'a T {
        &of[self.below(of.len())]
    }

    pub fn byte(&mut self) -> u8 {
        self.below(256) as u8
    }

    pub fn bytes(&mut self, count: usize) -> Vec<u8> {
        (0..count).map(|_| self.byte()).collect()
    }

    /// A number from anywhere in the range of doubles, or one at which formulas break.
    pub fn float(&mut self, now: f64) -> f64 {
        const BREAKING: [f64; 23] = [
            0.0,
            5e-324,
            1e-310,
            2.2250738585072014e-308,
            1e-300,
            1e-160,
            1e-154,
            1e-100,
            1e-38,
            1e-20,
            1e-9,
            1.0,
            1e3,
            1e9,
            1e16,
            1e38,
            1e100,
            1e154,
            1e160,
            1e300,
            f64::MAX,
            f64::INFINITY,
            f64::NAN,
        ];
        let value = match self.below(6) {
            0..=2 => *self.one_of(&BREAKING),
            3 => self.between(-1074.0, 1024.0).exp2(),
            4 => now * self.between(-60.0, 60.0).exp2(),
            _ => now * *self.one_of(&[0.0, -1.0, 1e-160, 1e-8, 0.5, 2.0, 10.0, 1e8, 1e160]),
        };
        if self.chance(0.3) { -value } else { value }
    }

    /// A whole number at an end of a type's range, or near what it is now.
    pub fn whole(&mut self, now: u64, bits: u32) -> u64 {
        let all = u64::MAX >> (64 - bits);
        let half = all >> 1;
        let near = now.wrapping_add(self.below(5) as u64).wrapping_sub(2);
        let low = 1u64 << self.below(bits as usize);
        *self.one_of(&[0, 1, 2, 255, half, half + 1, all, all - 1, near, near, low, low - 1, now ^ low, 1_000_000_000])
            & all
    }
}
