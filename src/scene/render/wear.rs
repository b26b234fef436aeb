//! How much of the paint is left where.

use super::super::effects::WornLines;
use super::super::stream::Purpose;
use super::footprint::GroundPoint;
use super::tile::Tile;

#[derive(Clone, Debug)]
pub(super) struct Wear {
    share: f32,
    patches: Tile,
}

/// Texels of the tile's largest features.
const PATCH_TEXELS: f64 = 128.0;
/// The tile's values are 128 +- about this.
const SPREAD: f32 = 40.0;

impl Wear {
    pub(super) fn new(effect: &WornLines, seed: u64) -> Self {
        let patches = Tile::new(seed, Purpose::WornLines, (PATCH_TEXELS / effect.patch_m) as f32);
        Self { share: effect.share as f32, patches }
    }

    /// 1 where the paint is new. Linear in the noise between its bounds, so that the mean holds from afar too.
    // Never: what few scenes have shall not crowd the pixel loop.
    #[inline(never)]
    pub(super) fn left(&self, p: &GroundPoint) -> f32 {
        let noise = (self.patches.sample(p.x, p.y, 0.5 * p.size2) - 128.0) / SPREAD;
        (1.0 - self.share * (1.0 + noise)).clamp(0.0, 1.0)
    }
}
