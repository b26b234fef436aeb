//! Colour images with a mask value for each pixel, and their pyramids.

use super::figures::Figures;
use realitysim_vision::distance::nearest;

/// A colour image with a mask: red, green, blue and mask value of each pixel.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Raster {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// Row by row from the top left: red, green, blue, and [`SURE`], [`UNSURE`] or [`NOTHING`].
    pub pixels: Vec<[u8; 4]>,
}

/// Mask value of a pixel that shows what it should: known geometry, or a recorded image.
pub const SURE: u8 = 255;
/// Mask value of a pixel beyond the ground: of the hall, or of what stands before it at an unknown distance; in a recorded image, of
/// what stands on the carpet ([`super::mark_moving`]).
pub const UNSURE: u8 = 128;
/// Mask value of a black pixel: no source shows it, or the lens draws nothing there.
pub const NOTHING: u8 = 0;

impl Raster {
    /// An image in which all pixels are black and show nothing.
    pub fn black(width: usize, height: usize) -> Self {
        Self { width, height, pixels: vec![[0, 0, 0, NOTHING]; width * height] }
    }

    /// An image from interleaved R, G, B. `shows` says for each pixel whether it shows the world; others lie outside of the
    /// lens's circle or show the robot's own body. `None` if the lengths do not fit the size.
    pub fn from_rgb(width: usize, height: usize, rgb: &[u8], shows: &[bool]) -> Option<Self> {
        let count = width.checked_mul(height)?;
        if count == 0 || rgb.len() != count.checked_mul(3)? || shows.len() != count {
            return None;
        }
        let (triples, _) = rgb.as_chunks::<3>();
        let pixel = |([r, g, b], shows): (&[u8; 3], &bool)| [*r, *g, *b, if *shows { SURE } else { NOTHING }];
        Some(Self { width, height, pixels: triples.iter().zip(shows).map(pixel).collect() })
    }

    /// The colours as interleaved R, G, B.
    pub fn to_rgb(&self) -> Vec<u8> {
        self.pixels.iter().flat_map(|[r, g, b, _]| [*r, *g, *b]).collect()
    }

    /// The mask: [`SURE`], [`UNSURE`] or [`NOTHING`] for each pixel.
    pub fn mask(&self) -> Vec<u8> {
        self.pixels.iter().map(|pixel| pixel[3]).collect()
    }

    /// Whether bilinear reading finds four neighbours everywhere, with indices that fit 32 bits.
    #[cfg(target_arch = "x86_64")]
    pub(super) fn is_readable(&self) -> bool {
        self.width >= MIN_SIDE
            && self.height >= MIN_SIDE
            && self.pixels.len() == self.width * self.height
            && self.pixels.len() <= i32::MAX as usize
    }

    /// A copy of half the size: means of 2 x 2 pixels, sure only if all four are.
    fn halved(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let mut pixels = Vec::with_capacity(width * height);
        for rows in self.pixels.chunks_exact(2 * self.width).take(height) {
            let (upper, lower) = rows.split_at(self.width);
            for (a, b) in upper.chunks_exact(2).zip(lower.chunks_exact(2)) {
                let four = [a[0], a[1], b[0], b[1]];
                let mean = |c: usize| ((four.iter().map(|p| u32::from(p[c])).sum::<u32>() + 2) / 4) as u8;
                let sure = if four.iter().all(|p| p[3] == SURE) { SURE } else { NOTHING };
                pixels.push([mean(0), mean(1), mean(2), sure]);
            }
        }
        Self { width, height, pixels }
    }
}

/// An image with copies of a half, a quarter and an eighth of its size, for views that shrink it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pyramid {
    levels: Vec<Raster>,
    figures: Figures,
    has_moving: bool,
    inset: Inset,
}

/// For blocks of 8 x 8 pixels: the distance to the nearest pixel that shows nothing (outside the lens's circle, or the
/// robot's body). Empty if every pixel shows something.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct Inset {
    columns: usize,
    blocks_px: Vec<u8>,
}

/// Number of sizes in a pyramid.
pub(super) const LEVELS: usize = 4;
/// Bilinear reading needs two pixels in each direction.
const MIN_SIDE: usize = 2;
/// Side of a block, pixels.
const BLOCK: usize = 8;
/// Distances are looked for up to this many blocks.
const INSET_BLOCKS: usize = 3;

impl Pyramid {
    /// Computes the smaller copies of `full`, an image without figures.
    pub fn new(full: Raster) -> Self {
        Self::with_figures(full, Figures::default())
    }

    /// Computes the smaller copies of `full`, which shows these figures.
    pub fn with_figures(full: Raster, figures: Figures) -> Self {
        let has_moving = full.pixels.iter().any(|pixel| pixel[3] == UNSURE);
        let inset = Inset::new(&full);
        let mut levels = vec![full];
        while levels.len() < LEVELS
            && let Some(finer) = levels.last().filter(|l| l.width >= 2 * MIN_SIDE && l.height >= 2 * MIN_SIDE)
        {
            let next = finer.halved();
            levels.push(next);
        }
        Self { levels, figures, has_moving, inset }
    }

    /// The figures that the image shows.
    pub(super) fn figures(&self) -> &Figures {
        &self.figures
    }

    /// Approximate distance in pixels to the nearest pixel that shows nothing; infinite if there is none within three blocks.
    pub(super) fn inset_px(&self, u: usize, v: usize) -> f32 {
        let Inset { columns, blocks_px } = &self.inset;
        let block = v / BLOCK * columns + u / BLOCK;
        blocks_px.get(block).filter(|px| **px < u8::MAX).map_or(f32::INFINITY, |px| f32::from(*px))
    }

    /// Whether any pixel is [`UNSURE`].
    pub(super) fn has_moving(&self) -> bool {
        self.has_moving
    }

    /// The image in full size.
    pub fn full(&self) -> &Raster {
        &self.levels[0]
    }

    /// The copy that is 2^`level` times smaller, or the smallest one, with its level.
    pub(super) fn level(&self, level: usize) -> (&Raster, usize) {
        let level = level.min(self.levels.len() - 1);
        (&self.levels[level], level)
    }

    /// Memory of the pixels, bytes.
    pub fn bytes(&self) -> usize {
        self.levels.iter().map(|level| 4 * level.pixels.len()).sum()
    }
}

impl Inset {
    fn new(full: &Raster) -> Self {
        let [columns, rows] = [full.width, full.height].map(|side| side.div_ceil(BLOCK));
        let mut hidden = vec![false; columns * rows];
        for (v, row) in full.pixels.chunks_exact(full.width.max(1)).enumerate() {
            for (block, pixels) in hidden[v / BLOCK * columns..][..columns].iter_mut().zip(row.chunks(BLOCK)) {
                *block |= pixels.iter().any(|pixel| pixel[3] == NOTHING);
            }
        }
        if !hidden.contains(&true) {
            return Self::default();
        }
        // From the middle of this block to the nearer side of the hidden one.
        let px = |blocks: f32| match blocks {
            far if far > INSET_BLOCKS as f32 => u8::MAX,
            blocks => ((blocks - 0.5).max(0.0) * BLOCK as f32) as u8,
        };
        let blocks = nearest(&hidden, columns, rows, INSET_BLOCKS);
        Self { columns, blocks_px: blocks.into_iter().map(px).collect() }
    }
}

/// Brightness of a pixel (red, green, blue and mask), 0 to 255, with the weights of ITU-R BT.601.
pub fn luma([red, green, blue, _]: [u8; 4]) -> u8 {
    ((77 * u32::from(red) + 150 * u32::from(green) + 29 * u32::from(blue)) >> 8) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_that_do_not_fit_are_refused() {
        assert_eq!(Raster::from_rgb(2, 2, &[0; 12], &[true; 3]), None);
        assert_eq!(Raster::from_rgb(2, 2, &[0; 11], &[true; 4]), None);
        assert_eq!(Raster::from_rgb(0, 2, &[], &[]), None);
    }

    #[test]
    fn a_smaller_copy_is_the_mean_and_knows_what_it_does_not_show() {
        let rgb: Vec<u8> = (0..16u8).flat_map(|i| [i * 10, 7, 0]).collect();
        let mut shows = [true; 16];
        shows[15] = false;
        let pyramid = Pyramid::new(Raster::from_rgb(4, 4, &rgb, &shows).expect("fits"));
        let (half, level) = pyramid.level(1);
        assert_eq!((half.width, half.height, level), (2, 2, 1));
        assert_eq!(half.pixels[0], [25, 7, 0, SURE]);
        assert_eq!(half.pixels[3][3], NOTHING);
        assert_eq!(pyramid.level(9).1, 1, "2 x 2 is the smallest");
    }
}
