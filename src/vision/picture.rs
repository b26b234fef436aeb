//! A decoded picture: luma, and chroma where there is colour.

/// Row by row from the top left; chroma is empty for a gray picture, else one (Cb, Cr) per pixel, 128 is neutral.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    pub width: usize,
    pub height: usize,
    pub luma: Vec<u8>,
    pub chroma: Vec<[u8; 2]>,
}

impl Picture {
    /// `None` if the number of bytes does not fit the size.
    pub fn from_gray(width: usize, height: usize, luma: Vec<u8>) -> Option<Self> {
        (luma.len() == width.checked_mul(height)? && !luma.is_empty()).then(|| Self {
            width,
            height,
            luma,
            chroma: Vec::new(),
        })
    }

    /// From interleaved Y, Cb, Cr as a JPEG holds them.
    pub fn from_ycbcr(width: usize, height: usize, pixels: &[u8]) -> Option<Self> {
        if pixels.is_empty() || pixels.len() != width.checked_mul(height)?.checked_mul(3)? {
            return None;
        }
        let (luma, chroma) = pixels.chunks_exact(3).map(|p| (p[0], [p[1], p[2]])).unzip();
        Some(Self { width, height, luma, chroma })
    }

    /// From interleaved R, G, B (JFIF's conversion, in integers).
    pub fn from_rgb(width: usize, height: usize, pixels: &[u8]) -> Option<Self> {
        if pixels.is_empty() || pixels.len() != width.checked_mul(height)?.checked_mul(3)? {
            return None;
        }
        let (luma, chroma) = pixels.chunks_exact(3).map(|p| ycbcr(p[0], p[1], p[2])).unzip();
        Some(Self { width, height, luma, chroma })
    }

    /// Interleaved R, G, B (JFIF's conversion).
    pub fn to_rgb(&self) -> Vec<u8> {
        let level = |value: f32| (value + 0.5).clamp(0.0, 255.0) as u8;
        let neutral = [128u8; 2];
        (self.luma.iter().enumerate())
            .flat_map(|(i, y)| {
                let [cb, cr] = self.chroma.get(i).unwrap_or(&neutral).map(|c| f32::from(c) - 128.0);
                let y = f32::from(*y);
                [level(y + 1.402 * cr), level(y - 0.344_136 * cb - 0.714_136 * cr), level(y + 1.772 * cb)]
            })
            .collect()
    }

    /// Averages `factor` x `factor` blocks; what does not fill a block at the right and lower edge is left out.
    pub fn reduced(&self, factor: usize) -> std::borrow::Cow<'_, Picture> {
        if factor <= 1 || self.width < factor || self.height < factor {
            return std::borrow::Cow::Borrowed(self);
        }
        let (width, height) = (self.width / factor, self.height / factor);
        let area = (factor * factor) as u32;
        let block_mean = |value: &dyn Fn(usize) -> u8, u: usize, v: usize| {
            let mut sum = area / 2;
            for dv in 0..factor {
                for du in 0..factor {
                    sum += u32::from(value((v * factor + dv) * self.width + u * factor + du));
                }
            }
            (sum / area) as u8
        };
        let pixels = || (0..height).flat_map(|v| (0..width).map(move |u| (u, v)));
        let luma = pixels().map(|(u, v)| block_mean(&|i| self.luma[i], u, v)).collect();
        let chroma = if self.chroma.is_empty() {
            Vec::new()
        } else {
            pixels().map(|(u, v)| [0, 1].map(|channel| block_mean(&|i| self.chroma[i][channel], u, v))).collect()
        };
        std::borrow::Cow::Owned(Picture { width, height, luma, chroma })
    }
}

fn ycbcr(r: u8, g: u8, b: u8) -> (u8, [u8; 2]) {
    let (r, g, b) = (i32::from(r), i32::from(g), i32::from(b));
    let half = 1 << 15;
    let y = (19595 * r + 38470 * g + 7471 * b + half) >> 16;
    let cb = (-11059 * r - 21709 * g + 32768 * b + (128 << 16) + half - 1) >> 16;
    let cr = (32768 * r - 27439 * g - 5329 * b + (128 << 16) + half - 1) >> 16;
    (y as u8, [cb as u8, cr as u8])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gray_has_neutral_chroma_and_green_has_little_of_both() {
        let p = Picture::from_rgb(2, 1, &[77, 77, 77, 0, 255, 0]).expect("two pixels");
        assert_eq!((p.luma[0], p.chroma[0]), (77, [128, 128]));
        assert_eq!((p.luma[1], p.chroma[1]), (150, [44, 21]));
    }

    #[test]
    fn rgb_comes_back_within_rounding() {
        let rgb = [200, 30, 90, 0, 255, 0, 17, 18, 19, 255, 255, 255];
        let back = Picture::from_rgb(4, 1, &rgb).expect("four pixels").to_rgb();
        assert!(rgb.iter().zip(&back).all(|(a, b)| a.abs_diff(*b) <= 2), "{back:?}");
    }

    #[test]
    fn a_wrong_size_is_no_picture() {
        assert_eq!(Picture::from_rgb(2, 2, &[0; 11]), None);
        assert_eq!(Picture::from_gray(0, 0, vec![]), None);
        assert_eq!(Picture::from_gray(usize::MAX, 3, vec![1]), None);
    }

    #[test]
    fn reduction_averages_blocks() {
        let p = Picture::from_gray(4, 2, vec![0, 4, 10, 10, 8, 4, 10, 11]).expect("eight pixels");
        assert_eq!(p.reduced(2).luma, vec![4, 10]);
        assert_eq!(p.reduced(1).luma, p.luma);
        assert_eq!(p.reduced(3).luma, p.luma, "smaller than one block: left as it is");
    }
}
