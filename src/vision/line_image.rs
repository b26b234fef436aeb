//! What refinement measures lines in: the picture's luma at working resolution, and where it shows no floor.

use glam::DVec2;

use super::WorkingScale;
use super::carpet::Surface;
use super::contrast::LineContrast;
use super::mask::BodyMask;
use super::picture::Picture;

#[derive(Clone, Debug, PartialEq)]
pub struct LineImage {
    width: usize,
    height: usize,
    luma: Vec<u8>,
    /// Half-resolution pixels that show a robot, a person, the own body, or nothing.
    hidden: Vec<bool>,
    scale: WorkingScale,
    /// Gray levels by which a line of the best width stands out of the carpet; infinite if none does.
    full_contrast: f32,
}

impl LineImage {
    pub(super) fn new(
        working: &Picture,
        contrast: &LineContrast,
        scale: WorkingScale,
        body: Option<&BodyMask>,
        full_contrast: f32,
    ) -> Self {
        let (half_width, half_height) = (working.width / 2, working.height / 2);
        let mut hidden: Vec<bool> = contrast.surfaces.iter().map(|surface| *surface == Surface::Other).collect();
        hidden.resize(half_width * half_height, true);
        if let Some(body) = body {
            for (index, hidden) in hidden.iter_mut().enumerate() {
                let (u, v) = (index % half_width, index / half_width);
                let pixel = DVec2::new(2.0 * u as f64 + 0.5, 2.0 * v as f64 + 0.5);
                *hidden |= body.hides(scale.undo(pixel));
            }
        }
        let luma = working.luma.clone();
        Self { width: working.width, height: working.height, luma, hidden, scale, full_contrast }
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

    /// Whether something stands between camera and floor there, or nothing is shown at all.
    pub fn hides(&self, u: f32, v: f32) -> bool {
        if !(u >= 0.0 && v >= 0.0) {
            return true;
        }
        let (column, row) = (u as usize / 2, v as usize / 2);
        let width = self.width / 2;
        column >= width || self.hidden.get(row * width + column).copied().unwrap_or(true)
    }
}
