//! What the uncertainty of the paint adds to the covariance of a pose: lines are not painted exactly where the field's description has
//! them.

use nalgebra::{Matrix6, SMatrix, SVector};

use super::{ErrorCovariance, UNKNOWNS};

/// Standard deviation of where a line, as a whole, is painted beside its place in the field's description, metres. It is a
/// consider parameter, as in Schmidt's filter: no frame can tell it from an error of the pose, so it is not solved for, but
/// it counts in the covariance.
pub(super) const PAINT_M: f64 = 0.001;
/// Number of lines whose displacements are kept apart; further ones share the last.
pub(super) const LINES_APART: usize = 32;
/// For each line, the gradient of the cost by the unknowns for each metre that the line is displaced sideways.
pub(super) type Pulls<const N: usize> = [SVector<f64, N>; LINES_APART];

/// Covariance of the pose's error because lines are painted beside their place: each line moves the solution on its own.
pub(super) fn covariance<const N: usize>(
    pulls: &Pulls<N>,
    weight: f64,
    inverse: &SMatrix<f64, N, N>,
    spread: &ErrorCovariance,
) -> Matrix6<f64> {
    let mut covariance = Matrix6::zeros();
    for pull in pulls.iter().filter(|pull| pull.norm_squared() > 0.0) {
        let moved = inverse * (inverse.tr_mul(pull) * (weight * PAINT_M));
        let moved = (spread * moved.fixed_rows::<UNKNOWNS>(0)).fixed_rows::<6>(0).into_owned();
        covariance += moved * moved.transpose();
    }
    covariance
}
