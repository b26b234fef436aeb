//! What is followed from frame to frame beside the particles: the robot's path and the slow errors of odometry,
//! IMU, mount and lens.
//!
//! A frame's camera pose scatters about what these say (the torso sways at every step, the IMU is noisy), so it
//! is not part of the state: the state predicts it ([`Track::prior`]), the frame's refinement measures it, and
//! what that says of the state follows by conditioning ([`Track::update`]), as in a Kalman filter.

use glam::{DQuat, DVec2, DVec3};
use nalgebra::{SMatrix, SVector};
use serde::{Deserialize, Serialize};

use super::refinement::miscalibration::Miscalibration;
use super::refinement::{ErrorCovariance, Errors, OF_LENS, Prior, Refined, UNKNOWNS};
use crate::geometry::{Isometry, Pose2, Twist, wrap_angle};

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
pub struct TrackModel {
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

impl Default for TrackModel {
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
/// Frames have errors of line finding in common: evidence that would make a variance of the lens smaller by less than this share has
/// been counted before. So some twenty frames' worth is taken, and of a lens that a frame hardly shows nothing.
const SEEN_BEFORE: f64 = 0.05;
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
pub struct Track {
    mean: State,
    covariance: Covariance,
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

impl Track {
    /// Around a pose, knowing nothing of the slow errors.
    pub fn around(pose: Pose2, xy_m: f64, yaw_rad: f64, model: &TrackModel) -> Self {
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
        Self { mean, covariance: Covariance::from_diagonal(&sigmas.component_mul(&sigmas)) }
    }

    /// Elsewhere, but with what was learnt of the robot.
    pub fn moved_to(&self, pose: Pose2, xy_m: f64, yaw_rad: f64) -> Self {
        let mut moved = self.clone();
        moved.mean.fixed_rows_mut::<3>(0).copy_from_slice(&[pose.x, pose.y, pose.yaw]);
        for (index, sigma) in [(X, xy_m), (Y, xy_m), (YAW, yaw_rad)] {
            moved.forget(index, sigma);
        }
        moved
    }

    /// What was learnt of the lens may have been learnt from a wrong place: it is as uncertain as at the start.
    pub fn with_lens_doubted(mut self, model: &TrackModel) -> Self {
        let sigmas = [model.lens_stretch, model.lens_shift, model.lens_shift, model.readout_s];
        for (index, sigma) in LENS.into_iter().zip(sigmas) {
            self.forget(index, sigma);
        }
        self
    }

    /// As if nothing had been learnt of how the camera leans and how high it is.
    pub fn with_lean_forgotten(mut self, model: &TrackModel) -> Self {
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
    pub fn predict(&mut self, step: &Step, model: &TrackModel, reach_m: f64, reach_rad: f64) {
        let seconds = step.seconds.max(0.0);
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
    fn by_gyro(&self, turned_rad: f64, seconds: f64, by_odometry: &Turn, model: &TrackModel) -> Turn {
        let turn_rad = self.turned(turned_rad, seconds);
        let apart = (turn_rad - by_odometry.turn_rad).abs();
        let usual = APART_SIGMAS * by_odometry.sigma_rad + model.turn_scale * by_odometry.turn_rad.abs();
        let doubt = if apart > usual { apart } else { 0.0 };
        let own = libm::hypot(model.gyro_share * turn_rad, model.gyro_rad_per_sqrt_s * libm::sqrt(seconds));
        Turn { turn_rad, sigma_rad: libm::hypot(own, doubt) }
    }

    /// Where the camera should be, `footprint_from_optical` being its place by IMU, joints and mount.
    pub fn prior(&self, footprint_from_optical: &Isometry, model: &TrackModel) -> Prediction {
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
            prior: Prior { map_from_optical, lens: self.lens(), twist: Twist::ZERO, covariance },
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
        let mut left = State::zeros();
        for index in LENS {
            let share = narrowed[(index, index)] / self.covariance[(index, index)];
            left[index] = if share > SEEN_BEFORE { SEEN_BEFORE / share } else { 1.0 };
        }
        left
    }

    /// Odometry was wronger than it claims: the path is as uncertain as the lines have shown it to be wrong.
    pub fn doubt(&mut self, moved: &Errors) {
        for (index, off) in [(X, moved[0]), (Y, moved[1]), (YAW, moved[5])] {
            self.covariance[(index, index)] += off * off;
        }
    }
}

/// One frame's own error about the path, in `map`.
fn scatter(model: &TrackModel, yaw: f64) -> ErrorCovariance {
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
mod tests {
    use super::*;
    use crate::localization::refinement::{Agreement, error_between};

    const MODEL: fn() -> TrackModel = TrackModel::default;

    fn camera(pose: &Pose2) -> Isometry {
        let place = Isometry::from_euler(crate::geometry::Euler { yaw: 0.0, pitch: 0.3, roll: 0.0 }, DVec3::Z * 0.5);
        pose.to_isometry() * place * Isometry::link_from_optical()
    }

    /// Walks a circle; each frame's lines say exactly where the camera is.
    fn walked(frames: usize, odometry: impl Fn(Pose2) -> Option<Pose2>, gyro: impl Fn(f64) -> Option<f64>) -> Track {
        let step = Pose2::new(0.025, 0.0, 0.05);
        let mut truth = Pose2::new(0.3, -0.2, 0.1);
        let mut track = Track::around(truth, 0.05, 0.05, &MODEL());
        let place = Pose2::default().to_isometry().inverse() * camera(&Pose2::default());
        for _ in 0..frames {
            truth = truth.compose(&step);
            let told = Step { odometry: odometry(step), turned_rad: gyro(step.yaw), seconds: 0.1 };
            track.predict(&told, &MODEL(), 0.04, 0.1);
            let prediction = track.prior(&place, &MODEL());
            let off = error_between(&prediction.prior.map_from_optical, &camera(&truth));
            let moved = Errors::from_fn(|i, _| if i < 6 { off[i] } else { 0.0 });
            let refined = Refined {
                map_from_optical: camera(&truth),
                covariance: ErrorCovariance::identity() * 1e-8,
                moved,
                cost: 0.0,
                condition: 1.0,
                lines: Agreement::default(),
            };
            track.update(&prediction, &refined);
        }
        track
    }

    #[test]
    fn odometry_s_scales_are_learnt_while_walking() {
        // It says 20 % too much of the way and 15 % too little of the turn.
        let track = walked(150, |step| Some(Pose2::new(1.2 * step.x, 0.0, 0.85 * step.yaw)), |_| None);
        assert!((track.mean[DISTANCE] - (1.0 / 1.2 - 1.0)).abs() < 0.02, "{}", track.mean[DISTANCE]);
        assert!((track.mean[TURN] - (1.0 / 0.85 - 1.0)).abs() < 0.05, "{}", track.mean[TURN]);
    }

    #[test]
    fn a_gyro_s_bias_is_learnt_and_odometry_s_turn_does_not_matter_then() {
        let bias = 0.012;
        for share in [0.7, 1.0, 1.3] {
            let odometry = |step: Pose2| Some(Pose2 { yaw: share * step.yaw, ..step });
            let track = walked(150, odometry, |turn| Some(turn + bias * 0.1));
            assert!((track.mean[GYRO] - bias).abs() < 0.003, "{share}: {}", track.mean[GYRO]);
            assert_eq!(track.mean[TURN], 0.0, "odometry's turn was not used");
        }
    }

    #[test]
    fn a_gyro_that_contradicts_odometry_leaves_both_possible() {
        let mut track = Track::around(Pose2::default(), 0.01, 0.01, &MODEL());
        let told = Step { odometry: Some(Pose2::default()), turned_rad: Some(0.4), seconds: 0.1 };
        track.predict(&told, &MODEL(), 0.04, 0.1);
        let (_, yaw_sigma) = track.spread();
        assert!((track.pose().yaw - 0.4).abs() < 1e-12 && (0.39..0.5).contains(&yaw_sigma), "{yaw_sigma}");
        let mut agreed = Track::around(Pose2::default(), 0.01, 0.01, &MODEL());
        let turn = Pose2::new(0.0, 0.0, 0.39);
        agreed.predict(&Step { odometry: Some(turn), ..told }, &MODEL(), 0.04, 0.1);
        assert!(agreed.spread().1 < 0.02, "{}", agreed.spread().1);
    }

    /// Frames that all say the same of the lens, each with this standard deviation: what is believed then, and how firmly.
    fn told_of_the_lens(stretch: f64, sigma: f64, frames: usize) -> (f64, f64) {
        let track = told_again(Track::around(Pose2::default(), 0.05, 0.05, &MODEL()), stretch, sigma, frames);
        (track.lens().stretch, track.lens_sigmas()[0])
    }

    fn told_again(mut track: Track, stretch: f64, sigma: f64, frames: usize) -> Track {
        for _ in 0..frames {
            let prediction = track.prior(&camera(&Pose2::default()), &MODEL());
            let (known, seen) = (prediction.prior.covariance[(STRETCH_ROW, STRETCH_ROW)], sigma * sigma);
            let mut refined = Refined {
                map_from_optical: prediction.prior.map_from_optical,
                covariance: prediction.prior.covariance,
                moved: Errors::zeros(),
                cost: 0.0,
                condition: 1.0,
                lines: Agreement::default(),
            };
            refined.moved[STRETCH_ROW] = known / (known + seen) * (stretch - track.lens().stretch);
            refined.covariance[(STRETCH_ROW, STRETCH_ROW)] = known * seen / (known + seen);
            track.update(&prediction, &refined);
        }
        track
    }

    const STRETCH_ROW: usize = 6;

    #[test]
    fn what_frames_have_in_common_is_counted_a_few_times_and_no_more() {
        let (stretch, sigma) = told_of_the_lens(0.004, 0.001, 5);
        assert!((stretch - 0.004).abs() < 0.0003 && sigma < 0.0007, "learnt at once: {stretch} {sigma}");
        let (stretch, sigma) = told_of_the_lens(0.004, 0.001, 5000);
        assert!((stretch - 0.004).abs() < 0.0001, "{stretch}");
        assert!(sigma > 0.001 / 5.0, "a thousand frames are not a thousand times as much: {sigma}");
        // Who hardly sees what the lens does believes its calibration, however often.
        let before = MODEL().lens_stretch;
        let (stretch, sigma) = told_of_the_lens(0.1, 5.0 * before, 5000);
        assert!(stretch == 0.0 && sigma >= 0.999 * before, "{stretch} {sigma}");
    }

    #[test]
    fn what_was_learnt_of_the_lens_from_a_wrong_place_is_learnt_anew_from_the_right_one() {
        let wrong = told_again(Track::around(Pose2::default(), 0.05, 0.05, &MODEL()), 0.01, 0.001, 200);
        let elsewhere = wrong.moved_to(Pose2::new(1.0, 0.0, 0.0), 0.05, 0.05);
        let stays = told_again(elsewhere.clone(), 0.0, 0.001, 200).lens().stretch;
        let again = told_again(elsewhere.with_lens_doubted(&MODEL()), 0.0, 0.001, 200).lens().stretch;
        assert!(stays > 0.008 && again.abs() < 0.001, "{stays} {again}");
    }

    #[test]
    fn what_was_learnt_of_the_lean_in_a_wrong_place_is_forgotten_and_nothing_else() {
        let mut track = walked(60, Some, Some);
        for index in [TORSO_ROLL, TORSO_PITCH, MOUNT_ROLL, MOUNT_PITCH, HEIGHT] {
            track.mean[index] = 0.01;
        }
        let (anew, begun) =
            (track.clone().with_lean_forgotten(&MODEL()), Track::around(track.pose(), 0.0, 0.0, &MODEL()));
        for index in 0..STATES {
            let of = if (TORSO_ROLL..=HEIGHT).contains(&index) { &begun } else { &track };
            assert_eq!(
                (anew.mean[index], anew.covariance[(index, index)]),
                (of.mean[index], of.covariance[(index, index)])
            );
        }
        assert!(nalgebra::SymmetricEigen::new(anew.covariance).eigenvalues.min() > 0.0);
    }

    #[test]
    fn the_covariance_stays_one_whatever_is_doubted() {
        let mut track = walked(30, Some, Some);
        for round in 0..200 {
            let off = Errors::repeat(10f64.powi(round % 7 - 4));
            track.doubt(&off);
            let told = Step { odometry: None, turned_rad: None, seconds: 1e-9 };
            track.predict(&told, &MODEL(), 0.04, 0.1);
            let prediction = track.prior(&Isometry::IDENTITY, &MODEL()).doubted(&off);
            let refined = Refined {
                map_from_optical: prediction.prior.map_from_optical,
                covariance: ErrorCovariance::identity() * 1e-12,
                moved: off,
                cost: 0.0,
                condition: 1.0,
                lines: Agreement::default(),
            };
            track.update(&prediction, &refined);
            let least = nalgebra::SymmetricEigen::new(track.covariance).eigenvalues.min();
            let most = nalgebra::SymmetricEigen::new(track.covariance).eigenvalues.max();
            assert!(least > -1e-12 * most && most.is_finite(), "round {round}: {least} of {most}");
        }
    }
}
