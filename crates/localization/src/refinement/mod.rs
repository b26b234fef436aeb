//! Pose refinement: robust least squares over the camera's position and rotation, from a start near the right pose.
//!
//! [`line_measurement`] looks for each visible field line along its normal in the image, to a fraction of a pixel. A
//! normal distribution about the predicted pose ([`Prior`]) holds what odometry, IMU and mount say. `solve` finds the pose
//! that fits both best, and its covariance.
//!
//! The error of a pose is a vector of six numbers, all along the axes of `map` and in the order of a ROS covariance: x, y, z
//! (m), rotation vector about x, y, z (rad). Four more describe lens and sensor: relative error of the focal length, shift of
//! the axis in u and in v (widths of the image), and time from reading the first row to reading the last (s).

mod false_alarms;
mod line_contrast;
pub mod line_measurement;
pub mod miscalibration;
mod paint_displacement;
mod points;
mod profile;
mod qr_accumulator;
mod solve;

use glam::DVec3;
use nalgebra::{Matrix3, Matrix6, SMatrix, SVector, Vector3, Vector6};

use false_alarms::ChanceTest;
use line_measurement::{CameraModel, Counts, Inspected, LineMeasurement, Response};
use miscalibration::{Miscalibration, UNSEEN_M_PER_S, unmeasured_rad_per_s};
use realitysim_geometry::{Field, Isometry, Lens, Projector, Twist};
use realitysim_vision::LineImage;

pub use points::LinePoints;

/// Number of unknowns: six of the pose, four of lens and sensor.
pub const UNKNOWNS: usize = 10;
/// Index of the first unknown of lens and sensor: the focal length.
pub const OF_LENS: usize = 6;
/// Index of the readout time.
const READOUT: usize = 9;

/// Error vector of pose, lens and sensor.
pub type Errors = SVector<f64, UNKNOWNS>;
/// Covariance of [`Errors`].
pub type ErrorCovariance = SMatrix<f64, UNKNOWNS, UNKNOWNS>;

/// The belief about the camera's pose and lens before the image is measured.
#[derive(Clone, Debug, PartialEq)]
pub struct Prior {
    /// Predicted pose of the camera in `map`.
    pub map_from_optical: Isometry,
    /// Believed errors of the calibration.
    pub lens: Miscalibration,
    /// Velocity of the camera while the sensor is read row by row, in `camera_optical_frame`.
    pub twist: Twist,
    /// Whether the angular part of `twist` was measured by a gyro.
    pub turn_is_measured: bool,
    /// Covariance of the errors of pose and lens.
    pub covariance: ErrorCovariance,
}

/// The estimate of the camera's pose and lens after the image was measured.
#[derive(Clone, Debug, PartialEq)]
pub struct Refined {
    /// Refined pose of the camera in `map`.
    pub map_from_optical: Isometry,
    /// Covariance of the errors of pose and lens, given the prior: positive definite, never larger than the prior's.
    pub covariance: ErrorCovariance,
    /// Additional covariance of the pose's error, because lines are not painted exactly where the field's description has
    /// them. The next frame sees the same paint, so this part does not average out.
    pub by_paint: Matrix6<f64>,
    /// Error vector of pose and lens relative to the prior.
    pub moved: Errors,
    /// Condition number (1-norm) of the least squares in units of the prior: 1 if the lines say nothing; otherwise about the
    /// ratio of how much the best and the worst determined unknowns gain.
    pub condition: f64,
    /// Half the squared deviation from the prior plus the robust cost of the lines. Lower is better.
    pub cost: f64,
    /// Agreement of the lines with the refined pose.
    pub lines: Agreement,
}

/// Agreement of the lines in an image with a pose.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Agreement {
    /// Number of line places that had to be visible and that nothing hid.
    pub expected: usize,
    /// Number of those at which a line was found that fits the refined pose.
    pub fitting: usize,
    /// Root mean square deviation of those that fit, pixels.
    pub rms_px: f64,
    /// Share of the expected lines that fits. Each place is weighted by its visibility, the probability that a line of its
    /// width is seen.
    pub share: f64,
    /// Sum of these weights over all expected places.
    pub visible: f64,
    /// -log10 of the probability that so many lines lie there by chance.
    pub digits: f64,
    /// Share, weighted as in `share`, of the expected lines that stand out more where the pose has them than beside it.
    pub foremost: f64,
    /// Width of a line that is seen half the time, pixels. The fainter the lines, the wider.
    pub half_seen_px: f64,
}

impl Agreement {
    /// The unweighted share of the expected line places that fit.
    pub fn share_of_places(&self) -> f64 {
        self.fitting as f64 / self.expected.max(1) as f64
    }

    /// The amount by which [`Self::half_seen_px`] exceeds one pixel, which is about its value on well painted carpet.
    pub fn fainter_px(&self) -> f64 {
        (self.half_seen_px - 1.0).max(0.0)
    }
}

/// Refines poses on one field with one lens. It keeps its buffers from frame to frame.
#[derive(Clone, Debug)]
pub struct Refiner {
    points: LinePoints,
    projector: Projector,
    measurements: Vec<LineMeasurement>,
}

/// Scales of the robust loss, in standard deviations of one measurement, for the successive rounds of measuring. The first one
/// is used only if the tilt of the start may be wrong by more than [`WIDE_TILT_RAD`], so that lines lie far from where it puts them.
const SCALES: [f64; 3] = [60.0, 12.0, 4.0];
/// Standard deviation of the tilt beyond which the first of [`SCALES`] is used, radians.
const WIDE_TILT_RAD: f64 = 0.02;
/// Factor of the prior's covariance for [`Refiner::refine_nearby`]: a fifth of the standard deviations.
const NEARBY_FACTOR: f64 = 0.04;

/// Standard deviations of a mount that nobody measured: x, y, z (m), roll, pitch, heading (rad), focal length (share).
const UNBOUND_SIGMAS: [f64; 7] = [0.3, 0.3, 0.1, 0.09, 0.09, 0.1, 0.06];
/// Standard deviations within which lines are looked for when mount and lens are released: x, y, z (m), rotation (rad).
const UNBOUND_REACH_SIGMAS: [f64; 6] = [0.04, 0.04, 0.04, 0.02, 0.02, 0.02];

impl Refiner {
    /// A refiner for the lines of `field` seen through `lens`.
    pub fn new(field: &Field, lens: &Lens) -> Self {
        Self { points: LinePoints::new(field), projector: Projector::new(lens), measurements: Vec::new() }
    }

    /// The lens as calibrated.
    pub fn lens(&self) -> &Lens {
        self.projector.lens()
    }

    /// Refines from several starts, error vectors relative to the prior's pose, and returns the result of lowest cost. `None`
    /// if the prior's covariance is not positive definite or no result is finite.
    pub fn refine(&mut self, image: &LineImage, prior: &Prior, starts: &[Vector6<f64>]) -> Option<Refined> {
        let results = starts.iter().filter_map(|start| self.refine_from(image, prior, start, prior.pose_covariance()));
        let best = results.min_by(|a, b| a.cost.total_cmp(&b.cost))?;
        Some(self.with_chance_test(image, prior, best))
    }

    /// For each line place that is expected from this pose: whether the image shows the line.
    pub fn inspect(&self, image: &LineImage, map_from_optical: &Isometry) -> Vec<Inspected> {
        let camera_model = CameraModel { projector: &self.projector, off: &Miscalibration::NONE, twist: &Twist::ZERO };
        line_measurement::inspect(&self.points, image, camera_model, map_from_optical)
    }

    /// The response of the matched filter to each expected line and to the carpet beside it, if the camera is at this pose.
    pub fn responses(&self, image: &LineImage, map_from_optical: &Isometry) -> Vec<Response> {
        let camera_model = CameraModel { projector: &self.projector, off: &Miscalibration::NONE, twist: &Twist::ZERO };
        line_measurement::responses(&self.points, image, camera_model, map_from_optical)
    }

    /// Refines on the assumption that the prior's mean is nearly right. Lines are looked for close to where it has them, so
    /// that none is taken for its neighbour. The cost is comparable with that of [`Self::refine`]: the lower one is better.
    pub fn refine_nearby(&mut self, image: &LineImage, prior: &Prior) -> Option<Refined> {
        let refined = self.refine_from(image, prior, &Vector6::zeros(), prior.pose_covariance() * NEARBY_FACTOR)?;
        Some(self.with_chance_test(image, prior, refined))
    }

    /// Refines from one start, an error vector relative to the prior's pose. `reach` is the covariance of the start's own
    /// error: lines are looked for within it, however wide the prior is.
    pub fn refine_within(
        &mut self,
        image: &LineImage,
        prior: &Prior,
        start: &Vector6<f64>,
        reach: &Matrix6<f64>,
    ) -> Option<Refined> {
        let refined = self.refine_from(image, prior, start, *reach)?;
        Some(self.with_chance_test(image, prior, refined))
    }

    /// Refines again from where `refined` ended, as if mount and lens were hardly known. The result is the pose and the lens
    /// that the lines alone suggest. `None` as for [`Self::refine`].
    pub fn refine_unbound(&mut self, image: &LineImage, prior: &Prior, refined: &Refined) -> Option<Refined> {
        let mut unbound = prior.clone();
        for (error, sigma) in UNBOUND_SIGMAS.into_iter().enumerate() {
            unbound.covariance[(error, error)] += sigma * sigma;
        }
        let reach = Matrix6::from_diagonal(&Vector6::from(UNBOUND_REACH_SIGMAS.map(|sigma| sigma * sigma)));
        self.refine_within(image, &unbound, &refined.pose_moved(), &reach)
    }

    /// Adds the results of the test against chance.
    fn with_chance_test(&self, image: &LineImage, prior: &Prior, mut refined: Refined) -> Refined {
        let camera_model = CameraModel { projector: &self.projector, off: &prior.lens, twist: &prior.twist };
        let ChanceTest { foremost, digits, half_seen_px } =
            false_alarms::test(&self.points, image, camera_model, &refined.map_from_optical);
        refined.lines = Agreement { foremost, digits, half_seen_px, ..refined.lines };
        refined
    }

    /// Refines from `start`. `reach` is the covariance of the start's error. The test against chance is not made.
    fn refine_from(
        &mut self,
        image: &LineImage,
        prior: &Prior,
        start: &Vector6<f64>,
        reach: Matrix6<f64>,
    ) -> Option<Refined> {
        let Self { points, projector, measurements } = self;
        let mut moved = *start;
        let mut covariance = reach;
        let mut last: Option<(Counts, solve::Solution, solve::Noise)> = None;
        let mut noise = solve::Noise::USUAL;
        let wide = reach[(3, 3)].max(reach[(4, 4)]) > WIDE_TILT_RAD * WIDE_TILT_RAD;
        for scale in &SCALES[usize::from(!wide)..] {
            let pose = moved_pose(&prior.map_from_optical, &moved);
            let camera_model = CameraModel { projector, off: &prior.lens, twist: &prior.twist };
            let counts = line_measurement::measure(points, image, camera_model, &pose, &covariance, measurements);
            let solution = solve::solve(prior, measurements, &moved, *scale, noise)?;
            moved = solution.moved;
            let (solved_with, measured) = (noise, solution.residuals.noise());
            // The next round looks within what this one leaves uncertain, with a margin.
            covariance = solution.covariance * (4.0 * (measured.correlated / noise.correlated).max(1.0));
            // If the prior is off, whole lines look off. Such a common error widens the covariance, but must not make the lines count
            // less against the prior.
            noise = solve::Noise { correlated: noise.correlated, ..measured };
            last = Some((counts, solution, solved_with));
        }
        let (counts, solution, solved_with) = last?;
        let [.., scale] = SCALES;
        let solve::Joint { moved, covariance, by_paint, condition } =
            solve::joint(prior, measurements, &moved, scale, [solved_with, solution.residuals.noise()])?;
        let is_finite = moved.iter().chain(&covariance).chain(&by_paint).all(|value| value.is_finite());
        let map_from_optical = moved_pose(&prior.map_from_optical, &pose_part(&moved));
        let fitting = solution.residuals.fitting;
        is_finite.then(|| Refined {
            map_from_optical,
            covariance,
            by_paint,
            condition,
            moved,
            cost: solution.cost + counts.missed as f64 * solve::MISS_COST,
            lines: Agreement {
                expected: counts.expected,
                fitting,
                rms_px: solution.residuals.rms_px(),
                visible: counts.visible,
                share: share(
                    solution.residuals.visible,
                    counts.visible,
                    fitting as f64 / counts.expected.max(1) as f64,
                ),
                ..Agreement::default()
            },
        })
    }
}

impl Prior {
    /// A prior for the pose with a lens that is exactly as calibrated and does not move.
    pub fn of_pose(map_from_optical: Isometry, pose: &Matrix6<f64>) -> Self {
        let mut covariance = ErrorCovariance::zeros();
        covariance.fixed_view_mut::<6, 6>(0, 0).copy_from(pose);
        let mut prior = Self {
            map_from_optical,
            lens: Miscalibration::NONE,
            twist: Twist::ZERO,
            turn_is_measured: true,
            covariance,
        };
        prior.take_lens_as_known();
        prior
    }

    /// Fixes the errors of lens and sensor at their believed values.
    pub fn take_lens_as_known(&mut self) {
        for of_lens in OF_LENS..UNKNOWNS {
            self.covariance.row_mut(of_lens).fill(0.0);
            self.covariance.column_mut(of_lens).fill(0.0);
            self.covariance[(of_lens, of_lens)] = KNOWN_VARIANCE;
        }
    }

    /// The part of the covariance that belongs to the pose.
    pub fn pose_covariance(&self) -> Matrix6<f64> {
        pose_block(&self.covariance)
    }

    /// Covariance of the way that the camera goes during the readout beyond what is believed, along its own axes: the torso
    /// sways unmeasured, and the readout time is uncertain.
    fn unseen_way_m2(&self) -> Matrix3<f64> {
        let (readout_s, variance_s2) = (self.lens.readout_s, self.covariance[(READOUT, READOUT)]);
        let DVec3 { x, y, z } = self.twist.linear;
        let goes = Vector3::new(x, y, z);
        let sways = UNSEEN_M_PER_S * UNSEEN_M_PER_S * (readout_s * readout_s + variance_s2);
        goes * goes.transpose() * variance_s2 + Matrix3::identity() * sways
    }

    /// Variance, about each axis, of the rotation during the readout beyond what is believed, if there is no gyro.
    fn unmeasured_turn_rad2(&self) -> f64 {
        let (readout_s, variance_s2) = (self.lens.readout_s, self.covariance[(READOUT, READOUT)]);
        let turns = unmeasured_rad_per_s(&self.twist);
        turns * turns * (readout_s * readout_s + variance_s2)
    }
}

impl Refined {
    /// Total covariance of the pose's error, including that of the paint.
    pub fn pose_covariance(&self) -> Matrix6<f64> {
        pose_block(&self.covariance) + self.by_paint
    }

    /// The pose's part of [`Self::moved`].
    pub fn pose_moved(&self) -> Vector6<f64> {
        pose_part(&self.moved)
    }
}

/// All thin places together weigh as much as this many wide ones; it matters where hardly a place is wide enough to be seen well.
const THIN_PLACES: f64 = 5.0;

/// Share of `visible` weight that was `found`, drawn towards `of_places`, the unweighted share of all places.
fn share(found: f64, visible: f64, of_places: f64) -> f64 {
    (found + THIN_PLACES * of_places) / (visible + THIN_PLACES)
}

/// A variance that stands for zero and keeps the covariance positive definite.
const KNOWN_VARIANCE: f64 = 1e-20;

fn pose_block(covariance: &ErrorCovariance) -> Matrix6<f64> {
    covariance.fixed_view::<6, 6>(0, 0).into_owned()
}

fn pose_part(errors: &Errors) -> Vector6<f64> {
    errors.fixed_rows::<6>(0).into_owned()
}

/// The pose whose error relative to `pose` is `moved`: x, y, z (m) and rotation vector (rad) along the axes of `map`.
pub fn moved_pose(pose: &Isometry, moved: &Vector6<f64>) -> Isometry {
    let turn = DVec3::new(moved[3], moved[4], moved[5]);
    Isometry::new(
        glam::DQuat::from_scaled_axis(turn) * pose.rotation,
        pose.translation + DVec3::new(moved[0], moved[1], moved[2]),
    )
}

/// The error of `other` relative to `pose`; the inverse of [`moved_pose`].
pub fn error_between(pose: &Isometry, other: &Isometry) -> Vector6<f64> {
    let off = other.translation - pose.translation;
    let turn = other.rotation * pose.rotation.conjugate();
    let turn = if turn.w < 0.0 { -turn } else { turn };
    let turn = turn.to_scaled_axis();
    Vector6::new(off.x, off.y, off.z, turn.x, turn.y, turn.z)
}

#[cfg(test)]
mod tests;
