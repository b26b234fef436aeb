//! What is followed from frame to frame beside the particles: the robot's path and the slow errors of odometry,
//! IMU, mount and lens.
//!
//! A frame's camera pose scatters about what these say (the torso sways at every step, the IMU is noisy), so it
//! is not part of the state: the state predicts it ([`SlowStateFilter::prior`]), the frame's refinement measures it, and
//! what that says of the state follows by conditioning ([`SlowStateFilter::update`]), as in a Kalman filter.

mod slip;

use glam::{DQuat, DVec2, DVec3};
use nalgebra::{SMatrix, SVector};
use serde::{Deserialize, Serialize};

pub use slip::Slip;

use super::refinement::miscalibration::Miscalibration;
use super::refinement::{ErrorCovariance, Errors, OF_LENS, Prior, Refined, UNKNOWNS};
use realitysim_geometry::physical::MOST;
use realitysim_geometry::{Isometry, Physical, Pose2, Twist, wrap_angle};

/// x, y, yaw of `base_footprint`; roll and pitch error of the torso's attitude; of the camera's mount; the camera's height
/// error; relative error of odometry's distance and of its turn; the gyro's bias; the lens's stretch and shift; the sensor's
/// readout.
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
const LENS: [usize; 4] = [STRETCH, SHIFT_U, SHIFT_V, READOUT];

type Covariance = SMatrix<f64, STATES, STATES>;
type State = SVector<f64, STATES>;

/// Standard deviations of what the track does not follow, and of how fast what it follows changes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlowStateModel {
    /// Sideways, forwards and vertical sway of the camera at each step of the gait, metres.
    pub sway_m: DVec3,
    /// Error of one frame's attitude: IMU noise and time error.
    pub tilt_noise_rad: f64,
    pub yaw_noise_rad: f64,
    /// At the start: errors of the torso's attitude, of the mount, of the camera's height, of odometry's scales, of the
    /// gyro.
    pub torso_tilt_rad: f64,
    pub mount_tilt_rad: f64,
    pub height_m: f64,
    pub distance_scale: f64,
    pub turn_scale: f64,
    pub gyro_bias_rad_per_s: f64,
    pub lens_stretch: f64,
    /// Widths of the image.
    pub lens_shift: f64,
    pub readout_s: f64,
    /// Error of one step of odometry beyond its scale: share of the distance, radians per metre and share of the turn, and
    /// what is added with time.
    pub step_share: f64,
    pub turn_share: f64,
    pub turn_rad_per_m: f64,
    pub drift_m_per_sqrt_s: f64,
    pub drift_rad_per_sqrt_s: f64,
    /// Error of a turn by gyro beyond its bias: share of the turn, and what is added with time.
    pub gyro_share: f64,
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

/// How much the slow errors may change: per root of a second.
const TILT_WALK_RAD: f64 = 0.0005;
const HEIGHT_WALK_M: f64 = 0.0005;
const SCALE_WALK: f64 = 0.01;
const GYRO_WALK: f64 = 0.001;
const STRETCH_WALK: f64 = 3e-5;
const SHIFT_WALK: f64 = 1e-5;
const READOUT_WALK: f64 = 1e-5;
/// Frames have errors of line finding in common, for about so long: what one says of the lens counts by the time since the one before,
/// as a share of this. Only a frame that says more than all before it counts in full.
const NEWS_S: f64 = 2.0;
const SAYS_MORE: f64 = 0.5;
/// Gyro and odometry farther apart than this, in the latter's standard deviations, contradict each other.
const APART_SIGMAS: f64 = 4.0;
/// Odometry off by more than this is broken, not scaled.
const MOST_SCALE: f64 = 0.5;
/// A calibration so wrong is that of another lens.
const MOST_LENS: f64 = 0.05;

/// What the sensors say of the robot's step since the last frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// `footprint_then_from_footprint_now`, if odometry knows.
    pub odometry: Option<Pose2>,
    /// About the vertical, by gyro.
    pub turned_rad: Option<f64>,
    pub seconds: f64,
}

impl Step {
    pub fn none() -> Self {
        Self { odometry: Some(Pose2::default()), turned_rad: None, seconds: 0.0 }
    }
}

#[derive(Clone, Copy, Debug)]
struct Turn {
    turn_rad: f64,
    sigma_rad: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SlowStateFilter {
    mean: State,
    covariance: Covariance,
    /// Since a refined pose was last learnt from.
    unlearnt_s: f64,
    slip: Slip,
}

/// Where the track puts the camera, and what is needed to learn from the difference.
#[derive(Clone, Debug)]
pub struct Prediction {
    pub prior: Prior,
    /// How the camera pose's error depends on the state's.
    sensitivity: SMatrix<f64, UNKNOWNS, STATES>,
    /// What of the covariance is the frame's own.
    scatter: ErrorCovariance,
}

impl Prediction {
    /// The same, the lens being taken for what it is believed to be: seen from a wrong place every lens is wrong.
    pub fn with_lens_known(mut self) -> Self {
        self.prior.take_lens_as_known();
        self.sensitivity.fixed_rows_mut::<{ LENS.len() }>(OF_LENS).fill(0.0);
        self
    }

    /// The same, the frame's own error in height and tilt being as large as the lines have shown.
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
            && self.covariance.iter().all(|value| value.abs() <= MOST * MOST);
        self.mean.as_slice().is_possible() && is_covariance && self.unlearnt_s >= 0.0 && self.slip.is_possible()
    }
}

impl SlowStateFilter {
    /// Around a pose, knowing nothing of the slow errors.
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

    /// Elsewhere, but with what was learnt of the robot.
    pub fn moved_to(&self, pose: Pose2, xy_m: f64, yaw_rad: f64) -> Self {
        let mut moved = self.clone();
        moved.mean.fixed_rows_mut::<3>(0).copy_from_slice(&[pose.x, pose.y, pose.yaw]);
        moved.slip = Slip::default();
        for (index, sigma) in [(X, xy_m), (Y, xy_m), (YAW, yaw_rad)] {
            moved.forget(index, sigma);
        }
        moved
    }

    /// What was learnt of the lens may have been learnt from a wrong place: it is as uncertain as at the start.
    pub fn with_lens_doubted(mut self, model: &SlowStateModel) -> Self {
        let sigmas = [model.lens_stretch, model.lens_shift, model.lens_shift, model.readout_s];
        for (index, sigma) in LENS.into_iter().zip(sigmas) {
            self.forget(index, sigma);
        }
        self
    }

    /// As if nothing had been learnt of how the camera leans and how high it is.
    pub fn with_lean_forgotten(mut self, model: &SlowStateModel) -> Self {
        let (torso, mount) = (model.torso_tilt_rad, model.mount_tilt_rad);
        let sigmas = [torso, torso, mount, mount, model.height_m];
        for (index, sigma) in [TORSO_ROLL, TORSO_PITCH, MOUNT_ROLL, MOUNT_PITCH, HEIGHT].into_iter().zip(sigmas) {
            self.forget(index, sigma);
            self.mean[index] = 0.0;
        }
        self
    }

    /// One state is as uncertain as this, whatever the others are.
    fn forget(&mut self, index: usize, sigma: f64) {
        self.covariance.row_mut(index).fill(0.0);
        self.covariance.column_mut(index).fill(0.0);
        self.covariance[(index, index)] = sigma * sigma;
    }

    pub fn pose(&self) -> Pose2 {
        Pose2::new(self.mean[X], self.mean[Y], self.mean[YAW])
    }

    /// Standard deviation of the path's place (along its longer axis) and heading.
    pub fn spread(&self) -> (f64, f64) {
        let c = &self.covariance;
        let (mean, half) = (0.5 * (c[(X, X)] + c[(Y, Y)]), 0.5 * (c[(X, X)] - c[(Y, Y)]));
        let largest = mean + libm::hypot(half, c[(X, Y)]);
        (libm::sqrt(largest.max(0.0)), libm::sqrt(c[(YAW, YAW)].max(0.0)))
    }

    /// Where the step has no odometry the robot may have walked as far as `reach_m` and turned by `reach_rad`.
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
        let by_gyro = step.turned_rad.map(|turned| self.by_gyro(turned, seconds, &by_odometry, model));
        let turn = by_gyro.unwrap_or(by_odometry);
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
            // What was believed at the start is never doubted further.
            self.covariance[(index, index)] = grown.min(most.max(self.covariance[(index, index)]));
        };
        add(X, xy * xy, f64::INFINITY);
        add(Y, xy * xy, f64::INFINITY);
        add(YAW, turn.sigma_rad * turn.sigma_rad, f64::INFINITY);
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

    /// What a gyro says, less its bias, radians.
    pub fn turned(&self, turned_rad: f64, seconds: f64) -> f64 {
        turned_rad - self.mean[GYRO] * seconds
    }

    /// A gyro knows better than feet that slip, unless the two speak of different robots: then either may be right.
    fn by_gyro(&self, turned_rad: f64, seconds: f64, by_odometry: &Turn, model: &SlowStateModel) -> Turn {
        let turn_rad = self.turned(turned_rad, seconds);
        let apart = (turn_rad - by_odometry.turn_rad).abs();
        let usual = APART_SIGMAS * by_odometry.sigma_rad + model.turn_scale * by_odometry.turn_rad.abs();
        let doubt = if apart > usual { apart } else { 0.0 };
        let own = libm::hypot(model.gyro_share * turn_rad, model.gyro_rad_per_sqrt_s * libm::sqrt(seconds));
        Turn { turn_rad, sigma_rad: libm::hypot(own, doubt) }
    }

    /// Where the camera should be, `footprint_from_optical` being its place by IMU, joints and mount.
    pub fn prior(&self, footprint_from_optical: &Isometry, model: &SlowStateModel) -> Prediction {
        let footprint = self.pose();
        let nominal = footprint.to_isometry() * *footprint_from_optical;
        let torso = DQuat::from_rotation_z(footprint.yaw);
        let ahead = nominal.rotation * DVec3::Z;
        // A camera that looks straight down has no heading: the robot's will do.
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
            prior: Prior { map_from_optical, lens: self.lens(), twist: Twist::ZERO, turn_is_felt: true, covariance },
            sensitivity,
            scatter,
        }
    }

    /// How the lens differs from its calibration.
    pub fn lens(&self) -> Miscalibration {
        Miscalibration {
            stretch: self.mean[STRETCH],
            shift: DVec2::new(self.mean[SHIFT_U], self.mean[SHIFT_V]),
            readout_s: self.mean[READOUT],
        }
    }

    /// Their standard deviations, in the order of [`Errors`].
    pub fn lens_sigmas(&self) -> [f64; 4] {
        LENS.map(|index| libm::sqrt(self.covariance[(index, index)].max(0.0)))
    }

    /// What a refined pose says of the state. Of the lens only a part of it is taken, as in the partial-update Schmidt-Kalman filter
    /// (Brink 2017): what is left is put back into its covariance.
    pub fn update(&mut self, prediction: &Prediction, refined: &Refined) {
        let Some(information) = prediction.prior.covariance.cholesky() else { return };
        let gain = self.covariance * prediction.sensitivity.transpose() * information.inverse();
        let narrowed = gain * (prediction.prior.covariance - refined.covariance) * gain.transpose();
        let left = self.left_of_lens(&narrowed);
        self.unlearnt_s = 0.0;
        self.mean += (gain * refined.moved).component_mul(&(State::repeat(1.0) - left));
        self.mean[YAW] = wrap_angle(self.mean[YAW]);
        let most =
            [DISTANCE, TURN].map(|index| (index, MOST_SCALE)).into_iter().chain(LENS.map(|index| (index, MOST_LENS)));
        for (index, most) in most {
            self.mean[index] = self.mean[index].clamp(-most, most);
        }
        // A sum of squares (Joseph's form): no rounding makes it anything but a covariance.
        let kept = Covariance::identity() - gain * prediction.sensitivity;
        let learnt = gain * (prediction.scatter + refined.covariance) * gain.transpose();
        let left = Covariance::from_diagonal(&left);
        let covariance = kept * self.covariance * kept.transpose() + learnt + left * narrowed * left;
        self.covariance = (covariance + covariance.transpose()) * 0.5;
    }

    /// Which share of what a frame says of each state is not taken; `narrowed` is what the covariance would lose by it.
    fn left_of_lens(&self, narrowed: &Covariance) -> State {
        let news = (self.unlearnt_s / NEWS_S).min(1.0);
        let mut left = State::zeros();
        for index in LENS {
            let share = narrowed[(index, index)] / self.covariance[(index, index)];
            left[index] = if share > SAYS_MORE { 0.0 } else { 1.0 - news };
        }
        left
    }

    /// Whether lines and odometry have told of different walks for some frames, this one the last of them.
    pub fn slips(&mut self, prior: &Prior, refined: &Refined) -> bool {
        self.slip.note(self.mean[YAW], prior, refined)
    }

    /// Odometry was wronger than it claims: the path is as uncertain as the lines have shown it to be wrong.
    pub fn doubt(&mut self, moved: &Errors) {
        for (index, off) in [(X, moved[0]), (Y, moved[1]), (YAW, moved[5])] {
            self.covariance[(index, index)] += off * off;
        }
    }
}

/// One frame's own error about the path, in `map`.
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
