//! A calibrated lens, and how far each part of its image can be trusted.

use realitysim_geometry::{LensError, LensParameters};
use realitysim_localization::smoothing::projection::{CellBias, ImageGrid, difference_px, uncertainty_px};
use realitysim_localization::smoothing::{CONSTANTS, ConstantsCovariance};

/// Largest standard deviations with which a constant counts as determined, in the order of
/// [`NAMES`](realitysim_localization::smoothing::NAMES): what moves a line by a pixel or a tag by a centimetre.
pub(super) const NEEDED: [f64; CONSTANTS] =
    [0.005, 1.5, 1.5, 0.01, 0.0035, 0.0035, 0.008, 0.004, 0.006, 0.004, 0.002, 0.004, 0.03, 0.02, 0.02];

/// A lens as found, with maps over its image.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibratedLens {
    /// The lens.
    pub lens: LensParameters,
    /// Root mean square of the residuals, pixels.
    pub rms_px: f64,
    /// Cells of the maps.
    pub grid: ImageGrid,
    /// Uncertainty of projection, by cell, pixels; `None` outside of what the lens sees.
    pub uncertainty_px: Vec<Option<f64>>,
    /// Difference of the lenses that two halves of the data give, by cell, pixels.
    pub difference_px: Vec<Option<f64>>,
    /// The difference that the uncertainties of both halves allow: their sum, by cell, pixels.
    pub allowed_px: Vec<Option<f64>>,
    /// Bias of the residuals, by cell.
    pub bias: Vec<CellBias>,
}

impl CalibratedLens {
    /// Makes the maps of a lens. `halves` are the lenses that both halves of the data give.
    pub(super) fn new(
        (lens, covariance): (LensParameters, &ConstantsCovariance),
        halves: [(LensParameters, &ConstantsCovariance); 2],
        rms_px: f64,
        bias: impl FnOnce(&ImageGrid) -> Vec<CellBias>,
    ) -> Result<Self, LensError> {
        let grid = ImageGrid::new(&lens);
        let [(first, by_first), (second, by_second)] = halves;
        let one = uncertainty_px(&first, by_first, &grid)?;
        let other = uncertainty_px(&second, by_second, &grid)?;
        Ok(Self {
            rms_px,
            uncertainty_px: uncertainty_px(&lens, covariance, &grid)?,
            difference_px: difference_px(&first, &second, &grid)?,
            allowed_px: one.iter().zip(&other).map(|(one, other)| Some((*one)? + (*other)?)).collect(),
            bias: bias(&grid),
            lens,
            grid,
        })
    }
}
