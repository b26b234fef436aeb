//! Worn paint: the share of paint that remains at each point.

use super::super::effects::WornLines;
use super::super::stream::Purpose;
use super::footprint::GroundPoint;
use super::tile::{REACH, Tile};

/// Wear of the lines, prepared for the pixel loop.
#[derive(Clone, Debug)]
pub(super) struct Wear {
    /// Average share of the paint that is gone.
    share: f32,
    patches: Tile,
}

/// Size of the tile's largest features, texels.
const PATCH_TEXELS: f64 = 128.0;

impl Wear {
    pub(super) fn new(effect: &WornLines, seed: u64) -> Self {
        let patches = Tile::new(seed, Purpose::WornLines, (PATCH_TEXELS / effect.patch_m) as f32);
        Self { share: effect.share as f32, patches }
    }

    /// Share of the paint that remains, from 0 to 1 (new).
    ///
    /// It is linear in the noise between its bounds, so that the mean is also right at a distance. The amplitude is the
    /// share that is gone or the one that remains, whichever is smaller, so that neither bound cuts off more than the other.
    // Never inlined: an effect that few scenes have must not slow the pixel loop.
    #[inline(never)]
    pub(super) fn remaining_paint(&self, p: &GroundPoint) -> f32 {
        self.remaining_at(p.x, p.y, p.size2)
    }

    fn remaining_at(&self, x: f32, y: f32, size2: f32) -> f32 {
        let noise = (self.patches.sample(x, y, 0.5 * size2) - 128.0) / REACH;
        let left =
            if self.share <= 0.5 { 1.0 - self.share * (1.0 + noise) } else { (1.0 - self.share) * (1.0 - noise) };
        left.clamp(0.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_stated_share_of_paint_is_gone_on_average() {
        for share in [0.1, 0.3, 0.5, 0.7, 0.9, 1.0] {
            let wear = Wear::new(&WornLines { role: None, share, patch_m: 0.2 }, 3);
            let places = (0..200).flat_map(|row| (0..200).map(move |column| (row as f32 * 0.03, column as f32 * 0.03)));
            let left: Vec<f64> = places.map(|(x, y)| f64::from(wear.remaining_at(x, y, 1e-6))).collect();
            let mean = left.iter().sum::<f64>() / left.len() as f64;
            assert!((mean - (1.0 - share)).abs() < 0.06, "{share} gone, {mean} left");
            assert!(share < 1.0 || left.iter().all(|left| *left == 0.0), "none is left");
        }
    }
}
