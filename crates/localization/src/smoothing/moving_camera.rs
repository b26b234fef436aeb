//! The pose and motion of a frame's camera, and how a step changes them.

use glam::DVec3;
use nalgebra::Vector6;

use super::Frame;
use super::chain::FrameVector;
use crate::refinement::moved_pose;
use realitysim_geometry::{Isometry, Twist};

/// The unknowns of a frame: the six of its pose's error, and how much farther than told its camera goes along its own axes, and
/// turns about them, between the first row's time and the last's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct MovingCamera {
    pub(super) pose: Isometry,
    /// Velocity as told by feet, neck and gyro.
    twist: Twist,
    /// Additional motion over the whole readout, metres and radians.
    pub(super) extra_motion: Twist,
}

impl MovingCamera {
    /// The frame as tagged, without additional motion.
    pub(super) fn of(frame: &Frame) -> Self {
        Self { pose: frame.map_from_optical, twist: frame.twist, extra_motion: Twist::ZERO }
    }

    /// The same motion at another pose.
    pub(super) fn at_pose(&self, pose: Isometry) -> Self {
        Self { pose, ..*self }
    }

    /// The state after a step.
    pub(super) fn moved(&self, by: &FrameVector) -> Self {
        let pose: Vector6<f64> = by.fixed_rows::<6>(0).into();
        let [way, turn] = [6, 9].map(|first| DVec3::new(by[first], by[first + 1], by[first + 2]));
        let extra_motion = Twist { linear: self.extra_motion.linear + way, angular: self.extra_motion.angular + turn };
        Self { pose: moved_pose(&self.pose, &pose), extra_motion, ..*self }
    }

    /// The pose when a row is exposed; `row` is its time after the middle row as a share of the readout.
    pub(super) fn at(&self, row: f64, readout_s: f64) -> Isometry {
        let Twist { linear, angular } = self.twist;
        let whole = Twist {
            linear: linear * readout_s + self.extra_motion.linear,
            angular: angular * readout_s + self.extra_motion.angular,
        };
        whole.carries(&self.pose, row)
    }
}
