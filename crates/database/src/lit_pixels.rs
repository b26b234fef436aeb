//! Finds the pixels that are never lit in the images of a source.

/// Counts the images in which each pixel is lit.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct LitPixels {
    counts: Vec<u32>,
    images: u32,
}

/// Value (0 to 255) from which a pixel is lit in a bright picture.
const DARK: f64 = 16.0;
/// Share of the picture's brightness from which a pixel is lit in a dark picture.
const DARK_SHARE: f64 = 0.17;
/// Smallest value from which a pixel is lit; the noise of sensors and codecs in black is lower.
const MIN_DARK: f64 = 3.0;
/// One in this many images may light a pixel where the lens draws nothing. The first image of some cameras is gray all over.
const FLASHES: u32 = 50;

impl LitPixels {
    /// Counts the lit pixels of a picture of interleaved R, G, B.
    pub(super) fn add(&mut self, rgb: &[u8]) {
        self.counts.resize(rgb.len() / 3, 0);
        let (triples, _) = rgb.as_chunks::<3>();
        let brightest = |[r, g, b]: &[u8; 3]| *r.max(g).max(b);
        // The mean weighted by the values themselves, because the share of black pixels says nothing about the light.
        let (sum, squares) = triples.iter().map(brightest).fold((0u64, 0u64), |(sum, squares), light| {
            (sum + u64::from(light), squares + u64::from(light) * u64::from(light))
        });
        let light = squares as f64 / sum.max(1) as f64;
        let dark = (DARK_SHARE * light).clamp(MIN_DARK, DARK) as u8;
        for (count, pixel) in self.counts.iter_mut().zip(triples) {
            *count += u32::from(brightest(pixel) >= dark);
        }
        self.images += 1;
    }

    /// Adds the counts of other pictures of the same size.
    pub(super) fn join(&mut self, other: &Self) {
        self.counts.resize(self.counts.len().max(other.counts.len()), 0);
        self.counts.iter_mut().zip(&other.counts).for_each(|(count, more)| *count += more);
        self.images += other.images;
    }

    /// A mask that is black where the images are always dark from the border inwards, and white elsewhere.
    ///
    /// `None` if that is everywhere or nowhere. Dark pixels within the picture are part of the world, such as a bag in a
    /// source of a few images.
    pub(super) fn mask(&self, width: usize) -> Option<Vec<u8>> {
        let (count, width) = (self.counts.len(), width.max(1));
        let mut mask = vec![255; count];
        let is_border =
            |at: &usize| at.is_multiple_of(width) || at % width == width - 1 || *at < width || at + width >= count;
        let is_dark = |at: usize| self.counts[at] <= self.images / FLASHES;
        let mut found: Vec<usize> = (0..count).filter(is_border).collect();
        while let Some(at) = found.pop() {
            if mask[at] == 255 && is_dark(at) {
                mask[at] = 0;
                let beside = [(at % width > 0).then(|| at - 1), (at % width + 1 < width).then_some(at + 1)];
                let above_and_below = [at.checked_sub(width), Some(at + width)];
                found.extend(beside.into_iter().chain(above_and_below).flatten().filter(|near| *near < count));
            }
        }
        (mask.contains(&0) && mask.contains(&255)).then_some(mask)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 8;
    const HEIGHT: usize = 6;

    fn picture(light: impl Fn(usize, usize) -> u8) -> Vec<u8> {
        (0..WIDTH * HEIGHT).flat_map(|at| [light(at % WIDTH, at / WIDTH); 3]).collect()
    }

    fn hidden(lit: &LitPixels) -> Vec<usize> {
        let mask = lit.mask(WIDTH).expect("something is dark, and not all");
        (0..mask.len()).filter(|at| mask[*at] == 0).collect()
    }

    fn corner() -> Vec<usize> {
        (0..WIDTH * HEIGHT).filter(|at| at % WIDTH + at / WIDTH < 3).collect()
    }

    #[test]
    fn only_what_is_dark_from_the_border_inwards_is_left_out() {
        // A corner, and a bag in the middle of the picture.
        let is_dark = |u: usize, v: usize| u + v < 3 || ((4..6).contains(&u) && (2..4).contains(&v));
        let mut lit = LitPixels::default();
        lit.add(&picture(|u, v| if is_dark(u, v) { 3 } else { 90 }));
        assert_eq!(hidden(&lit), corner());
        let mut all = LitPixels::default();
        all.add(&picture(|_, _| 0));
        assert_eq!(all.mask(WIDTH), None);
    }

    #[test]
    fn a_night_is_no_darkness_and_a_flash_no_light() {
        let mut night = LitPixels::default();
        night.add(&picture(|u, v| if u + v < 3 { 1 } else { 9 }));
        assert_eq!(hidden(&night), corner());
        let mut flash = LitPixels::default();
        for image in 0..60 {
            let mut one = LitPixels::default();
            one.add(&picture(|u, v| if u + v < 3 && image != 1 { 3 } else { 128 }));
            flash.join(&one);
        }
        assert_eq!(hidden(&flash), corner());
    }
}
