//! Where a frame's camera is and how it moves, and how both are changed.

use glam::DVec3;
use nalgebra::Vector6;

use super::Frame;
use super::chain::Own;
use crate::geometry::{Isometry, Twist};
use crate::localization::refinement::moved_pose;

/// A moving camera: what is looked for of a frame. Its unknowns are the six of the pose's error, and the way that it goes in a second
/// which nothing tells of, along its own axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Moving {
    pub(super) pose: Isometry,
    pub(super) twist: Twist,
}

impl Moving {
    /// As tagged.
    pub(super) fn of(frame: &Frame) -> Self {
        Self { pose: frame.map_from_optical, twist: frame.twist }
    }

    pub(super) fn moved(&self, by: &Own) -> Self {
        let faster = DVec3::new(by[6], by[7], by[8]);
        let pose: Vector6<f64> = by.fixed_rows::<6>(0).into();
        let twist = Twist { linear: self.twist.linear + faster, ..self.twist };
        Self { pose: moved_pose(&self.pose, &pose), twist }
    }

    /// Where it is some seconds later.
    pub(super) fn after(&self, seconds: f64) -> Isometry {
        self.twist.carries(&self.pose, seconds)
    }
}
