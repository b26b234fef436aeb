//! Feet that slip, or odometry that stands still: lines and odometry tell of different walks, frame after frame, by less than a single frame
//! shows.
//!
//! What the lines move the predicted pose by has a known covariance, that of the prior less that of the refined pose, and is independent from
//! frame to frame if the prediction is what it claims to be (the innovations of a Kalman filter are white). Their sum, each
//! in units of its standard deviation and along the robot's axes, grows by chance as the root of their number; if odometry is wrong
//! it grows with the number itself.

use nalgebra::{Matrix2, Vector2};
use serde::{Deserialize, Serialize};

use super::super::refinement::{Prior, Refined};
use realitysim_geometry::Physical;

/// The latest frames' deviations from the prediction, forwards and to the left, in standard deviations, each counted less than the one after it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Slip {
    sum: [f64; 2],
    /// Of the sum, if the deviations are independent.
    variance: f64,
}

/// What a frame counts one frame later. The variance of the sum stays below four.
const FADES: f64 = 0.85;
/// Squared standard deviations of the sum: three in a million sums of independent ones exceed it.
const CERTAIN: f64 = 25.0;
/// Where lines tell hardly anything the covariance of what they move is taken for this share of the prior's.
const LEAST_TOLD: f64 = 0.05;

impl Slip {
    /// Takes in a frame's deviation, of a robot with this heading (rad), and judges by all so far.
    pub(super) fn note(&mut self, yaw_rad: f64, prior: &Prior, refined: &Refined) -> bool {
        let [before, after] =
            [&prior.covariance, &refined.covariance].map(|all| -> Matrix2<f64> { all.fixed_view::<2, 2>(0, 0).into() });
        let (sin, cos) = libm::sincos(yaw_rad);
        let into_robot = Matrix2::new(cos, sin, -sin, cos);
        let told = into_robot * (before - after + before * LEAST_TOLD) * into_robot.transpose();
        let moved = into_robot * Vector2::new(refined.moved[0], refined.moved[1]);
        let Some(own) = told.cholesky().and_then(|factor| factor.l().solve_lower_triangular(&moved)) else {
            return false;
        };
        self.variance = FADES * FADES * self.variance + 1.0;
        self.sum = [0, 1].map(|axis| FADES * self.sum[axis] + own[axis]);
        let [ahead, aside] = self.sum;
        (ahead * ahead + aside * aside) / self.variance > CERTAIN
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

    /// Known to a centimetre before looking, and to 6 mm after.
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
    const MOVES_M: f64 = 0.008;

    #[test]
    fn deviations_as_the_covariances_say_are_taken_for_no_slip() {
        let mut certain = 0;
        for seed in 0..200 {
            let mut slip = Slip::default();
            for frame in 0..500 {
                let draw = |axis| MOVES_M * Stream::new(seed, Purpose::Start, frame, axis, 0).normal();
                let (prior, refined) = moved(draw(0), draw(1));
                certain += u32::from(slip.note(0.3 * frame as f64, &prior, &refined));
            }
            assert!(slip.is_possible());
        }
        assert!(certain < 10, "{certain} of 100000 frames");
    }

    #[test]
    fn small_deviations_to_one_side_of_the_robot_are_a_slip_after_some_frames() {
        for (share, within) in [(2.0, 10), (3.0, 4), (4.0, 3)] {
            // A robot that turns while it goes.
            let mut slip = Slip::default();
            let found = (0..within).any(|frame| {
                let yaw_rad = 0.1 * f64::from(frame);
                let (sin, cos) = yaw_rad.sin_cos();
                let (prior, refined) = moved(share * MOVES_M * cos, share * MOVES_M * sin);
                slip.note(yaw_rad, &prior, &refined)
            });
            assert!(found, "{share} standard deviations, {within} frames");
        }
    }
}
