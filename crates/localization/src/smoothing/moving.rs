//! Where a frame's camera is and how it moves, and how both are changed.

use glam::DVec3;
use nalgebra::Vector6;

use super::Frame;
use super::chain::Own;
use crate::refinement::moved_pose;
use realitysim_geometry::{Isometry, Twist};

/// A moving camera: what is looked for of a frame. Its unknowns are the six of the pose's error, and how much farther it goes along its
/// own axes, and turns about them, from the first row's time to the last's than is told.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Moving {
    pub(super) pose: Isometry,
    twist: Twist,
    /// Metres and radians, of the whole readout.
    pub(super) farther: Twist,
}

impl Moving {
    /// As tagged.
    pub(super) fn of(frame: &Frame) -> Self {
        Self { pose: frame.map_from_optical, twist: frame.twist, farther: Twist::ZERO }
    }

    pub(super) fn at_pose(&self, pose: Isometry) -> Self {
        Self { pose, ..*self }
    }

    pub(super) fn moved(&self, by: &Own) -> Self {
        let pose: Vector6<f64> = by.fixed_rows::<6>(0).into();
        let [way, turn] = [6, 9].map(|first| DVec3::new(by[first], by[first + 1], by[first + 2]));
        let farther = Twist { linear: self.farther.linear + way, angular: self.farther.angular + turn };
        Self { pose: moved_pose(&self.pose, &pose), farther, ..*self }
    }

    /// Where it is when a row is exposed, that being a share of the readout after the middle one.
    pub(super) fn at(&self, row: f64, readout_s: f64) -> Isometry {
        let Twist { linear, angular } = self.twist;
        let whole = Twist {
            linear: linear * readout_s + self.farther.linear,
            angular: angular * readout_s + self.farther.angular,
        };
        whole.carries(&self.pose, row)
    }
}
