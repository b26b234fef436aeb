//! How much of the paint is left where.

use super::super::effects::WornLines;
use super::super::stream::Purpose;
use super::footprint::GroundPoint;
use super::tile::{REACH, Tile};

#[derive(Clone, Debug)]
pub(super) struct Wear {
    share: f32,
    patches: Tile,
}

/// Texels of the tile's largest features.
const PATCH_TEXELS: f64 = 128.0;

impl Wear {
    pub(super) fn new(effect: &WornLines, seed: u64) -> Self {
        let patches = Tile::new(seed, Purpose::WornLines, (PATCH_TEXELS / effect.patch_m) as f32);
        Self { share: effect.share as f32, patches }
    }

    /// 1 where the paint is new. Linear in the noise between its bounds, so that the mean holds from afar too; patches vary by what is gone
    /// or left, whichever is less, so that neither bound cuts off more than the other.
    // Never: what few scenes have shall not crowd the pixel loop.
    #[inline(never)]
    pub(super) fn left(&self, p: &GroundPoint) -> f32 {
        self.left_at(p.x, p.y, p.size2)
    }

    fn left_at(&self, x: f32, y: f32, size2: f32) -> f32 {
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
    fn so_much_paint_is_left_as_the_effect_says() {
        for share in [0.1, 0.3, 0.5, 0.7, 0.9, 1.0] {
            let wear = Wear::new(&WornLines { role: None, share, patch_m: 0.2 }, 3);
            let places = (0..200).flat_map(|row| (0..200).map(move |column| (row as f32 * 0.03, column as f32 * 0.03)));
            let left: Vec<f64> = places.map(|(x, y)| f64::from(wear.left_at(x, y, 1e-6))).collect();
            let mean = left.iter().sum::<f64>() / left.len() as f64;
            assert!((mean - (1.0 - share)).abs() < 0.06, "{share} gone, {mean} left");
            assert!(share < 1.0 || left.iter().all(|left| *left == 0.0), "none is left");
        }
    }
}
