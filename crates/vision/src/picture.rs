//! Decoded pictures: luma, and chroma at half the resolution if there is colour.

use realitysim_geometry::multiversioned;

/// A decoded picture, row by row from the top left.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Picture {
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// Luma of each pixel, `width` x `height`.
    pub luma: Vec<u8>,
    /// Chroma; empty for a gray picture.
    pub chroma: Chroma,
}

/// Chroma planes with one value for each 2 x 2 pixels, as JPEG and cameras have them; 128 is neutral.
///
/// A plane has half the columns and rows of the luma, rounded up.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Chroma {
    /// Cb, row by row.
    pub blue: Vec<u8>,
    /// Cr, row by row.
    pub red: Vec<u8>,
}

impl Clone for Chroma {
    fn clone(&self) -> Self {
        Self { blue: self.blue.clone(), red: self.red.clone() }
    }

    /// Copies into the existing buffers.
    fn clone_from(&mut self, other: &Self) {
        self.blue.clone_from(&other.blue);
        self.red.clone_from(&other.red);
    }
}

impl Chroma {
    /// Whether there is no colour.
    pub fn is_empty(&self) -> bool {
        self.blue.is_empty()
    }
}

/// The buffers of [`Picture::reduced`], kept from frame to frame.
#[derive(Clone, Debug, Default)]
pub struct Reduction {
    picture: Picture,
    sums: Vec<u16>,
}

impl Picture {
    /// Makes a gray picture; `None` if it is empty or the number of bytes does not fit the size.
    pub fn from_gray(width: usize, height: usize, luma: Vec<u8>) -> Option<Self> {
        let fits = luma.len() == width.checked_mul(height)? && !luma.is_empty();
        fits.then(|| Self { width, height, luma, chroma: Chroma::default() })
    }

    /// Makes a picture from interleaved Y, Cb, Cr as a JPEG holds them; `None` if it is empty or the number of bytes does not fit the size.
    pub fn from_ycbcr(width: usize, height: usize, pixels: &[u8]) -> Option<Self> {
        Self::from_triples(width, height, pixels, |p| *p)
    }

    /// Makes a picture from interleaved R, G, B (JFIF's conversion, in integers); `None` as in [`Self::from_ycbcr`].
    pub fn from_rgb(width: usize, height: usize, pixels: &[u8]) -> Option<Self> {
        Self::from_triples(width, height, pixels, |p| ycbcr(p[0], p[1], p[2]))
    }

    /// Makes a picture from interleaved triples, each converted by `ycbcr`; chroma is averaged over 2 x 2 pixels.
    fn from_triples(width: usize, height: usize, pixels: &[u8], ycbcr: impl Fn(&[u8; 3]) -> [u8; 3]) -> Option<Self> {
        if pixels.is_empty() || pixels.len() != width.checked_mul(height)?.checked_mul(3)? {
            return None;
        }
        let (triples, _) = pixels.as_chunks::<3>();
        let luma = triples.iter().map(|p| ycbcr(p)[0]).collect();
        let half = width.div_ceil(2);
        let blocks = half * height.div_ceil(2);
        let (mut blue, mut red) = (vec![0; blocks], vec![0; blocks]);
        let rows = blue.chunks_exact_mut(half).zip(red.chunks_exact_mut(half));
        for (pair, (blue, red)) in triples.chunks(2 * width).zip(rows) {
            let (upper, lower) = pair.split_at(width);
            // The last row or column of an odd number is paired with itself.
            let lower = if lower.is_empty() { upper } else { lower };
            for ((a, b), (blue, red)) in upper.chunks(2).zip(lower.chunks(2)).zip(blue.iter_mut().zip(red)) {
                let [a0, a1, b0, b1] = [&a[0], &a[a.len() - 1], &b[0], &b[b.len() - 1]].map(&ycbcr);
                let mean = |c: usize| {
                    ((u16::from(a0[c]) + u16::from(a1[c]) + u16::from(b0[c]) + u16::from(b1[c]) + 2) / 4) as u8
                };
                (*blue, *red) = (mean(1), mean(2));
            }
        }
        let chroma = Chroma { blue, red };
        Some(Self { width, height, luma, chroma })
    }

    /// The picture as interleaved R, G, B (JFIF's conversion).
    pub fn to_rgb(&self) -> Vec<u8> {
        let level = |value: f32| (value + 0.5).clamp(0.0, 255.0) as u8;
        let half = self.width.div_ceil(2);
        (self.luma.iter().enumerate())
            .flat_map(|(i, y)| {
                let at = i / self.width / 2 * half + i % self.width / 2;
                let centred = |plane: &[u8]| f32::from(plane.get(at).copied().unwrap_or(128)) - 128.0;
                let (cb, cr) = (centred(&self.chroma.blue), centred(&self.chroma.red));
                let y = f32::from(*y);
                [level(y + 1.402 * cr), level(y - 0.344_136 * cb - 0.714_136 * cr), level(y + 1.772 * cb)]
            })
            .collect()
    }

    /// Averages blocks of `factor` x `factor` pixels, `factor` up to 8, into a smaller picture.
    ///
    /// Pixels at the right and lower edge that do not fill a block are left out. A factor of 1, or one that is larger than the picture,
    /// returns the picture itself.
    pub fn reduced<'a>(&'a self, factor: usize, into: &'a mut Reduction) -> &'a Picture {
        if factor <= 1 || self.width < factor || self.height < factor {
            return self;
        }
        let Reduction { picture, sums } = into;
        let (width, height) = (self.width / factor, self.height / factor);
        (picture.width, picture.height) = (width, height);
        reduce(&self.luma, [self.width, self.height], [width, height], factor, &mut picture.luma, sums);
        let from = [self.width.div_ceil(2), self.height.div_ceil(2)];
        let to = if self.chroma.is_empty() { [0, 0] } else { [width.div_ceil(2), height.div_ceil(2)] };
        reduce(&self.chroma.blue, from, to, factor, &mut picture.chroma.blue, sums);
        reduce(&self.chroma.red, from, to, factor, &mut picture.chroma.red, sums);
        picture
    }
}

/// Averages blocks of a plane of size `from` into one of size `to` (columns, rows); a block over the edge averages the pixels that exist.
fn reduce(plane: &[u8], from: [usize; 2], to: [usize; 2], factor: usize, into: &mut Vec<u8>, sums: &mut Vec<u16>) {
    into.resize(to[0] * to[1], 0);
    sums.resize(from[0], 0);
    if into.is_empty() {
        return;
    }
    match factor {
        2 => reduce_by::<2>(plane, from, to, into, sums),
        3 => reduce_by::<3>(plane, from, to, into, sums),
        4 => reduce_by::<4>(plane, from, to, into, sums),
        5 => reduce_by::<5>(plane, from, to, into, sums),
        6 => reduce_by::<6>(plane, from, to, into, sums),
        7 => reduce_by::<7>(plane, from, to, into, sums),
        _ => reduce_by::<8>(plane, from, to, into, sums),
    }
}

/// Does the work of [`reduce`] for one factor, so that the compiler turns the division by a constant into a multiplication.
fn reduce_by<const FACTOR: usize>(plane: &[u8], from: [usize; 2], to: [usize; 2], into: &mut [u8], sums: &mut [u16]) {
    let mean = |sum: usize, count: usize| ((sum + count / 2) / count.max(1)) as u8;
    for (v, target) in into.chunks_exact_mut(to[0]).enumerate() {
        let rows = &plane[v * FACTOR * from[0]..((v + 1) * FACTOR).min(from[1]) * from[0]];
        let height = rows.len() / from[0];
        let (whole, rest) = target.split_at_mut(if height == FACTOR { (from[0] / FACTOR).min(to[0]) } else { 0 });
        let first = whole.len();
        let row_length = from[0];
        multiversioned!(const FACTOR: usize, |rows: &[u8], row_length: usize, whole: &mut [u8], sums: &mut [u16]| {
            sums.fill(0);
            for row in rows.chunks_exact(row_length) {
                for (sum, value) in sums.iter_mut().zip(row) {
                    *sum += u16::from(*value);
                }
            }
            for (value, sums) in whole.iter_mut().zip(sums.as_chunks::<FACTOR>().0) {
                let sum: u16 = sums.iter().sum();
                let count = (FACTOR * FACTOR) as u16;
                *value = ((sum + count / 2) / count) as u8;
            }
        });
        for (u, value) in rest.iter_mut().enumerate() {
            let columns = (first + u) * FACTOR..((first + u + 1) * FACTOR).min(from[0]);
            let sum = sums[columns.clone()].iter().map(|sum| usize::from(*sum)).sum();
            *value = mean(sum, columns.len() * height);
        }
    }
}

/// Converts R, G, B to Y, Cb, Cr: JFIF's conversion in 16-bit fixed point.
fn ycbcr(r: u8, g: u8, b: u8) -> [u8; 3] {
    let (r, g, b) = (i32::from(r), i32::from(g), i32::from(b));
    let half = 1 << 15;
    let y = (19595 * r + 38470 * g + 7471 * b + half) >> 16;
    let cb = (-11059 * r - 21709 * g + 32768 * b + (128 << 16) + half - 1) >> 16;
    let cr = (32768 * r - 27439 * g - 5329 * b + (128 << 16) + half - 1) >> 16;
    [y as u8, cb as u8, cr as u8]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gray_has_neutral_chroma_and_green_has_little_of_both() {
        let gray = Picture::from_rgb(1, 1, &[77, 77, 77]).expect("a pixel");
        assert_eq!((gray.luma, gray.chroma), (vec![77], Chroma { blue: vec![128], red: vec![128] }));
        let green = Picture::from_rgb(1, 1, &[0, 255, 0]).expect("a pixel");
        assert_eq!((green.luma, green.chroma), (vec![150], Chroma { blue: vec![44], red: vec![21] }));
    }

    #[test]
    fn rgb_comes_back_within_rounding_where_neighbours_share_a_colour() {
        let rows = [[[200, 30, 90], [200, 30, 90], [17, 18, 19]]; 3];
        let rgb: Vec<u8> = rows.iter().flatten().flatten().copied().collect();
        let back = Picture::from_rgb(3, 3, &rgb).expect("nine pixels").to_rgb();
        assert!(rgb.iter().zip(&back).all(|(a, b)| a.abs_diff(*b) <= 2), "{back:?}");
    }

    #[test]
    fn chroma_is_that_of_two_by_two_pixels() {
        let p = Picture::from_ycbcr(3, 2, &[0, 10, 0, 0, 20, 0, 0, 90, 5, 0, 30, 0, 0, 40, 0, 0, 70, 7])
            .expect("six pixels");
        assert_eq!(p.chroma, Chroma { blue: vec![25, 80], red: vec![0, 6] });
    }

    #[test]
    fn a_wrong_size_is_no_picture() {
        assert_eq!(Picture::from_rgb(2, 2, &[0; 11]), None);
        assert_eq!(Picture::from_gray(0, 0, vec![]), None);
        assert_eq!(Picture::from_gray(usize::MAX, 3, vec![1]), None);
    }

    #[test]
    fn reduction_is_the_rounded_mean_of_each_block_for_every_factor_and_size() {
        for factor in 2..=8usize {
            for (width, height) in [(64usize, 48usize), (37, 29), (8, 9), (5, 17)] {
                let luma: Vec<u8> = (0..width * height).map(|i| (i * 7919 % 256) as u8).collect();
                let to = [width.div_ceil(factor), height.div_ceil(factor)];
                let (mut small, mut sums) = (Vec::new(), Vec::new());
                reduce(&luma, [width, height], to, factor, &mut small, &mut sums);
                let to_end = |at: usize, end: usize| at * factor..((at + 1) * factor).min(end);
                for (i, value) in small.iter().enumerate() {
                    let (u, v) = (i % to[0], i / to[0]);
                    let block: Vec<u32> = to_end(v, height)
                        .flat_map(|row| to_end(u, width).map(move |column| row * width + column))
                        .map(|at| u32::from(luma[at]))
                        .collect();
                    let count = block.len() as u32;
                    assert_eq!(u32::from(*value), (block.iter().sum::<u32>() + count / 2) / count, "{factor} {u} {v}");
                }
            }
        }
    }

    #[test]
    fn reduction_averages_blocks() {
        let p = Picture::from_gray(4, 2, vec![0, 4, 10, 10, 8, 4, 10, 11]).expect("eight pixels");
        let mut reduction = Reduction::default();
        assert_eq!(p.reduced(2, &mut reduction).luma, vec![4, 10]);
        assert_eq!(p.reduced(1, &mut reduction).luma, p.luma);
        assert_eq!(p.reduced(3, &mut reduction).luma, p.luma, "smaller than one block: left as it is");
        let coloured = Picture::from_rgb(7, 5, &[90; 105]).expect("35 pixels");
        let small = coloured.reduced(2, &mut reduction);
        assert_eq!((small.width, small.height, small.chroma.blue.len()), (3, 2, 2));
    }
}
