//! From the right basin to the pose: robust least squares over the camera's position and rotation.
//!
//! Each field line in view is looked for along its normal, in the image, to a fraction of a pixel
//! ([`offsets`]). What odometry, IMU and mount say is a normal distribution about the predicted pose ([`Prior`]).
//! The pose that fits both best, and how well it is known, come from `solve`.
//!
//! Errors of a pose are six numbers: position (m) and rotation vector (rad), both along the axes of `map`, in
//! the order of a ROS covariance: x, y, z, rotation about x, y, z. Four more are those of lens and sensor: how much longer the focal length
//! is (share), how far the axis lies off (u, v, widths of the image), how long it takes from reading the first row to the last (s).

mod false_alarms;
pub mod line_measurement;
pub mod miscalibration;
mod paint;
mod points;
mod profile;
mod qr_accumulator;
mod solve;

use glam::DVec3;
use nalgebra::{Matrix3, Matrix6, SMatrix, SVector, Vector3, Vector6};

use false_alarms::Test;
use line_measurement::{CameraModel, Counts, Inspected, LineMeasurement, Response};
use miscalibration::{Miscalibration, UNSEEN_M_PER_S, unfelt_rad_per_s};
use realitysim_geometry::{Field, Isometry, Lens, Projector, Twist};
use realitysim_vision::LineImage;

pub use points::LinePoints;

/// Of pose and lens.
pub const UNKNOWNS: usize = 10;
/// The first of the lens.
pub const OF_LENS: usize = 6;
const READOUT: usize = 9;

pub type Errors = SVector<f64, UNKNOWNS>;
pub type ErrorCovariance = SMatrix<f64, UNKNOWNS, UNKNOWNS>;

/// What is believed of the camera's pose and its lens before looking.
#[derive(Clone, Debug, PartialEq)]
pub struct Prior {
    pub map_from_optical: Isometry,
    pub lens: Miscalibration,
    /// How the camera moves while row after row is read.
    pub twist: Twist,
    /// It turns as a gyro has told, and not otherwise.
    pub turn_is_felt: bool,
    pub covariance: ErrorCovariance,
}

/// What is believed after looking.
#[derive(Clone, Debug, PartialEq)]
pub struct Refined {
    pub map_from_optical: Isometry,
    /// Of the errors of pose and lens, given the prior: positive definite, never larger than the prior's.
    pub covariance: ErrorCovariance,
    /// Of the errors of the pose beside that: because lines are painted elsewhere than the field's description has them. The next frame sees
    /// the same paint, so that this does not fade from frame to frame.
    pub by_paint: Matrix6<f64>,
    /// The error vector of pose and lens relative to the prior's.
    pub moved: Errors,
    /// Of the least squares in units of the prior, in the 1-norm: 1 if the lines say nothing, and about how much better the best known is
    /// known after looking than the worst.
    pub condition: f64,
    /// Half the squared deviation from the prior plus the robust cost of the lines: lower is better.
    pub cost: f64,
    pub lines: Agreement,
}

/// How far lines and pose agree.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Agreement {
    /// Places where a line had to be seen, and nothing hid it.
    pub expected: usize,
    /// Of these, where one was found that fits the refined pose.
    pub fitting: usize,
    /// Root of the mean squared deviation of those that fit, in pixels.
    pub rms_px: f64,
    /// Of what a picture shows of the expected lines, the share that fits: each place counts by how probably a line of its
    /// width is seen.
    pub share: f64,
    /// Of how many places that is: the number of the expected ones, each counted the same way.
    pub visible: f64,
    /// How improbable it is that so many lines lie there by chance: -log10 of that probability.
    pub digits: f64,
    /// Share of the expected lines that stand out most where the pose has them, against what lies beside: counted as in `share`.
    pub foremost: f64,
    /// Width of a line that the picture shows half the time, in pixels: the fainter the lines, the wider.
    pub half_seen_px: f64,
}

impl Agreement {
    /// Share of the expected line places that fit, however thin the line is there.
    pub fn share_of_places(&self) -> f64 {
        self.fitting as f64 / self.expected.max(1) as f64
    }

    /// Pixels by which the width of a line that shows half the time exceeds that on well painted carpet, which is about one.
    pub fn fainter_px(&self) -> f64 {
        (self.half_seen_px - 1.0).max(0.0)
    }
}

/// Of one field and lens; keeps what it works in from frame to frame.
#[derive(Clone, Debug)]
pub struct Refiner {
    points: LinePoints,
    projector: Projector,
    sights: Vec<LineMeasurement>,
}

/// Scale of the robust loss, in standard deviations of one measurement, from the first round of measuring to the last. The
/// first is for a start whose tilt may be wrong by more than [`WIDE_RAD`]: lines lie far from where it puts them.
const SCALES: [f64; 3] = [60.0, 12.0, 4.0];
const WIDE_RAD: f64 = 0.02;
/// A fifth of the standard deviations.
const NEARBY: f64 = 0.04;

/// Standard deviations of what nobody has measured: position, height (m), tilt, heading (rad), focal length (share).
const UNBOUND: [f64; 7] = [0.3, 0.3, 0.1, 0.09, 0.09, 0.1, 0.06];
/// How far a pose may move at first when mount and lens are let go.
const UNBOUND_REACH: [f64; 6] = [0.04, 0.04, 0.04, 0.02, 0.02, 0.02];

impl Refiner {
    pub fn new(field: &Field, lens: &Lens) -> Self {
        Self { points: LinePoints::new(field), projector: Projector::new(lens), sights: Vec::new() }
    }

    pub fn lens(&self) -> &Lens {
        self.projector.lens()
    }

    /// Refines from each start (error vectors relative to the prior's pose); the best result counts. `None` if the prior is no
    /// covariance, or if nothing finite came out.
    pub fn refine(&mut self, image: &LineImage, prior: &Prior, starts: &[Vector6<f64>]) -> Option<Refined> {
        let results = starts.iter().filter_map(|start| self.refine_from(image, prior, start, prior.pose_covariance()));
        let best = results.min_by(|a, b| a.cost.total_cmp(&b.cost))?;
        Some(self.tested(image, prior, best))
    }

    /// What a picture shows of the lines that a camera would see from this pose.
    pub fn inspect(&self, image: &LineImage, map_from_optical: &Isometry) -> Vec<Inspected> {
        let eye = CameraModel { projector: &self.projector, off: &Miscalibration::NONE, twist: &Twist::ZERO };
        line_measurement::inspect(&self.points, image, eye, map_from_optical)
    }

    /// How far lines, and the carpet beside them, stand out of this picture, if the camera is where this pose has it.
    pub fn responses(&self, image: &LineImage, map_from_optical: &Isometry) -> Vec<Response> {
        let eye = CameraModel { projector: &self.projector, off: &Miscalibration::NONE, twist: &Twist::ZERO };
        line_measurement::responses(&self.points, image, eye, map_from_optical)
    }

    /// As if the prior's mean were nearly right: lines are looked for close to where it has them, so that none is taken for its
    /// neighbour. The cost is that of [`Self::refine`], by which the better of the two is known.
    pub fn refine_nearby(&mut self, image: &LineImage, prior: &Prior) -> Option<Refined> {
        let refined = self.refine_from(image, prior, &Vector6::zeros(), prior.pose_covariance() * NEARBY)?;
        Some(self.tested(image, prior, refined))
    }

    /// From one start, an error vector relative to the prior's pose, of which it is known how wrong it may be: lines are looked for within
    /// that `reach`, however wide the prior is.
    pub fn refine_within(
        &mut self,
        image: &LineImage,
        prior: &Prior,
        start: &Vector6<f64>,
        reach: &Matrix6<f64>,
    ) -> Option<Refined> {
        let refined = self.refine_from(image, prior, start, *reach)?;
        Some(self.tested(image, prior, refined))
    }

    /// From where `refined` ended, as if mount and lens were hardly known: its pose is where the lines have the camera, its error of the
    /// lens what they say of that. `None` as for [`Self::refine`].
    pub fn refine_unbound(&mut self, image: &LineImage, prior: &Prior, refined: &Refined) -> Option<Refined> {
        let mut unbound = prior.clone();
        for (error, sigma) in UNBOUND.into_iter().enumerate() {
            unbound.covariance[(error, error)] += sigma * sigma;
        }
        let reach = Matrix6::from_diagonal(&Vector6::from(UNBOUND_REACH.map(|sigma| sigma * sigma)));
        self.refine_within(image, &unbound, &refined.pose_moved(), &reach)
    }

    /// With what is to be said against chance.
    fn tested(&self, image: &LineImage, prior: &Prior, mut refined: Refined) -> Refined {
        let eye = CameraModel { projector: &self.projector, off: &prior.lens, twist: &prior.twist };
        let Test { foremost, digits, half_seen_px } =
            false_alarms::test(&self.points, image, eye, &refined.map_from_optical);
        refined.lines = Agreement { foremost, digits, half_seen_px, ..refined.lines };
        refined
    }

    /// `reach` is how wrong the start may be.
    fn refine_from(
        &mut self,
        image: &LineImage,
        prior: &Prior,
        start: &Vector6<f64>,
        reach: Matrix6<f64>,
    ) -> Option<Refined> {
        let Self { points, projector, sights } = self;
        let mut moved = *start;
        let mut covariance = reach;
        let mut last: Option<(Counts, solve::Solution, solve::Noise)> = None;
        let mut noise = solve::Noise::USUAL;
        let wide = reach[(3, 3)].max(reach[(4, 4)]) > WIDE_RAD * WIDE_RAD;
        for scale in &SCALES[usize::from(!wide)..] {
            let pose = moved_pose(&prior.map_from_optical, &moved);
            let eye = CameraModel { projector, off: &prior.lens, twist: &prior.twist };
            let counts = line_measurement::measure(points, image, eye, &pose, &covariance, sights);
            let solution = solve::solve(prior, sights, &moved, *scale, noise)?;
            moved = solution.moved;
            let (solved_with, measured) = (noise, solution.residuals.noise());
            // The next round looks as far as this one leaves open, but never trusts it fully.
            covariance = solution.covariance * (4.0 * (measured.correlated / noise.correlated).max(1.0));
            // A prior that is off makes whole lines look off: what they share widens the covariance, and is no reason to
            // believe the prior instead.
            noise = solve::Noise { correlated: noise.correlated, ..measured };
            last = Some((counts, solution, solved_with));
        }
        let (counts, solution, solved_with) = last?;
        let [.., scale] = SCALES;
        let solve::Joint { moved, covariance, by_paint, condition } =
            solve::joint(prior, sights, &moved, scale, [solved_with, solution.residuals.noise()])?;
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
    /// Of a lens that is as its calibration says.
    pub fn of_pose(map_from_optical: Isometry, pose: &Matrix6<f64>) -> Self {
        let mut covariance = ErrorCovariance::zeros();
        covariance.fixed_view_mut::<6, 6>(0, 0).copy_from(pose);
        let mut prior =
            Self { map_from_optical, lens: Miscalibration::NONE, twist: Twist::ZERO, turn_is_felt: true, covariance };
        prior.take_lens_as_known();
        prior
    }

    /// The lens is what it is believed to be.
    pub fn take_lens_as_known(&mut self) {
        for of_lens in OF_LENS..UNKNOWNS {
            self.covariance.row_mut(of_lens).fill(0.0);
            self.covariance.column_mut(of_lens).fill(0.0);
            self.covariance[(of_lens, of_lens)] = KNOWN;
        }
    }

    pub fn pose_covariance(&self) -> Matrix6<f64> {
        pose_block(&self.covariance)
    }

    /// Covariance of the way that the camera goes, along its own axes, while the sensor is read, beyond what is believed: its torso sways
    /// unseen, and reading takes longer or shorter.
    fn unseen_way_m2(&self) -> Matrix3<f64> {
        let (readout_s, variance_s2) = (self.lens.readout_s, self.covariance[(READOUT, READOUT)]);
        let DVec3 { x, y, z } = self.twist.linear;
        let goes = Vector3::new(x, y, z);
        let sways = UNSEEN_M_PER_S * UNSEEN_M_PER_S * (readout_s * readout_s + variance_s2);
        goes * goes.transpose() * variance_s2 + Matrix3::identity() * sways
    }

    /// Variance of the turn about each of its axes meanwhile, beyond what is believed, without a gyro.
    fn unfelt_turn_rad2(&self) -> f64 {
        let (readout_s, variance_s2) = (self.lens.readout_s, self.covariance[(READOUT, READOUT)]);
        let turns = unfelt_rad_per_s(&self.twist);
        turns * turns * (readout_s * readout_s + variance_s2)
    }
}

impl Refined {
    /// Of all that the pose can be wrong by.
    pub fn pose_covariance(&self) -> Matrix6<f64> {
        pose_block(&self.covariance) + self.by_paint
    }

    pub fn pose_moved(&self) -> Vector6<f64> {
        pose_part(&self.moved)
    }
}

/// What thin places say, all together, where hardly a place is wide enough to be seen well: as much as so many of those.
const THIN_PLACES: f64 = 5.0;

/// Share of lines, each place counted by its visibility, `of_places` being that of all places alike.
fn share(found: f64, visible: f64, of_places: f64) -> f64 {
    (found + THIN_PLACES * of_places) / (visible + THIN_PLACES)
}

/// As good as no variance, and still a covariance.
const KNOWN: f64 = 1e-20;

fn pose_block(covariance: &ErrorCovariance) -> Matrix6<f64> {
    covariance.fixed_view::<6, 6>(0, 0).into_owned()
}

fn pose_part(errors: &Errors) -> Vector6<f64> {
    errors.fixed_rows::<6>(0).into_owned()
}

/// The pose whose error relative to `pose` is `moved`.
pub fn moved_pose(pose: &Isometry, moved: &Vector6<f64>) -> Isometry {
    let turn = DVec3::new(moved[3], moved[4], moved[5]);
    Isometry::new(
        glam::DQuat::from_scaled_axis(turn) * pose.rotation,
        pose.translation + DVec3::new(moved[0], moved[1], moved[2]),
    )
}

/// The error of `other` relative to `pose`.
pub fn error_between(pose: &Isometry, other: &Isometry) -> Vector6<f64> {
    let off = other.translation - pose.translation;
    let turn = other.rotation * pose.rotation.conjugate();
    let turn = if turn.w < 0.0 { -turn } else { turn };
    let turn = turn.to_scaled_axis();
    Vector6::new(off.x, off.y, off.z, turn.x, turn.y, turn.z)
}

#[cfg(test)]
mod tests;
