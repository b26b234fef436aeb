//! The observation model: how well a pose explains the frame, by the field's line points laid onto the ground table.
//!
//! There are the two models of the paper, each as printed and corrected (docs/explanation/paper.md says why the printed sums mislead):
//!
//! | model | as printed | corrected |
//! | --- | --- | --- |
//! | Gauss (Eq. 2) | exp(sum of blurred gray / alpha), alpha = -1000 | exp(sum of (line contrast - 1/4) x certainty / alpha) |
//! | distance (Eq. 1) | exp(sum of distances to the nearest white pixel / alpha) | exp(sum of (3/4 - distance / reach) x certainty / alpha) |
//!
//! The corrected sums count a point that should be seen and is not against the pose, and a point that nobody could
//! see (outside the image, beyond the carpet, behind the robot's body) as nothing.

use glam::DVec2;

pub use super::kernel::SimdPath;
use super::kernel::{self, Points};
pub use super::observation_model::{Formula, Model};
use realitysim_geometry::{Field, Pose2, wrap_angle};
use realitysim_vision::{GroundTable, TableQuantity};

/// The quantity that the ground table must hold for this model.
pub fn reading(model: Model, formula: Formula) -> TableQuantity {
    match (model, formula) {
        (Model::Gauss, Formula::Corrected) => TableQuantity::Contrast,
        (Model::Distance, Formula::Corrected) => TableQuantity::Nearest,
        (Model::Gauss, Formula::Paper) => TableQuantity::Gray,
        (Model::Distance, Formula::Paper) => TableQuantity::NearestPixel,
    }
}

/// Default scale alpha of the exponent. Corrected: 3, since one point of 3 is independent of its neighbours; the paper prints -1000.
pub fn default_alpha(formula: Formula) -> f64 {
    match formula {
        Formula::Corrected => 3.0,
        Formula::Paper => -1000.0,
    }
}

/// An observation model for one field.
#[derive(Clone, Debug)]
pub struct Observation {
    /// The line points as the kernel reads them.
    points: Points,
    /// A disc around each group of [`kernel::LANES`] points.
    groups: Vec<Disc>,
    /// The line points in `map`.
    positions: Vec<DVec2>,
    formula: Formula,
    alpha: f64,
    /// Factor from the sum over points to the log likelihood.
    scale: f64,
    /// Length of line that one point stands for, in units of 10 cm.
    per_point: f64,
    path: SimdPath,
}

/// Length of line that counts as one in the corrected sums, metres.
const UNIT_M: f64 = 0.1;

/// A disc on the floor, in `map`.
#[derive(Clone, Copy, Debug)]
struct Disc {
    centre: DVec2,
    radius: f64,
}

impl Disc {
    fn around(points: &[DVec2]) -> Self {
        let centre = points.iter().sum::<DVec2>() / points.len().max(1) as f64;
        Self { centre, radius: points.iter().map(|point| point.distance(centre)).fold(0.0, f64::max) }
    }
}

/// A set of poses: all lie within `xy_m` and `yaw_rad` of the middle one.
#[derive(Clone, Copy, Debug)]
struct Cloud {
    middle: Pose2,
    xy_m: f64,
    yaw_rad: f64,
}

impl Cloud {
    /// `None` if the poses are too far apart for the bounds to be of use.
    fn around(poses: &[Pose2]) -> Option<Self> {
        const YAW_SPREAD_LIMIT_RAD: f64 = 0.8;
        let first = poses.first()?;
        let count = poses.len() as f64;
        let (mut x, mut y, mut turn) = (0.0, 0.0, 0.0);
        for pose in poses {
            x += pose.x;
            y += pose.y;
            turn += wrap_angle(pose.yaw - first.yaw);
        }
        let middle = Pose2::new(x / count, y / count, wrap_angle(first.yaw + turn / count));
        let (mut square, mut yaw_rad) = (0.0f64, 0.0f64);
        for pose in poses {
            let (dx, dy) = (pose.x - middle.x, pose.y - middle.y);
            square = square.max(dx * dx + dy * dy);
            yaw_rad = yaw_rad.max(wrap_angle(pose.yaw - middle.yaw).abs());
        }
        // NaN fails.
        (yaw_rad < YAW_SPREAD_LIMIT_RAD && square.is_finite()).then(|| Self {
            middle,
            xy_m: libm::sqrt(square),
            yaw_rad,
        })
    }
}

/// How much of the line that a pose predicts is seen.
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
    /// Makes the model for a field, all lines of which are represented by about `count` points.
    ///
    /// The corrected formulas weigh each point by the line that it stands for, so that neither `count` nor the size of the field changes
    /// what a metre of line says.
    pub fn new(field: &Field, count: usize, formula: Formula, alpha: f64, path: SimdPath) -> Self {
        let points = field.points(count);
        let length: f64 = points.iter().map(|point| point.length).sum();
        let per_point = length / points.len().max(1) as f64 / UNIT_M;
        let positions = points.iter().map(|point| point.position).collect();
        Self::of(positions, formula, alpha, per_point, kernel::available(path))
    }

    /// The same model with every `step`-th point only, each of which counts `step` times as much.
    pub fn sparse(&self, step: usize) -> Self {
        let positions: Vec<DVec2> = self.positions.iter().copied().step_by(step.max(1)).collect();
        let per_point = self.per_point * self.positions.len() as f64 / positions.len().max(1) as f64;
        Self::of(positions, self.formula, self.alpha, per_point, self.path)
    }

    fn of(positions: Vec<DVec2>, formula: Formula, alpha: f64, per_point: f64, path: SimdPath) -> Self {
        let scale = match formula {
            Formula::Corrected => per_point / alpha,
            Formula::Paper => 1.0 / alpha,
        };
        Self {
            points: Points::new(positions.iter().copied()),
            groups: positions.chunks(kernel::LANES).map(Disc::around).collect(),
            positions,
            formula,
            alpha,
            scale,
            per_point,
            path,
        }
    }

    /// Number of points on all lines together.
    pub fn point_count(&self) -> usize {
        self.points.len()
    }

    /// Collects in `near` the line points that some of `poses` may see. The others add nothing to a sum.
    pub fn look_near(&self, table: &GroundTable, poses: &[Pose2], near: &mut Points) {
        self.look_within(table, Cloud::around(poses), near);
    }

    /// Collects in `near` the line points that some pose within `xy_m` and `yaw_rad` of `middle` may see.
    pub fn look_around(&self, table: &GroundTable, middle: &Pose2, xy_m: f64, yaw_rad: f64, near: &mut Points) {
        self.look_within(table, Some(Cloud { middle: *middle, xy_m, yaw_rad }), near);
    }

    fn look_within(&self, table: &GroundTable, cloud: Option<Cloud>, near: &mut Points) {
        let cloud = cloud.map(|cloud| (cloud.middle.inverse().to_affine(), cloud));
        let visible = |group: &Disc| {
            cloud.is_none_or(|(robot_from_map, Cloud { xy_m, yaw_rad, .. })| {
                let at = robot_from_map.transform_point2(group.centre);
                table.may_tell(at, group.radius + xy_m + yaw_rad * (at.length() + xy_m))
            })
        };
        let groups = self.groups.iter().enumerate().filter(|(_, group)| visible(group));
        near.select(&self.points, groups.map(|(index, _)| index));
    }

    /// [`Self::log_likelihood`] of one of the poses for which [`Self::look_near`] collected `near`.
    pub fn log_likelihood_near(&self, table: &GroundTable, pose: &Pose2, near: &Points) -> f64 {
        kernel::sum_levels(self.path, table, near, pose) * (table.readings().scale * self.scale)
    }

    /// Log likelihood of the frame if the robot is at `pose`, up to a constant that is the same for all poses.
    pub fn log_likelihood(&self, table: &GroundTable, pose: &Pose2) -> f64 {
        kernel::sum_levels(self.path, table, &self.points, pose) * (table.readings().scale * self.scale)
    }

    /// How much of the line that `pose` predicts is seen. `lines` must hold [`TableQuantity::Contrast`].
    pub fn support(&self, lines: &GroundTable, pose: &Pose2) -> Support {
        let readings = lines.readings();
        let robot_from_map = pose.inverse().to_affine();
        let (mut points, mut weight) = (0, 0.0);
        for position in &self.positions {
            let seen = lines.seen(robot_from_map.transform_point2(*position));
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
