//! Bias and spread of detections in two dimensions, with the error of the labels taken out.

use glam::{DMat2, DVec2};
use serde::Serialize;

/// Bias and spread in the picture.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PixelError {
    /// Number of detections.
    pub count: usize,
    /// Mean of detection minus landmark, pixels: to the right, down.
    pub bias_px: [f64; 2],
    /// Standard deviation of that mean.
    pub bias_sigma_px: [f64; 2],
    /// Covariance of a detection about the mean, square pixels, without that of the labels. `None` of one detection.
    pub covariance_px2: Option<[[f64; 2]; 2]>,
    /// Mean standard deviation of the labels themselves: root of the mean variance of u and v, pixels.
    pub label_sigma_px: [f64; 2],
}

/// Bias and spread on the ground, in polar coordinates about the foot of the camera.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct GroundError {
    /// Number of detections; one that does not meet the ground has no error there.
    pub count: usize,
    /// Mean error of the bearing, degrees, above 0 to the left.
    pub bearing_bias_deg: f64,
    /// Standard deviation of that mean.
    pub bearing_bias_sigma_deg: f64,
    /// Mean error of the distance, metres.
    pub distance_bias_m: f64,
    /// Standard deviation of that mean.
    pub distance_bias_sigma_m: f64,
    /// Covariance about the mean without that of the labels: bearing and bearing (square degrees), bearing and distance (degrees times
    /// metres), distance and distance (square metres). `None` of one detection.
    pub covariance: Option<[[f64; 2]; 2]>,
    /// Standard deviation of the labels themselves, degrees.
    pub label_sigma_deg: f64,
    /// Standard deviation of the labels themselves, metres.
    pub label_sigma_m: f64,
}

/// Moments of errors in two dimensions.
struct Moments {
    count: usize,
    mean: DVec2,
    sigma_of_mean: DVec2,
    covariance: Option<DMat2>,
    label_sigma: DVec2,
}

impl Moments {
    /// Of errors and the covariances of their labels. The covariance of an error is that of the detection plus that of the label, so
    /// that the mean of the latter is subtracted. `None` of nothing.
    fn of(errors: &[(DVec2, DMat2)]) -> Option<Self> {
        let n = (!errors.is_empty()).then_some(errors.len() as f64)?;
        let mean = errors.iter().map(|(error, _)| *error).sum::<DVec2>() / n;
        let label = errors.iter().fold(DMat2::ZERO, |sum, (_, label)| sum + *label) * (1.0 / n);
        let square = |error: DVec2| DMat2::from_cols(error * error.x, error * error.y);
        let squares = errors.iter().fold(DMat2::ZERO, |sum, (error, _)| sum + square(*error - mean));
        let observed = (errors.len() > 1).then(|| squares * (1.0 / (n - 1.0)));
        let root = |matrix: &DMat2| DVec2::new(matrix.x_axis.x, matrix.y_axis.y).max(DVec2::ZERO).map(libm::sqrt);
        Some(Self {
            count: errors.len(),
            mean,
            sigma_of_mean: observed.map_or(DVec2::ZERO, |observed| root(&observed) / libm::sqrt(n)),
            covariance: observed.map(|observed| nearest_covariance(observed - label)),
            label_sigma: root(&label),
        })
    }

    fn rows(&self) -> Option<[[f64; 2]; 2]> {
        self.covariance.map(|covariance| covariance.to_cols_array_2d())
    }
}

/// A positive semi-definite matrix: variances below 0 become 0, and the correlation is at most 1. It does not depend on units.
fn nearest_covariance(matrix: DMat2) -> DMat2 {
    let (first, second) = (matrix.x_axis.x.max(0.0), matrix.y_axis.y.max(0.0));
    let limit = libm::sqrt(first) * libm::sqrt(second);
    let mixed = matrix.x_axis.y.clamp(-limit, limit);
    DMat2::from_cols_array(&[first, mixed, mixed, second])
}

impl PixelError {
    /// Of errors in pixels, and the covariances of their labels.
    pub fn of(errors: &[(DVec2, DMat2)]) -> Option<Self> {
        Moments::of(errors).map(|moments| Self {
            count: moments.count,
            bias_px: moments.mean.into(),
            bias_sigma_px: moments.sigma_of_mean.into(),
            covariance_px2: moments.rows(),
            label_sigma_px: moments.label_sigma.into(),
        })
    }
}

impl GroundError {
    /// Of errors of bearing (radians) and distance (metres), and the covariances of their labels.
    pub fn of(errors: &[(DVec2, DMat2)]) -> Option<Self> {
        let units = DVec2::new(1f64.to_degrees(), 1.0);
        let scale = DMat2::from_diagonal(units);
        let scaled: Vec<_> = errors.iter().map(|(error, label)| (*error * units, scale * *label * scale)).collect();
        Moments::of(&scaled).map(|moments| Self {
            count: moments.count,
            bearing_bias_deg: moments.mean.x,
            bearing_bias_sigma_deg: moments.sigma_of_mean.x,
            distance_bias_m: moments.mean.y,
            distance_bias_sigma_m: moments.sigma_of_mean.y,
            covariance: moments.rows(),
            label_sigma_deg: moments.label_sigma.x,
            label_sigma_m: moments.label_sigma.y,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_error_of_the_labels_is_taken_out() {
        let label = DMat2::from_diagonal(DVec2::new(1.0, 0.5));
        let errors: Vec<(DVec2, DMat2)> =
            [(3.0, 0.5), (-1.0, 0.5), (3.0, -0.5), (-1.0, -0.5)].map(|error| (DVec2::from(error), label)).into();
        let found = PixelError::of(&errors).unwrap();
        assert_eq!((found.count, found.bias_px), (4, [1.0, 0.0]));
        let [[u, uv], [_, v]] = found.covariance_px2.unwrap();
        assert!((u - (16.0 / 3.0 - 1.0)).abs() < 1e-12 && uv == 0.0, "{u} {uv}");
        // The labels scatter by more than was seen.
        assert_eq!(v, 0.0);
        assert_eq!((PixelError::of(&[]), PixelError::of(&errors[..1]).unwrap().covariance_px2), (None, None));
    }

    proptest! {
        #[test]
        fn a_covariance_is_positive_semi_definite(
            errors in prop::collection::vec((-9.0..9.0f64, -9.0..9.0f64), 2..20),
            sigmas in (0.0..9.0f64, 0.0..9.0f64),
            correlation in -1.0..1.0f64,
        ) {
            let mixed = correlation * sigmas.0 * sigmas.1;
            let label = DMat2::from_cols_array(&[sigmas.0 * sigmas.0, mixed, mixed, sigmas.1 * sigmas.1]);
            let errors: Vec<_> = errors.into_iter().map(|error| (DVec2::from(error), label)).collect();
            let [[a, b], [c, d]] = GroundError::of(&errors).unwrap().covariance.unwrap();
            prop_assert!(a >= 0.0 && d >= 0.0 && b == c && b * b <= a * d * (1.0 + 1e-9));
        }
    }
}
