//! What refinement measures lines in: the picture's luma at working resolution, and where it shows no floor.

use super::WorkingScale;
use super::carpet::Surface;
use super::picture::Picture;

#[derive(Clone, Debug, Default, PartialEq)]
pub struct LineImage {
    width: usize,
    height: usize,
    luma: Vec<u8>,
    /// Of half-resolution pixels.
    pub(super) surfaces: Vec<Surface>,
    scale: WorkingScale,
    /// Gray levels by which a line of the best width stands out of the carpet; infinite if none does.
    full_contrast: f32,
}

impl LineImage {
    pub(super) fn fill(&mut self, working: &Picture, scale: WorkingScale, full_contrast: f32) {
        (self.width, self.height) = (working.width, working.height);
        self.luma.clone_from(&working.luma);
        (self.scale, self.full_contrast) = (scale, full_contrast);
    }

    pub fn full_contrast(&self) -> f32 {
        self.full_contrast
    }

    /// Full-size image coordinates to those of this image.
    pub fn scale(&self) -> WorkingScale {
        self.scale
    }

    /// Luma between pixels, in this image's coordinates; `None` outside.
    pub fn luma(&self, u: f32, v: f32) -> Option<f32> {
        // NaN fails both.
        if !(u >= 0.0 && v >= 0.0 && u < (self.width - 1) as f32 && v < (self.height - 1) as f32) {
            return None;
        }
        let (column, row) = (u as usize, v as usize);
        let (fu, fv) = (u - column as f32, v - row as f32);
        let at = row * self.width + column;
        let upper = &self.luma[at..at + 2];
        let lower = &self.luma[at + self.width..at + self.width + 2];
        let blend = |pair: &[u8]| f32::from(pair[0]) + (f32::from(pair[1]) - f32::from(pair[0])) * fu;
        let (a, b) = (blend(upper), blend(lower));
        Some(a + (b - a) * fv)
    }

    /// Whether something stands between camera and floor there (a robot, a person, the own body), or the place lies outside.
    pub fn hides(&self, u: f32, v: f32) -> bool {
        if !(u >= 0.0 && v >= 0.0) {
            return true;
        }
        let (column, row) = (u as usize / 2, v as usize / 2);
        let width = self.width / 2;
        column >= width || self.surfaces.get(row * width + column).is_none_or(|surface| *surface == Surface::Other)
    }
}
