//! A summary of a picture: a fingerprint that tells it from others, and whether it is exposed well enough to show anything.

use super::Picture;
use realitysim_geometry::multiversioned;

/// The summary of a picture, from every eighth row.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ImageSummary {
    /// Hash of the luma. Noise makes it differ between any two pictures of a live camera.
    pub fingerprint: u64,
    /// Largest luma.
    pub brightest: u8,
    /// Number of pixels that are brighter than those of a covered lens.
    pub lit: u32,
    /// Number of pixels that are at the end of the scale.
    pub clipped: u32,
}

/// Step between the rows that are looked at.
const ROW_STEP: usize = 8;
/// Largest luma of a covered lens, and of the corners that a fisheye leaves black.
const DARK: u8 = 16;
/// Smallest luma that counts as the end of the scale.
const CLIPPED: u8 = 250;

/// The reason why a picture shows nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageDefect {
    /// The picture is black.
    TooDark,
    /// More than half of the lit pixels are at the end of the scale.
    Overexposed,
}

impl ImageSummary {
    /// Summarises a picture.
    pub fn of(picture: &Picture) -> Self {
        let mut summary = Self::default();
        for row in picture.luma.chunks_exact(picture.width.max(1)).step_by(ROW_STEP) {
            summary.add(row);
            summary.fingerprint = fingerprint(summary.fingerprint, row);
        }
        summary
    }

    /// Counts the pixels of a row.
    fn add(&mut self, row: &[u8]) {
        let (brightest, lit, clipped) = multiversioned!(|row: &[u8]| -> (u8, u32, u32) {
            let (mut brightest, mut lit, mut clipped) = (0, 0, 0);
            for luma in row {
                brightest = brightest.max(*luma);
                lit += u32::from(*luma > DARK);
                clipped += u32::from(*luma >= CLIPPED);
            }
            (brightest, lit, clipped)
        });
        self.brightest = self.brightest.max(brightest);
        self.lit += lit;
        self.clipped += clipped;
    }

    /// The reason why the picture shows nothing, if it obviously does not.
    pub fn defect(&self) -> Option<ImageDefect> {
        if self.brightest <= DARK {
            Some(ImageDefect::TooDark)
        } else if 2 * self.clipped > self.lit {
            Some(ImageDefect::Overexposed)
        } else {
            None
        }
    }
}

/// Continues a hash with a row: FNV-1a, but eight bytes at a time.
fn fingerprint(start: u64, row: &[u8]) -> u64 {
    const PRIME: u64 = 0x0000_0100_0000_01b3;
    const OFFSET: u64 = 0xcbf2_9ce4_8422_2325;
    let (words, rest) = row.as_chunks::<8>();
    let mixed = words.iter().fold(start ^ OFFSET, |hash, word| (hash ^ u64::from_le_bytes(*word)).wrapping_mul(PRIME));
    rest.iter().fold(mixed, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(PRIME))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(luma: impl Fn(usize) -> u8) -> Picture {
        Picture::from_gray(37, 20, (0..37 * 20).map(luma).collect()).expect("fits")
    }

    #[test]
    fn one_pixel_of_a_row_that_is_looked_at_is_told() {
        let one = ImageSummary::of(&picture(|i| (i % 200) as u8));
        let other = ImageSummary::of(&picture(|i| if i == 8 * 37 + 36 { 0 } else { (i % 200) as u8 }));
        assert_ne!(one.fingerprint, other.fingerprint);
        assert_eq!(one, ImageSummary::of(&picture(|i| (i % 200) as u8)));
    }

    #[test]
    fn black_and_white_pictures_are_named_and_others_are_not() {
        assert_eq!(ImageSummary::of(&picture(|i| (i % 10) as u8)).defect(), Some(ImageDefect::TooDark));
        assert_eq!(
            ImageSummary::of(&picture(|i| if i % 5 == 0 { 0 } else { 255 })).defect(),
            Some(ImageDefect::Overexposed)
        );
        assert_eq!(ImageSummary::of(&picture(|i| if i % 3 == 0 { 255 } else { 60 })).defect(), None);
        assert_eq!(ImageSummary::of(&picture(|i| if i % 3 == 0 { 20 } else { 0 })).defect(), None, "a dim one");
    }
}
