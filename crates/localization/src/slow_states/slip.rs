//! Detection of feet that slip and of odometry that stands still: lines and odometry disagree in frame after frame, by less than
//! a single frame shows.
//!
//! The deviation by which the lines move the predicted pose has a known covariance: the prior's less the refined pose's. Such
//! deviations are independent from frame to frame if the prediction is right (the innovations of a Kalman filter are white).
//! Their sum, along the robot's axes and in standard deviations, then grows as the root of their number. If odometry is
//! wrong, it grows with the number itself.

use nalgebra::{Matrix2, Vector2};
use serde::{Deserialize, Serialize};

use super::super::refinement::{Prior, Refined};
use realitysim_geometry::Physical;

/// Exponentially weighted sum of the frames' deviations from the prediction, in standard deviations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Slip {
    /// The sum, forwards and to the left.
    sum: [f64; 2],
    /// Variance of the sum if the deviations are independent.
    variance: f64,
}

/// Factor by which the sum fades from frame to frame. The variance of the sum stays below four.
const FADE_FACTOR: f64 = 0.85;
/// Squared standard deviations of the sum beyond which it is a slip: three in a million sums of independent deviations exceed it.
const SLIP_THRESHOLD: f64 = 25.0;
/// The covariance of a deviation is increased by this share of the prior's, for frames whose lines say hardly anything.
const MIN_TOLD_SHARE: f64 = 0.05;

impl Slip {
    /// Adds the deviation of a frame in which the robot has this heading, and returns whether the sum shows a slip.
    pub(super) fn update(&mut self, yaw_rad: f64, prior: &Prior, refined: &Refined) -> bool {
        let [before, after] =
            [&prior.covariance, &refined.covariance].map(|all| -> Matrix2<f64> { all.fixed_view::<2, 2>(0, 0).into() });
        let (sin, cos) = libm::sincos(yaw_rad);
        let into_robot = Matrix2::new(cos, sin, -sin, cos);
        let told = into_robot * (before - after + before * MIN_TOLD_SHARE) * into_robot.transpose();
        let moved = into_robot * Vector2::new(refined.moved[0], refined.moved[1]);
        let Some(own) = told.cholesky().and_then(|factor| factor.l().solve_lower_triangular(&moved)) else {
            return false;
        };
        self.variance = FADE_FACTOR * FADE_FACTOR * self.variance + 1.0;
        self.sum = [0, 1].map(|axis| FADE_FACTOR * self.sum[axis] + own[axis]);
        let [ahead, aside] = self.sum;
        (ahead * ahead + aside * aside) / self.variance > SLIP_THRESHOLD
    }
}

impl Physical for Slip {
    fn is_possible(&self) -> bool {
        self.sum.iter().all(|sum| sum.is_finite()) && (0.0..4.0).contains(&self.variance)
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use nalgebra::{Matrix6, Vector6};

    use super::super::super::random::{Purpose, Stream};
    use super::super::super::refinement::{Agreement, Errors};
    use super::*;
    use realitysim_geometry::Isometry;

    /// A frame known to 1 cm before looking and to 6 mm after, which the lines moved by `x` and `y` metres.
    fn moved(x: f64, y: f64) -> (Prior, Refined) {
        let pose = Isometry::new(glam::DQuat::IDENTITY, DVec3::Z);
        let prior = Prior::of_pose(pose, &Matrix6::from_diagonal(&Vector6::repeat(1e-4)));
        let mut moved = Errors::zeros();
        (moved[0], moved[1]) = (x, y);
        let refined = Refined {
            map_from_optical: pose,
            covariance: prior.covariance * 0.36,
            by_paint: Matrix6::zeros(),
            moved,
            condition: 1.0,
            cost: 0.0,
            lines: Agreement::default(),
        };
        (prior, refined)
    }

    /// Standard deviation of what a frame moves: sqrt(1 - 0.36) cm.
    const SIGMA_M: f64 = 0.008;

    #[test]
    fn deviations_as_the_covariances_say_are_taken_for_no_slip() {
        let mut certain = 0;
        for seed in 0..200 {
            let mut slip = Slip::default();
            for frame in 0..500 {
                let draw = |axis| SIGMA_M * Stream::new(seed, Purpose::Start, frame, axis, 0).normal();
                let (prior, refined) = moved(draw(0), draw(1));
                certain += u32::from(slip.update(0.3 * frame as f64, &prior, &refined));
            }
            assert!(slip.is_possible());
        }
        assert!(certain < 10, "{certain} of 100000 frames");
    }

    #[test]
    fn small_deviations_to_one_side_become_a_slip_after_some_frames() {
        for (share, within) in [(2.0, 10), (3.0, 4), (4.0, 3)] {
            // A robot that turns while it walks.
            let mut slip = Slip::default();
            let found = (0..within).any(|frame| {
                let yaw_rad = 0.1 * f64::from(frame);
                let (sin, cos) = yaw_rad.sin_cos();
                let (prior, refined) = moved(share * SIGMA_M * cos, share * SIGMA_M * sin);
                slip.update(yaw_rad, &prior, &refined)
            });
            assert!(found, "{share} standard deviations, {within} frames");
        }
    }
}
