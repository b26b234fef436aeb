//! A filter for the robot's path and for the slowly changing errors of odometry, IMU, mount and lens.
//!
//! The pose of the camera in one frame scatters about what these states predict, since the torso sways at every step and the
//! IMU is noisy. It is therefore not a state itself. The states predict it ([`SlowStateFilter::prior`]), refinement measures
//! it, and the states are conditioned on the result ([`SlowStateFilter::update`]), as in a Kalman filter.

mod slip;

use glam::{DQuat, DVec2, DVec3};
use nalgebra::{SMatrix, SVector};
use serde::{Deserialize, Serialize};

pub use slip::Slip;

use super::refinement::miscalibration::Miscalibration;
use super::refinement::{ErrorCovariance, Errors, OF_LENS, Prior, Refined, UNKNOWNS};
use realitysim_geometry::physical::MAX_MAGNITUDE;
use realitysim_geometry::{Isometry, Physical, Pose2, Twist, wrap_angle};

/// Number of states: x, y, yaw of `base_footprint`; errors of the torso's roll and pitch, of the mount's roll and pitch, and of
/// the camera's height; relative errors of odometry's distance and turn; bias of the gyro; stretch and shift of the lens;
/// readout time of the sensor.
const STATES: usize = 15;
const X: usize = 0;
const Y: usize = 1;
const YAW: usize = 2;
const TORSO_ROLL: usize = 3;
const TORSO_PITCH: usize = 4;
const MOUNT_ROLL: usize = 5;
const MOUNT_PITCH: usize = 6;
const HEIGHT: usize = 7;
const DISTANCE: usize = 8;
const TURN: usize = 9;
const GYRO: usize = 10;
const STRETCH: usize = 11;
const SHIFT_U: usize = 12;
const SHIFT_V: usize = 13;
const READOUT: usize = 14;
/// The states that belong to lens and sensor, in the order of [`Errors`].
const LENS: [usize; 4] = [STRETCH, SHIFT_U, SHIFT_V, READOUT];

type Covariance = SMatrix<f64, STATES, STATES>;
type State = SVector<f64, STATES>;

/// Standard deviations of the noise between frames and of the states at the start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlowStateModel {
    /// Sway of the camera at each step of the gait, one standard deviation in metres: forwards, sideways, vertical.
    pub sway_m: DVec3,
    /// Error of one frame's roll and pitch, radians: IMU noise and time error.
    pub tilt_noise_rad: f64,
    /// Error of one frame's yaw, radians.
    pub yaw_noise_rad: f64,
    /// Initial error of the torso's roll and pitch by the IMU, radians.
    pub torso_tilt_rad: f64,
    /// Initial error of the mount's roll and pitch, radians.
    pub mount_tilt_rad: f64,
    /// Initial error of the camera's height, metres.
    pub height_m: f64,
    /// Initial relative error of odometry's distance.
    pub distance_scale: f64,
    /// Initial relative error of odometry's turn.
    pub turn_scale: f64,
    /// Initial bias of the gyro, rad/s.
    pub gyro_bias_rad_per_s: f64,
    /// Initial relative error of the focal length.
    pub lens_stretch: f64,
    /// Initial shift of the principal point, widths of the image.
    pub lens_shift: f64,
    /// Initial error of the readout time, seconds.
    pub readout_s: f64,
    /// Error of one step of odometry beyond its scale, as a share of the distance.
    pub step_share: f64,
    /// Error of one step's rotation beyond its scale, as a share of the rotation.
    pub turn_share: f64,
    /// Error of one step's rotation for each metre walked, radians.
    pub turn_rad_per_m: f64,
    /// Error of position that grows with time.
    pub drift_m_per_sqrt_s: f64,
    /// Error of heading that grows with time.
    pub drift_rad_per_sqrt_s: f64,
    /// Error of a rotation by gyro beyond its bias, as a share of the rotation.
    pub gyro_share: f64,
    /// Error of a rotation by gyro that grows with time.
    pub gyro_rad_per_sqrt_s: f64,
}

impl Default for SlowStateModel {
    fn default() -> Self {
        Self {
            sway_m: DVec3::new(0.006, 0.014, 0.006),
            tilt_noise_rad: 0.4f64.to_radians(),
            yaw_noise_rad: 0.3f64.to_radians(),
            torso_tilt_rad: 0.7f64.to_radians(),
            mount_tilt_rad: 0.7f64.to_radians(),
            height_m: 0.012,
            distance_scale: 0.15,
            turn_scale: 0.15,
            gyro_bias_rad_per_s: 0.02,
            lens_stretch: 0.005,
            lens_shift: 0.002,
            readout_s: 0.015,
            step_share: 0.1,
            turn_share: 0.05,
            turn_rad_per_m: 0.08,
            drift_m_per_sqrt_s: 0.005,
            drift_rad_per_sqrt_s: 0.006,
            gyro_share: 0.01,
            gyro_rad_per_sqrt_s: 0.002,
        }
    }
}

/// Random walks of the slow states, per root of a second.
const TILT_WALK_RAD: f64 = 0.0005;
const HEIGHT_WALK_M: f64 = 0.0005;
const SCALE_WALK: f64 = 0.01;
const GYRO_WALK: f64 = 0.001;
const STRETCH_WALK: f64 = 3e-5;
const SHIFT_WALK: f64 = 1e-5;
const READOUT_WALK: f64 = 1e-5;
/// Time over which frames share errors of line finding. The lens is learnt from a frame with the share of this time that has
/// passed since the last one.
const SHARED_ERROR_S: f64 = 2.0;
/// A frame that narrows the variance of a lens state by more than this share counts in full.
const FULL_UPDATE_SHARE: f64 = 0.5;
/// Gyro and odometry contradict each other beyond this many standard deviations of odometry.
const APART_SIGMAS: f64 = 4.0;
/// Largest relative error of odometry: beyond it odometry is broken, not scaled.
const SCALE_ERROR_LIMIT: f64 = 0.5;
/// Largest error of the calibration: beyond it the calibration is that of another lens.
const LENS_ERROR_LIMIT: f64 = 0.05;

/// Motion of the robot since the last frame, by its sensors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// `footprint_then_from_footprint_now` by odometry, if it is known.
    pub odometry: Option<Pose2>,
    /// Rotation about the vertical by gyro, radians.
    pub turned_rad: Option<f64>,
    /// Time since the last frame.
    pub seconds: f64,
    /// Standard deviation of the times at both ends of the step, seconds, beyond what the model's shares allow for.
    pub stamp_sigma_s: f64,
}

impl Step {
    /// No motion in no time.
    pub fn none() -> Self {
        Self { odometry: Some(Pose2::default()), turned_rad: None, seconds: 0.0, stamp_sigma_s: 0.0 }
    }

    /// The error of a motion of `length`, metres or radians, at whose ends the times are wrong: the speed times the error of
    /// both times, which are independent.
    fn time_error(&self, length: f64) -> f64 {
        let rate = if self.seconds > 0.0 { length.abs() / self.seconds } else { 0.0 };
        core::f64::consts::SQRT_2 * self.stamp_sigma_s * rate
    }
}

/// A rotation about the vertical with its standard deviation.
#[derive(Clone, Copy, Debug)]
struct Turn {
    turn_rad: f64,
    sigma_rad: f64,
}

/// Gaussian estimate of the robot's path and of the slow errors of its sensors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SlowStateFilter {
    mean: State,
    covariance: Covariance,
    /// Time since a refined pose was last learnt from.
    unlearnt_s: f64,
    slip: Slip,
}

/// The predicted pose of the camera, with what is needed to learn from its refinement.
#[derive(Clone, Debug)]
pub struct Prediction {
    /// The prior for refinement.
    pub prior: Prior,
    /// Derivatives of the camera pose's error by the states.
    sensitivity: SMatrix<f64, UNKNOWNS, STATES>,
    /// The part of the prior's covariance that is the frame's own and not due to the states.
    scatter: ErrorCovariance,
}

impl Prediction {
    /// The same prediction with the lens fixed at its believed errors: seen from a wrong pose, every lens looks wrong.
    pub fn with_lens_known(mut self) -> Self {
        self.prior.take_lens_as_known();
        self.sensitivity.fixed_rows_mut::<{ LENS.len() }>(OF_LENS).fill(0.0);
        self
    }

    /// The same prediction with the frame's own error in height and tilt widened to what the lines have shown.
    pub fn doubted(mut self, moved: &Errors) -> Self {
        for index in [2, 3, 4] {
            let variance = moved[index] * moved[index];
            self.scatter[(index, index)] += variance;
            self.prior.covariance[(index, index)] += variance;
        }
        self
    }
}

impl Physical for SlowStateFilter {
    fn is_possible(&self) -> bool {
        // A variance may be as large as the square of the largest number.
        let is_covariance = self.covariance.diagonal().iter().all(|variance| *variance >= 0.0)
            && self.covariance.iter().all(|value| value.abs() <= MAX_MAGNITUDE * MAX_MAGNITUDE);
        self.mean.as_slice().is_possible() && is_covariance && self.unlearnt_s >= 0.0 && self.slip.is_possible()
    }
}

impl SlowStateFilter {
    /// A filter at a pose with these standard deviations, which has learnt nothing about the slow errors.
    pub fn around(pose: Pose2, xy_m: f64, yaw_rad: f64, model: &SlowStateModel) -> Self {
        let mut mean = State::zeros();
        mean.fixed_rows_mut::<3>(0).copy_from_slice(&[pose.x, pose.y, pose.yaw]);
        let sigmas = State::from([
            xy_m,
            xy_m,
            yaw_rad,
            model.torso_tilt_rad,
            model.torso_tilt_rad,
            model.mount_tilt_rad,
            model.mount_tilt_rad,
            model.height_m,
            model.distance_scale,
            model.turn_scale,
            model.gyro_bias_rad_per_s,
            model.lens_stretch,
            model.lens_shift,
            model.lens_shift,
            model.readout_s,
        ]);
        Self {
            mean,
            covariance: Covariance::from_diagonal(&sigmas.component_mul(&sigmas)),
            unlearnt_s: 0.0,
            slip: Slip::default(),
        }
    }

    /// The filter at another pose, with what was learnt about the slow errors.
    pub fn moved_to(&self, pose: Pose2, xy_m: f64, yaw_rad: f64) -> Self {
        let mut moved = self.clone();
        moved.mean.fixed_rows_mut::<3>(0).copy_from_slice(&[pose.x, pose.y, pose.yaw]);
        moved.slip = Slip::default();
        for (index, sigma) in [(X, xy_m), (Y, xy_m), (YAW, yaw_rad)] {
            moved.forget(index, sigma);
        }
        moved
    }

    /// The filter with the lens as uncertain as at the start, since it may have been learnt at a wrong pose.
    pub fn with_lens_doubted(mut self, model: &SlowStateModel) -> Self {
        let sigmas = [model.lens_stretch, model.lens_shift, model.lens_shift, model.readout_s];
        for (index, sigma) in LENS.into_iter().zip(sigmas) {
            self.forget(index, sigma);
        }
        self
    }

    /// The filter without what was learnt about the tilts of torso and mount and about the camera's height.
    pub fn with_lean_forgotten(mut self, model: &SlowStateModel) -> Self {
        let (torso, mount) = (model.torso_tilt_rad, model.mount_tilt_rad);
        let sigmas = [torso, torso, mount, mount, model.height_m];
        for (index, sigma) in [TORSO_ROLL, TORSO_PITCH, MOUNT_ROLL, MOUNT_PITCH, HEIGHT].into_iter().zip(sigmas) {
            self.forget(index, sigma);
            self.mean[index] = 0.0;
        }
        self
    }

    /// Sets the standard deviation of one state and removes its correlations.
    fn forget(&mut self, index: usize, sigma: f64) {
        self.covariance.row_mut(index).fill(0.0);
        self.covariance.column_mut(index).fill(0.0);
        self.covariance[(index, index)] = sigma * sigma;
    }

    /// The pose of `base_footprint` in `map`.
    pub fn pose(&self) -> Pose2 {
        Pose2::new(self.mean[X], self.mean[Y], self.mean[YAW])
    }

    /// Standard deviations of the position, along its longer axis (m), and of the heading (rad).
    pub fn spread(&self) -> (f64, f64) {
        let c = &self.covariance;
        let (mean, half) = (0.5 * (c[(X, X)] + c[(Y, Y)]), 0.5 * (c[(X, X)] - c[(Y, Y)]));
        let largest = mean + libm::hypot(half, c[(X, Y)]);
        (libm::sqrt(largest.max(0.0)), libm::sqrt(c[(YAW, YAW)].max(0.0)))
    }

    /// Predicts the states after `step`. Without odometry the robot may have walked `reach_m` and turned `reach_rad`, one standard
    /// deviation each.
    pub fn predict(&mut self, step: &Step, model: &SlowStateModel, reach_m: f64, reach_rad: f64) {
        let seconds = step.seconds.max(0.0);
        self.unlearnt_s += seconds;
        let root = libm::sqrt(seconds);
        let (walked, xy, by_odometry) = match step.odometry {
            Some(walked) => {
                let distance = libm::hypot(walked.x, walked.y);
                let slip = model.turn_share * walked.yaw.abs() + model.turn_rad_per_m * distance;
                let sigma_rad = libm::hypot(slip, model.drift_rad_per_sqrt_s * root);
                let xy = libm::hypot(model.step_share * distance, model.drift_m_per_sqrt_s * root);
                (walked, xy, Turn { turn_rad: (1.0 + self.mean[TURN]) * walked.yaw, sigma_rad })
            }
            None => (Pose2::default(), reach_m, Turn { turn_rad: 0.0, sigma_rad: reach_rad }),
        };
        let by_gyro = step.turned_rad.map(|turned| self.turn_by_gyro(turned, seconds, &by_odometry, model));
        let turn = by_gyro.unwrap_or(by_odometry);
        let walked_at_other_time = step.time_error(libm::hypot(walked.x, walked.y));
        let turned_at_other_time = step.time_error(turn.turn_rad);
        let step = walked;
        let (sin, cos) = libm::sincos(self.mean[YAW]);
        let grown = 1.0 + self.mean[DISTANCE];
        let walked = (cos * step.x - sin * step.y, sin * step.x + cos * step.y);
        self.mean[X] += grown * walked.0;
        self.mean[Y] += grown * walked.1;
        self.mean[YAW] = wrap_angle(self.mean[YAW] + turn.turn_rad);
        let mut transition = Covariance::identity();
        transition[(X, YAW)] = -grown * walked.1;
        transition[(Y, YAW)] = grown * walked.0;
        transition[(X, DISTANCE)] = walked.0;
        transition[(Y, DISTANCE)] = walked.1;
        match by_gyro {
            Some(_) => transition[(YAW, GYRO)] = -seconds,
            None => transition[(YAW, TURN)] = step.yaw,
        }
        self.covariance = transition * self.covariance * transition.transpose();
        let mut add = |index: usize, variance: f64, most: f64| {
            let grown = self.covariance[(index, index)] + variance;
            // A slow error never becomes less certain than at the start.
            self.covariance[(index, index)] = grown.min(most.max(self.covariance[(index, index)]));
        };
        let xy_variance = xy * xy + walked_at_other_time * walked_at_other_time;
        add(X, xy_variance, f64::INFINITY);
        add(Y, xy_variance, f64::INFINITY);
        add(YAW, turn.sigma_rad * turn.sigma_rad + turned_at_other_time * turned_at_other_time, f64::INFINITY);
        for index in [TORSO_ROLL, TORSO_PITCH] {
            add(index, TILT_WALK_RAD * TILT_WALK_RAD * seconds, model.torso_tilt_rad * model.torso_tilt_rad);
        }
        for index in [MOUNT_ROLL, MOUNT_PITCH] {
            add(index, TILT_WALK_RAD * TILT_WALK_RAD * seconds, model.mount_tilt_rad * model.mount_tilt_rad);
        }
        add(HEIGHT, HEIGHT_WALK_M * HEIGHT_WALK_M * seconds, model.height_m * model.height_m);
        add(DISTANCE, SCALE_WALK * SCALE_WALK * seconds, model.distance_scale * model.distance_scale);
        add(TURN, SCALE_WALK * SCALE_WALK * seconds, model.turn_scale * model.turn_scale);
        add(STRETCH, STRETCH_WALK * STRETCH_WALK * seconds, model.lens_stretch * model.lens_stretch);
        for index in [SHIFT_U, SHIFT_V] {
            add(index, SHIFT_WALK * SHIFT_WALK * seconds, model.lens_shift * model.lens_shift);
        }
        add(READOUT, READOUT_WALK * READOUT_WALK * seconds, model.readout_s * model.readout_s);
        add(GYRO, GYRO_WALK * GYRO_WALK * seconds, model.gyro_bias_rad_per_s * model.gyro_bias_rad_per_s);
    }

    /// The rotation that a gyro measured, without its estimated bias, radians.
    pub fn turned(&self, turned_rad: f64, seconds: f64) -> f64 {
        turned_rad - self.mean[GYRO] * seconds
    }

    /// The rotation by gyro. It is preferred to that of feet, which slip. If both contradict each other, it is as uncertain as they
    /// are apart.
    fn turn_by_gyro(&self, turned_rad: f64, seconds: f64, by_odometry: &Turn, model: &SlowStateModel) -> Turn {
        let turn_rad = self.turned(turned_rad, seconds);
        let apart = (turn_rad - by_odometry.turn_rad).abs();
        let usual = APART_SIGMAS * by_odometry.sigma_rad + model.turn_scale * by_odometry.turn_rad.abs();
        let doubt = if apart > usual { apart } else { 0.0 };
        let own = libm::hypot(model.gyro_share * turn_rad, model.gyro_rad_per_sqrt_s * libm::sqrt(seconds));
        Turn { turn_rad, sigma_rad: libm::hypot(own, doubt) }
    }

    /// Predicts the camera's pose. `footprint_from_optical` is its pose on the robot by IMU, joints and mount.
    pub fn prior(&self, footprint_from_optical: &Isometry, model: &SlowStateModel) -> Prediction {
        let footprint = self.pose();
        let nominal = footprint.to_isometry() * *footprint_from_optical;
        let torso = DQuat::from_rotation_z(footprint.yaw);
        let ahead = nominal.rotation * DVec3::Z;
        // A camera that looks straight down has no heading: the robot's is used.
        let heading = if ahead.truncate().length() > 1e-3 { libm::atan2(ahead.y, ahead.x) } else { footprint.yaw };
        let camera = DQuat::from_rotation_z(heading);
        let axes = [
            (TORSO_ROLL, torso * DVec3::X),
            (TORSO_PITCH, torso * DVec3::Y),
            (MOUNT_ROLL, camera * DVec3::X),
            (MOUNT_PITCH, camera * DVec3::Y),
        ];
        let mut sensitivity = SMatrix::<f64, UNKNOWNS, STATES>::zeros();
        sensitivity[(0, X)] = 1.0;
        sensitivity[(1, Y)] = 1.0;
        sensitivity[(2, HEIGHT)] = 1.0;
        sensitivity[(5, YAW)] = 1.0;
        let arm = nominal.translation - DVec3::new(footprint.x, footprint.y, 0.0);
        sensitivity[(0, YAW)] = -arm.y;
        sensitivity[(1, YAW)] = arm.x;
        for (state, axis) in axes {
            for (row, part) in [(3, axis.x), (4, axis.y), (5, axis.z)] {
                sensitivity[(row, state)] = part;
            }
        }
        for (row, state) in (OF_LENS..).zip(LENS) {
            sensitivity[(row, state)] = 1.0;
        }
        let tilt: DVec3 = axes.iter().map(|(state, axis)| *axis * self.mean[*state]).sum();
        let map_from_optical = Isometry::new(
            DQuat::from_scaled_axis(tilt) * nominal.rotation,
            nominal.translation + DVec3::new(0.0, 0.0, self.mean[HEIGHT]),
        );
        let mut covariance: ErrorCovariance = sensitivity * self.covariance * sensitivity.transpose();
        let scatter = scatter(model, footprint.yaw);
        covariance += scatter;
        covariance = (covariance + covariance.transpose()) * 0.5;
        Prediction {
            prior: Prior {
                map_from_optical,
                lens: self.lens(),
                twist: Twist::ZERO,
                turn_is_measured: true,
                covariance,
            },
            sensitivity,
            scatter,
        }
    }

    /// The estimated errors of lens and sensor.
    pub fn lens(&self) -> Miscalibration {
        Miscalibration {
            stretch: self.mean[STRETCH],
            shift: DVec2::new(self.mean[SHIFT_U], self.mean[SHIFT_V]),
            readout_s: self.mean[READOUT],
        }
    }

    /// Standard deviations of the errors of lens and sensor, in the order of [`Errors`].
    pub fn lens_sigmas(&self) -> [f64; 4] {
        LENS.map(|index| libm::sqrt(self.covariance[(index, index)].max(0.0)))
    }

    /// Conditions the states on a refined pose. What it says about the lens is taken in part only, as in the partial-update
    /// Schmidt-Kalman filter (Brink 2017): the covariance keeps what is not taken.
    pub fn update(&mut self, prediction: &Prediction, refined: &Refined) {
        let Some(information) = prediction.prior.covariance.cholesky() else { return };
        let gain = self.covariance * prediction.sensitivity.transpose() * information.inverse();
        let narrowed = gain * (prediction.prior.covariance - refined.covariance) * gain.transpose();
        let left = self.untaken_shares(&narrowed);
        self.unlearnt_s = 0.0;
        self.mean += (gain * refined.moved).component_mul(&(State::repeat(1.0) - left));
        self.mean[YAW] = wrap_angle(self.mean[YAW]);
        let most = [DISTANCE, TURN]
            .map(|index| (index, SCALE_ERROR_LIMIT))
            .into_iter()
            .chain(LENS.map(|index| (index, LENS_ERROR_LIMIT)));
        for (index, most) in most {
            self.mean[index] = self.mean[index].clamp(-most, most);
        }
        // Joseph's form, a sum of squares: it stays positive semidefinite under rounding.
        let kept = Covariance::identity() - gain * prediction.sensitivity;
        let learnt = gain * (prediction.scatter + refined.covariance) * gain.transpose();
        let left = Covariance::from_diagonal(&left);
        let covariance = kept * self.covariance * kept.transpose() + learnt + left * narrowed * left;
        self.covariance = (covariance + covariance.transpose()) * 0.5;
    }

    /// The share of a frame's information that is not taken, for each state. `narrowed` is what the covariance would lose by it.
    fn untaken_shares(&self, narrowed: &Covariance) -> State {
        let new_share = (self.unlearnt_s / SHARED_ERROR_S).min(1.0);
        let mut left = State::zeros();
        for index in LENS {
            let share = narrowed[(index, index)] / self.covariance[(index, index)];
            left[index] = if share > FULL_UPDATE_SHARE { 0.0 } else { 1.0 - new_share };
        }
        left
    }

    /// Takes in a frame's deviation, and returns whether lines and odometry have disagreed for some frames up to this one.
    pub fn slips(&mut self, prior: &Prior, refined: &Refined) -> bool {
        self.slip.update(self.mean[YAW], prior, refined)
    }

    /// Widens the path's uncertainty by what the lines have shown it to be wrong, since odometry is worse than it claims.
    pub fn doubt(&mut self, moved: &Errors) {
        for (index, off) in [(X, moved[0]), (Y, moved[1]), (YAW, moved[5])] {
            self.covariance[(index, index)] += off * off;
        }
    }
}

/// Covariance of one frame's own error about the path, in `map`.
fn scatter(model: &SlowStateModel, yaw: f64) -> ErrorCovariance {
    let (sin, cos) = libm::sincos(yaw);
    let (ahead, aside) = (model.sway_m.x * model.sway_m.x, model.sway_m.y * model.sway_m.y);
    let tilt = model.tilt_noise_rad * model.tilt_noise_rad;
    let mut result = ErrorCovariance::zeros();
    result[(0, 0)] = cos * cos * ahead + sin * sin * aside;
    result[(1, 1)] = sin * sin * ahead + cos * cos * aside;
    result[(0, 1)] = sin * cos * (ahead - aside);
    result[(1, 0)] = result[(0, 1)];
    result[(2, 2)] = model.sway_m.z * model.sway_m.z;
    result[(3, 3)] = tilt;
    result[(4, 4)] = tilt;
    result[(5, 5)] = model.yaw_noise_rad * model.yaw_noise_rad;
    result
}

#[cfg(test)]
mod tests;
