//! The robot's own body in its camera's view.

use glam::DVec2;

/// Which pixels of the full-size image show the robot itself; these count as not seen.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BodyMask {
    width: usize,
    height: usize,
    hidden: Vec<bool>,
}

impl BodyMask {
    /// Dark pixels of a gray image of the camera's size hide, bright ones (128 and more) show.
    pub fn from_gray(width: usize, height: usize, gray: &[u8]) -> Option<Self> {
        (gray.len() == width.checked_mul(height)?).then(|| Self {
            width,
            height,
            hidden: gray.iter().map(|value| *value < 128).collect(),
        })
    }

    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    pub fn hides(&self, pixel: DVec2) -> bool {
        let (u, v) = (libm::round(pixel.x), libm::round(pixel.y));
        let inside = u >= 0.0 && v >= 0.0 && u < self.width as f64 && v < self.height as f64;
        inside && self.hidden[v as usize * self.width + u as usize]
    }
}
