//! A mask of the robot's own body in its camera's view.

use glam::DVec2;

/// The pixels of the full-size image that show the robot itself. They count as not seen.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BodyMask {
    width: usize,
    height: usize,
    hidden: Vec<bool>,
}

impl BodyMask {
    /// Makes a mask from a gray image of the camera's size: dark pixels (below 128) hide the ground, bright ones show it.
    ///
    /// `None` if the number of bytes does not fit the size.
    pub fn from_gray(width: usize, height: usize, gray: &[u8]) -> Option<Self> {
        (gray.len() == width.checked_mul(height)?).then(|| Self {
            width,
            height,
            hidden: gray.iter().map(|value| *value < 128).collect(),
        })
    }

    /// Encodes the mask as run lengths, the form that a session keeps.
    ///
    /// The numbers alternate between pixels that show and that hide the ground, row by row, beginning with those that show.
    pub fn runs(&self) -> Vec<u32> {
        let (mut runs, mut hides) = (vec![0], false);
        for hidden in &self.hidden {
            if *hidden != hides {
                runs.push(0);
                hides = *hidden;
            }
            runs.last_mut().into_iter().for_each(|run| *run += 1);
        }
        runs
    }

    /// Decodes the run lengths of [`Self::runs`]; `None` if they do not add up to the number of pixels.
    pub fn from_runs(width: usize, height: usize, runs: &[u32]) -> Option<Self> {
        let count = width.checked_mul(height)?;
        if runs.iter().map(|run| u64::from(*run)).sum::<u64>() != count as u64 {
            return None;
        }
        let of_each = runs.iter().enumerate().map(|(index, run)| (index % 2 == 1, *run as usize));
        let hidden = of_each.flat_map(|(hides, run)| core::iter::repeat_n(hides, run)).collect();
        Some(Self { width, height, hidden })
    }

    /// The mask as a gray image like that of [`Self::from_gray`]: 0 hides, 255 shows.
    pub fn to_gray(&self) -> Vec<u8> {
        self.hidden.iter().map(|hidden| if *hidden { 0 } else { 255 }).collect()
    }

    /// Width and height, pixels.
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// Whether the body hides the ground at a pixel; false outside the image.
    pub fn hides(&self, pixel: DVec2) -> bool {
        let (u, v) = (libm::round(pixel.x), libm::round(pixel.y));
        let inside = u >= 0.0 && v >= 0.0 && u < self.width as f64 && v < self.height as f64;
        inside && self.hidden[v as usize * self.width + u as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn runs_are_the_mask(gray in proptest::collection::vec(any::<bool>(), 35)) {
            let gray: Vec<u8> = gray.into_iter().map(|shows| if shows { 255 } else { 0 }).collect();
            let mask = BodyMask::from_gray(7, 5, &gray).expect("fits");
            prop_assert_eq!(BodyMask::from_runs(7, 5, &mask.runs()), Some(mask.clone()));
            prop_assert_eq!(mask.to_gray(), gray);
            prop_assert_eq!(BodyMask::from_runs(7, 4, &mask.runs()), None);
        }
    }
}
