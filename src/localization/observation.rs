//! How well a pose explains the frame: the field's line points, laid onto the ground table.
//!
//! Both models of the paper, each as printed and corrected (docs/paper.md says why the printed sums mislead):
//!
//! | model | as printed | corrected |
//! | --- | --- | --- |
//! | Gauss (Eq. 2) | exp(sum of blurred gray / alpha), alpha = -1000 | exp(sum of (line contrast - 1/4) x certainty / alpha) |
//! | distance (Eq. 1) | exp(sum of distances to the nearest white pixel / alpha) | exp(sum of (3/4 - distance / reach) x certainty / alpha) |
//!
//! The corrected sums count a point that should be seen and is not against the pose, and a point that nobody could
//! see (outside the image, beyond the carpet, behind the robot's body) as nothing.

use glam::DVec2;

use super::kernel::{self, Points};
pub use crate::config::{Formula, Model, SimdPath};
use crate::geometry::{Field, Pose2};
use crate::vision::{GroundTable, Reading};

/// What the ground table must hold for this model.
pub fn reading(model: Model, formula: Formula) -> Reading {
    match (model, formula) {
        (Model::Gauss, Formula::Corrected) => Reading::Contrast,
        (Model::Distance, Formula::Corrected) => Reading::Nearest,
        (Model::Gauss, Formula::Paper) => Reading::Gray,
        (Model::Distance, Formula::Paper) => Reading::NearestPixel,
    }
}

/// The scale of the exponent that belongs to each formula: 1 point of 3 is independent of its neighbours; the
/// paper prints -1000.
pub fn default_alpha(formula: Formula) -> f64 {
    match formula {
        Formula::Corrected => 3.0,
        Formula::Paper => -1000.0,
    }
}

#[derive(Clone, Debug)]
pub struct Observation {
    points: Points,
    positions: Vec<DVec2>,
    /// Of the exponent, for a sum over points.
    scale: f64,
    /// What one point counts: how many times 10 cm of line it stands for.
    per_point: f64,
    path: SimdPath,
}

/// The corrected sums count line, not points: one for each 10 cm.
const UNIT_M: f64 = 0.1;

/// How much of what a pose predicts is there.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Support {
    /// Share of the expected line contrast that was found, 0 to 1.
    pub share: f64,
    /// Painted line in view in units of 10 cm, counted by its certainty.
    pub weight: f64,
    /// Line points in view.
    pub points: usize,
}

impl Observation {
    /// `count` is about how many points stand for all lines of the field. The corrected formulas weigh each by the
    /// line that it stands for, so that neither `count` nor the size of the field changes what a metre of line says.
    pub fn new(field: &Field, count: usize, formula: Formula, alpha: f64, path: SimdPath) -> Self {
        let points = field.points(count);
        let length: f64 = points.iter().map(|point| point.length).sum();
        let per_point = length / points.len().max(1) as f64 / UNIT_M;
        let scale = match formula {
            Formula::Corrected => per_point / alpha,
            Formula::Paper => 1.0 / alpha,
        };
        let positions: Vec<DVec2> = points.iter().map(|point| point.position).collect();
        Self {
            points: Points::new(positions.iter().copied()),
            positions,
            scale,
            per_point,
            path: kernel::available(path),
        }
    }

    /// Points on all lines together.
    pub fn point_count(&self) -> usize {
        self.points.len()
    }

    /// Up to a constant of the frame.
    pub fn log_likelihood(&self, table: &GroundTable, pose: &Pose2) -> f64 {
        kernel::sum_levels(self.path, table, &self.points, pose) * table.readings().scale * self.scale
    }

    /// `lines` must hold [`Reading::Contrast`].
    pub fn support(&self, lines: &GroundTable, pose: &Pose2) -> Support {
        let readings = lines.readings();
        let robot_from_map = pose.inverse();
        let (mut points, mut weight) = (0, 0.0);
        for position in &self.positions {
            let at = robot_from_map.compose(&Pose2::new(position.x, position.y, 0.0));
            let seen = lines.seen(DVec2::new(at.x, at.y));
            points += usize::from(seen > 0.0);
            weight += seen;
        }
        if weight <= 0.0 {
            return Support::default();
        }
        let sum = kernel::sum_levels(self.path, lines, &self.points, pose);
        let share = ((sum / weight + f64::from(readings.zero)) / 255.0).clamp(0.0, 1.0);
        Support { share, weight: weight * self.per_point, points }
    }
}
